"""Logs of a motor under names that misled: inspected without an edit, and their friction found."""

from pathlib import Path

import pytest
from rotor import describe_rotor, write_log
from small_study import Hesr, hesr_here

from hesr_model.fitting.fit import fit_joint
from hesr_model.health.proposal import robot_text
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def write_bench(folder: Path) -> Path:
    path = folder / "robot.toml"
    path.write_text(robot_text(describe_rotor(folder), path, "A bench."), encoding="utf-8")
    return path


HEADERS = {
    "amperes": "time [s]=t;m q-axis [A]=amperes;m position [rad]=q;m velocity [rad/s]=dq;"
    "m torque [Nm]=tau",
    "current": "time=t;position=q;velocity=dq;q_current=amperes;torque=tau",
    "voltage": "time=t;v_q=volts;pos=q;vel=dq;torque=tau",
    "degrees and minutes": "Zeit [ms]=ms;Winkel [°]=deg;Drehzahl [1/min]=rpm;Drehmoment [Nm]=tau",
    "names of joints": "stamp=t;motor_pos=q;motor_vel=dq;motor_eff=tau",
    "speed alone": "time [s]=t;motor speed [rpm]=rpm;motor torque [Nm]=tau",
}


@pytest.mark.ci
@pytest.mark.parametrize("case", HEADERS)
def test_friction_is_found_behind_names_of_other_loggers(
    case: str, tmp_path: Path, hesr: Hesr
) -> None:
    robot_path = write_bench(tmp_path)
    log_path = write_log(tmp_path / "run.csv", HEADERS[case])
    study = tmp_path / "study.toml"
    answer = hesr(
        "inspect", log_path, "--robot", robot_path, "--write", robot_path, "--study", study
    )
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.endswith(f"Next: hesr run {study}\n")
    robot = Robot(robot_path)
    log = Log.read(log_path, robot)
    (records,) = friction_records(log, robot, identify([log], robot))
    law = fit_joint("coulomb_viscous", [records], seed=0)
    assert law.values["F_c"] == pytest.approx(0.3, rel=0.03)
    assert law.values["sigma_2"] == pytest.approx(0.02, rel=0.03)


@pytest.mark.ci
def test_a_torque_without_a_sign_leads_to_no_study(tmp_path: Path, hesr: Hesr) -> None:
    robot_path = write_bench(tmp_path)
    log_path = write_log(tmp_path / "run.csv", "t=t;q1=q;dq1=dq;tau1=size")
    study = tmp_path / "study.toml"
    answer = hesr(
        "inspect", log_path, "--robot", robot_path, "--write", robot_path, "--study", study
    )
    assert answer.code == 1
    assert "torque has no sign" in answer.out
    assert "backwards" not in answer.out
    assert not study.exists()
    refused = hesr("identify", log_path, "--robot", robot_path, "-o", tmp_path / "body.json")
    assert refused.code == 2
    assert "[torque-unsigned]" in refused.err


def test_what_is_missing_is_written_as_a_comment(tmp_path: Path, hesr: Hesr) -> None:
    """One edit of the file that a refusal names goes on."""
    robot_path = write_bench(tmp_path)
    written = tmp_path / "written.toml"
    log_path = write_log(tmp_path / "run.csv", "q1=q;dq1=dq;tau1=tau")
    refused = hesr("inspect", log_path, "--robot", robot_path, "--write", written)
    assert refused.code == 2
    assert f"{written} is written" in refused.err
    assert "log.rate" in refused.err
    text = written.read_text(encoding="utf-8")
    assert text.count("\n# rate = 200.0\n") == 1
    written.write_text(text.replace("# rate = ", "rate = "), encoding="utf-8")
    answer = hesr("inspect", log_path, "--robot", written)
    assert (answer.code, answer.err) == (0, "")
