"""hesr inspect: a foreign log gives a robot file without manual edits."""

import json
import re
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from containing import OneSentence
from small_study import Hesr, hesr_here

from cosim.study.results import read_findings
from cosim.study.run import score_study
from cosim.study.steps import Job
from cosim.study.study import Study
from cosim.workflow.inspect import inspect
from hesr_model.errors import ArtifactError, LogError, RobotError
from hesr_model.friction.records import predict_record
from hesr_model.health.joints import apply_changes, remove_joints
from hesr_model.health.proposal import inspect_logs, propose, robot_file
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.log_table import build_table
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.progress import silent

GAINS = np.array([12.0, 11.0, 9.0])


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def messy(tmp_path: Path, make_motion: Callable[..., Motion]) -> Path:
    """125 Hz with jitter, other names, degrees, currents, a gap, NaN, comments, semicolons."""
    motion = make_motion(friction=0.8)
    rng = np.random.default_rng(0)
    t = np.arange(1240) / 125.0 + rng.normal(0.0, 3e-4, 1240)
    t = np.sort(np.clip(t, 0.0, motion.t[-1]))
    t = t[np.r_[True, np.diff(t) > 1e-4]]
    t = t[(t < 4.0) | (t > 4.3)]
    lines = [
        "# cell 7",
        "",
        "stamp;"
        + ";".join(f"A{k}_{x}" for x in ("pos_deg", "vel_degs", "current") for k in (1, 2, 3))
        + ";temp",
    ]
    values = np.hstack([motion.q * 180 / np.pi, motion.dq * 180 / np.pi, motion.tau / GAINS])
    for row, stamp in enumerate(t):
        cells = [f"{np.interp(stamp, motion.t, column):.6f}" for column in values.T]
        if row in (200, 700):
            cells[3] = "NaN"
        lines.append(";".join([f"{1.6e9 + stamp:.4f}", *cells, "31.5"]))
        if row == 500:
            lines.append("# a tool was changed")
    path = tmp_path / "messy.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_messy_log_gets_a_robot_file_that_reads_it(
    messy: Path, arm: RobotDescription, hesr: Hesr
) -> None:
    written, page = messy.with_name("robot.toml"), messy.with_name("page.html")
    said = hesr("inspect", messy, "--robot", arm.model, "--write", written, "-o", page)
    assert (said.code, said.err) == (0, "")
    assert "Fixed by the proposed robot file: log messy" in said.out
    data = tomllib.loads(written.read_text("utf-8"))
    assert data["log"]["missing"] == "drop"
    assert data["log"]["units"] == {"q": "deg", "dq": "deg/s"}
    robot = RobotDescription.read(written)
    log = Log.read(messy, robot)
    assert len(log.parts()) == 2
    assert log.dropped == 2
    [shown, *_] = inspect([messy], robot=written).tables()
    assert "2 rows left out" in str(shown)
    # Constants from the model's gravity alone are rough but never of another unit.
    assert robot.log.torque_per_ampere == pytest.approx(GAINS, rel=0.5)
    html = page.read_text("utf-8")
    assert "torque_per_ampere: guess" in html
    assert 0 < html.index('id="figure-arm"') < html.index('id="figure-joints"')
    assert "<svg" in html
    assert "http://" not in html.replace("http://www.w3.org", "")


def test_renamed_torque_columns_need_no_constants(messy: Path, arm: RobotDescription) -> None:
    text = messy.read_text("utf-8").replace("_current", "_torque")
    messy.write_text(text, encoding="utf-8")
    log = propose([messy], arm, has_model=False).description.log
    assert log.torque_per_ampere is None
    assert "torque" in str(log.columns.tau)


def test_the_proposed_study_reads_the_inspected_log(
    messy: Path, arm: RobotDescription, hesr: Hesr
) -> None:
    folder = messy.parent / "cell 7"
    folder.mkdir()
    written, study = folder / "robot.toml", folder / "study.toml"
    looked_at = ("inspect", messy, "--robot", arm.model, "--write", written)
    said = hesr(*looked_at, "--study", study)
    assert said.code == 0
    assert said.out.endswith(f"Next: hesr run {study}\n")
    read = Study.read(study)
    assert read.name == "cell_7"
    assert "output_error" not in study.read_text(encoding="utf-8")  # of three joints
    job = Job(study=read, path=study, progress=silent)
    assert read.logs.test == {}
    assert read.logs.identification == read.logs.training == ("../messy.csv",)
    whole = Log.read(messy, RobotDescription.read(written))
    (name,) = read.logs.training
    np.testing.assert_array_equal(job.read(name, messy).t, whole.t)
    second = messy.with_name("second.csv")
    second.write_bytes(messy.read_bytes())
    hesr(*looked_at[:2], second, *looked_at[2:], "--study", folder / "run 1.toml")
    several = Study.read(folder / "run 1.toml")
    assert several.name == "run_1"
    assert several.logs.identification == ("../messy.csv", "../second.csv")
    assert several.logs.test == {}
    refused = hesr("inspect", messy, "--study", study)
    assert refused.code == 2
    assert refused.err.startswith("hesr: --study needs --write: a study names the robot file")


def test_a_proposed_study_says_how_logs_of_other_days_are_named(
    messy: Path, arm: RobotDescription, hesr: Hesr
) -> None:
    """All logs train; without its comment signs, the proposal of a test is part of the study."""
    robot, study = messy.with_name("robot.toml"), messy.with_name("study.toml")
    said = hesr("inspect", messy, "--robot", arm.model, "--write", robot, "--study", study)
    assert "too short" not in said.out
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace("# [logs.test]", "[logs.test]").replace("# test =", "test ="))
    assert Study.read(study).logs.test == {"test": ("other.csv",)}


def test_logs_that_each_move_one_joint_train_together(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription, hesr: Hesr
) -> None:
    files, robot = [], Robot(arm)
    for j in range(3):
        motion = make_motion(name=f"joint{j}", friction=0.8)
        own = np.arange(3) == j
        q = np.where(own, motion.q, 0.1)
        dq, ddq = (np.where(own, values, 0.0) for values in (motion.dq, motion.ddq))
        tau = robot.torque(robot.nominal_parameters, q, dq, ddq) + 0.8 * np.tanh(dq / 0.01)
        tau += np.random.default_rng(j).normal(0.0, 0.05, tau.shape)
        files.append(tmp_path / f"joint{j}.csv")
        Log(name=f"joint{j}", t=motion.t, q=q, dq=dq, tau=tau).write(files[-1])
    robot_file, study = tmp_path / "robot.toml", tmp_path / "study.toml"
    said = hesr("inspect", *files, "--robot", arm.model, "--write", robot_file, "--study", study)
    assert said.code == 0, said.out
    read = Study.read(study)
    assert read.logs.identification == ("joint0.csv", "joint1.csv", "joint2.csv")
    assert read.logs.test == {}
    # Ripple needs a gear ratio.
    of_load = ("lugre_load", "parfam_hx", "parfam_s")
    baselines = ("none", "constant", "coulomb_viscous")
    assert read.laws == (*baselines, "stribeck", "lugre", *of_load, "parfam_s_v")


def test_a_study_that_cannot_run_is_not_written(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription, hesr: Hesr
) -> None:
    """Joint 3 moves only at the end, and one way."""
    motion, robot = make_motion(name="late", friction=0.8), Robot(arm)
    rests = (motion.t < 0.9 * motion.t[-1])[:, None] & (np.arange(3) == 2)
    start = motion.q[motion.t >= 0.9 * motion.t[-1]][0]
    q = np.where(rests, start, motion.q)
    dq, ddq = (np.where(rests, 0.0, values) for values in (motion.dq, motion.ddq))
    tau = robot.torque(robot.nominal_parameters, q, dq, ddq) + 0.8 * np.tanh(dq / 0.01)
    tau += np.random.default_rng(1).normal(0.0, 0.05, tau.shape)
    log, study = tmp_path / "late.csv", tmp_path / "study.toml"
    Log(name="late", t=motion.t, q=q, dq=dq, tau=tau).write(log)
    given = ("--robot", arm.model, "--write", tmp_path / "robot.toml", "--study", study)
    said = hesr("inspect", log, *given)
    assert said.code == 1
    assert "error: the study is not written" in said.out
    assert "velocity of joint 'j3' never reverses" in said.out
    assert not study.exists()
    assert "file or the logs, then repeat" in said.out


def test_only_the_remedy_of_a_refusal_is_kept(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    """Swapped rows are sorted; rows are not dropped as well."""
    motion = make_motion(name="log", friction=0.8)
    tau = motion.tau + np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    path = tmp_path / "log.csv"
    Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=tau).write(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    lines[50], lines[51] = lines[51], lines[50]
    path.write_text("\n".join(lines), encoding="utf-8")
    found = propose([path], arm, has_model=True)
    assert (found.description.log.sort, found.description.log.missing) == (True, "refuse")
    assert set(found.reasons) == {"log.sort"}
    lines[60] = lines[60].replace(lines[60].split(",")[1], "", 1)
    lines.insert(71, lines[70])
    path.write_text("\n".join(lines), encoding="utf-8")
    found = propose([path], arm, has_model=True)
    assert set(found.reasons) == {"log.sort", "log.missing"}
    assert len(found.logs[0].t) == len(motion.t) - 1


def test_a_unit_is_sure_only_with_two_witnesses(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    """Limits of the model, and dq against the derivative of q."""
    motion = make_motion(name="log", friction=0.8)
    tau = motion.tau + np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    for dq, mark in ((motion.dq, "sure"), (np.degrees(motion.dq), "likely")):
        path = tmp_path / "log.csv"
        log = Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=tau)
        replace(log, q=np.degrees(motion.q), dq=dq).write(path)
        found = propose([path], arm, has_model=True)
        assert found.description.log.units.q == "deg"
        assert found.reasons["log.units.q"].startswith(f"{mark}: ")
        assert found.examination.findings == ()


def test_errors_that_no_change_removes_end_with_code_1(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription, hesr: Hesr
) -> None:
    motion = make_motion(name="log", friction=0.8)
    tau = motion.tau + np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    tau[:, 1] *= 0.01
    path, study = tmp_path / "log.csv", tmp_path / "study.toml"
    Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=tau).write(path)
    written = tmp_path / "robot.toml"
    given = ("--robot", arm.model, "--write", written, "--study", study)
    said = hesr("inspect", path, *given)
    assert said.code == 1
    assert "[torque-scale]" in said.out
    assert written.exists()
    assert not study.exists()
    assert said.out.endswith(f"repeat hesr inspect with --robot {written}\n")


def test_mixed_names_are_recognised(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    motion = make_motion(name="log", friction=0.8)
    path = tmp_path / "log.csv"
    Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau).write(path)
    head, *rows = path.read_text(encoding="utf-8").splitlines()
    head = re.sub(r"(q|dq|tau)1", r"\1_base", re.sub(r"(q|dq|tau)([23])", r"\1_\2", head))
    path.write_text("\n".join([head, *rows]), encoding="utf-8")
    assert propose([path], arm, has_model=True).description.log.columns.tau == (
        "tau_base",
        "tau_2",
        "tau_3",
    )


def test_a_clean_log_has_no_findings(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription, hesr: Hesr
) -> None:
    motion = make_motion(name="clean", friction=0.8)
    noise = np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    path = tmp_path / "clean.csv"
    Log(name="clean", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise).write(path)
    answer = tmp_path / "answer.json"
    # Damping of the model file is a finding: it is not in the torques of the bodies.
    model = tmp_path / "undamped.xml"
    text = arm.model.read_text(encoding="utf-8")
    model.write_text(re.sub(r' damping="[^"]*"', "", text), encoding="utf-8")
    said = hesr("inspect", path, "--robot", model, "--json", answer)
    assert said.code == 0
    assert "Nothing wrong or unusual was found." in said.out
    envelope = json.loads(answer.read_text("utf-8"))
    assert (envelope["passed"], envelope["findings"]) == (True, [])
    empty: dict[str, object] = {key: [] for key in ("given", "proposed", "undecided")}
    empty |= {"choices": {}, "reasons": {}, "torque_constants": []}
    assert envelope["result"] == empty


@pytest.fixture
def partly_at_rest(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> Path:
    """A log with temperatures of an arm whose second joint rests at 0.3 rad."""
    motion, robot = make_motion(name="rest", friction=0.8), Robot(arm)
    q, dq, ddq = motion.q.copy(), motion.dq.copy(), motion.ddq.copy()
    q[:, 1], dq[:, 1], ddq[:, 1] = 0.3, 0.0, 0.0
    tau = robot.torque(robot.nominal_parameters, q, dq, ddq) + 0.8 * np.tanh(dq / 0.01)
    tau += np.random.default_rng(1).normal(0.0, 0.05, tau.shape)
    heat = np.tile([30.0, 40.0, 50.0], (len(q), 1))
    path = tmp_path / "rest.csv"
    Log(name="rest", t=motion.t, q=q, dq=dq, tau=tau, temperature=heat).write(path)
    return path


def test_resting_joints_are_proposed_as_locked(
    partly_at_rest: Path, arm: RobotDescription, hesr: Hesr
) -> None:
    written, study = (partly_at_rest.with_name(name) for name in ("robot.toml", "study.toml"))
    arguments = ("--robot", arm.model, "--write", written, "--study", study)
    said = hesr("inspect", partly_at_rest, *arguments)
    assert said.code == 0, said.err
    assert "proposed: locked: likely: j2 rests in all logs\n" in said.out
    found = RobotDescription.read(written)
    assert (found.joints, found.locked) == (("j1", "j3"), {"j2": 0.3})
    log = Log.read(partly_at_rest, found)
    assert log.temperature is not None
    np.testing.assert_array_equal(log.temperature[0], [30.0, 50.0])
    robot = Robot(found)
    assert identify([log], robot).rmse[1] < 0.2
    still = np.zeros((len(log.q), 2))
    gravity = robot.torque(robot.nominal_parameters, log.q, still, still)
    whole = Robot(arm)
    q = np.insert(log.q, 1, 0.3, axis=1)
    expected = whole.torque(whole.nominal_parameters, q, 0.0 * q, 0.0 * q)[:, [0, 2]]
    np.testing.assert_allclose(gravity, expected, atol=1e-9)


def test_joints_are_selected_and_keep_their_columns(
    partly_at_rest: Path, arm: RobotDescription, hesr: Hesr
) -> None:
    written = partly_at_rest.with_name("robot.toml")
    arguments = ("inspect", partly_at_rest, "--joints", "j1, j2")
    said = hesr(*arguments, "--joints", "j3", "--robot", arm.model, "--write", written)
    assert said.code == 0, said.err
    found = RobotDescription.read(written)
    assert (found.joints, found.log.columns.q) == (("j1", "j3"), ("q1", "q3"))
    said = hesr("inspect", partly_at_rest, "--joints", "j3", "--robot", written)
    assert said.code == 0, said.err
    said = hesr(*arguments, "--robot", written)
    assert (said.code, said.err) == (2, "hesr: robot 'arm' has no joint 'j2'; it has j1, j3.\n")
    said = hesr(*arguments)
    assert said.err == OneSentence("hesr: --joints needs --robot: joints")


def test_joints_with_a_transmission_are_not_locked(arm: RobotDescription) -> None:
    coupled = apply_changes(arm, {"transmission": {"matrix": np.eye(3).tolist()}})
    with pytest.raises(RobotError, match=r"\[transmission\], whose motors turn joints"):
        remove_joints(coupled, {"j2": 0.0})


def test_joints_are_recognised_by_name_and_number(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    """A log of an arm on a base with wheels."""
    wheels = "".join(
        f'<body name="w{k}"><joint name="wheel{k}"/><geom size=".1" mass="1"/></body>'
        for k in range(2)
    )
    text = arm.model.read_text(encoding="utf-8").replace("</worldbody>", f"{wheels}</worldbody>")
    model = tmp_path / "mobile.xml"
    model.write_text(text, encoding="utf-8")
    motion = make_motion(name="log", friction=0.8)
    log = Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau)
    path = tmp_path / "log.csv"
    for columns, reason in (("q1", "the log has 3 positions"), ("j1_q", "named in the columns")):
        log.write(path)
        lines = path.read_text(encoding="utf-8").splitlines()
        if columns == "j1_q":
            lines[0] = re.sub(r"\b(q|dq|tau)(\d)", r"j\2_\1", lines[0])
        path.write_text("\n".join(lines), encoding="utf-8")
        proposal = inspect_logs([path], model)
        assert proposal.description.joints == ("j1", "j2", "j3")
        assert proposal.reasons["joints"] == f"likely: {reason}"
        assert proposal.description.locked == {"wheel0": 0.0, "wheel1": 0.0}


def test_logs_are_inspected_without_a_robot(messy: Path, hesr: Hesr) -> None:
    said = hesr("inspect", messy, "--verbose")
    assert said.code == 0
    assert "joint3" in said.out
    refused = hesr("inspect", messy, "--write", messy.with_name("robot.toml"))
    assert refused.code == 2
    assert refused.err == OneSentence("hesr: --write needs --robot: a robot")


def test_mistakes_are_fixed_in_the_proposal(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    motion = make_motion(name="wrong", friction=0.8)
    noise = np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    tau = (motion.tau + noise) * [-1.0, 1.0, -1.0]
    path = tmp_path / "wrong.csv"
    dq = motion.dq[:, [0, 2, 1]]
    Log(name="wrong", t=motion.t, q=motion.q, dq=dq, tau=tau).write(path)
    proposal = propose([path], arm, has_model=True)
    assert proposal.description.log.units.tau == ("-N.m", "N.m", "-N.m")
    assert proposal.description.log.columns.dq == ("dq1", "dq3", "dq2")
    assert proposal.examination.findings == ()
    assert {f.check for f in proposal.first_findings} == {"velocity-columns", "torque-sign"}


def test_stated_torque_constants_are_kept(
    tmp_path: Path, make_motion: Callable[..., Motion], arm: RobotDescription
) -> None:
    """A sign is fixed; the rougher constants from the model's masses do not replace the maker's."""
    motion = make_motion(name="wrong", friction=0.8)
    noise = np.random.default_rng(1).normal(0.0, 0.05, motion.tau.shape)
    current = (motion.tau + noise) / GAINS * [1.0, 1.0, -1.0]
    columns = {"q": motion.q, "dq": motion.dq, "i": current}
    names = ["t", *(f"{name}{k}" for name in columns for k in (1, 2, 3))]
    path = tmp_path / "wrong.csv"
    table = np.column_stack([motion.t, *columns.values()])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")
    stated = tuple(1.2 * GAINS)
    log = arm.log.model_copy(update={"torque_per_ampere": stated})
    robot = propose([path], arm.model_copy(update={"log": log}), has_model=True).description
    assert robot.log.torque_per_ampere == (*stated[:2], -stated[2])


def test_a_table_without_time_is_refused(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "odd.csv"
    path.write_text("q1,q2\n" + "1,2\n" * 9, encoding="utf-8")
    said = hesr("inspect", path)
    assert said.code == 2
    assert "q1, q2; name it under 'log.columns.t'" in said.err


def test_damaged_findings_of_a_run_are_refused(tmp_path: Path) -> None:
    (tmp_path / "health.json").write_text(
        '{"format": "hesr-health-1", "findings": [{}]}', encoding="utf-8"
    )
    with pytest.raises(ArtifactError, match=r"health\.json: key 'findings\.0\.check' is missing"):
        read_findings(tmp_path)
    assert read_findings(tmp_path / "earlier") == []


def test_a_part_of_a_log_must_have_rows(messy: Path, arm: RobotDescription) -> None:
    part = {"log": messy.name, "start": 50.0}
    logs = {"identification": ["a"], "test": {"b": ["b"]}, "parts": {"a": part}}
    robot = messy.with_name("robot.toml")
    robot.write_text(robot_file(propose([messy], arm, has_model=True), robot), encoding="utf-8")
    study = Study.model_validate(
        {"name": "cut", "robot": robot, "laws": ["stribeck"], "logs": logs},
        context={"folder": messy.parent},
    )
    job = Job(study=study, path=messy.with_name("study.toml"), progress=silent)
    with pytest.raises(LogError, match=r"rows from 50 to 1e\+09 s"):
        job.read("a", messy)


def test_a_part_is_tested_after_the_earlier_rows(messy: Path, arm: RobotDescription) -> None:
    """The log has a gap at 4 s, which splits the part in two."""
    robot = messy.with_name("robot.toml")
    robot.write_text(robot_file(propose([messy], arm, has_model=True), robot), encoding="utf-8")
    log = Log.read(messy, RobotDescription.read(robot))
    assert log.dq is not None
    since, dq = log.t - log.t[0], log.dq[:, 0]
    begin = float(since[1:][(since[1:] > 1.0) & (dq[1:] * dq[:-1] < 0.0)][0])  # it reverses
    logs = {
        "identification": ["a"],
        "test": {"b": ["b"]},
        "parts": {
            "a": {"log": messy.name, "stop": 9.0},
            "b": {"log": messy.name, "start": begin},
        },
    }
    study = Study.model_validate(
        {"name": "cut", "robot": robot, "laws": ["lugre"], "logs": logs},
        context={"folder": messy.parent},
    )
    job = Job(study=study, path=messy.with_name("study.toml"), progress=silent)
    output = messy.with_name("out")
    output.mkdir()
    with parallel.one_pool():
        run = score_study(job, output)
    whole = job.read_with_history("b", messy)
    assert whole is not None
    assert whole.t[0] == job.read("a", messy).t[0]
    assert job.read_with_history("a", messy) is None
    assert len(run.records["b"]) == 2
    law = run.models["lugre"].laws[0]
    for k, rows in enumerate(run.logs["b"].parts()):
        record = friction_records(whole.parts()[k - 2], run.robot, run.rigid_body)[0]
        expected = predict_record(law, record.causal)[-len(rows.t) :]
        found = run.predictions["b"]["lugre"][0][k]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(run.records["b"][k][0].t, rows.t)
        np.testing.assert_array_equal(run.records["b"][k][0].tau, record.tau[-len(rows.t) :])
    alone = predict_record(law, run.records["b"][0][0].causal)
    assert np.abs(alone - run.predictions["b"]["lugre"][0][0]).max() > 0.01


def test_a_table_without_positions_is_refused(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "odd.csv"
    path.write_text("time,a,b\n" + "".join(f"{k},1,2\n" for k in range(9)), encoding="utf-8")
    said = hesr("inspect", path)
    assert said.code == 2
    assert "it has time, a, b" in said.err


def test_a_number_of_5000_digits_in_a_name_is_not_a_joint(tmp_path: Path, hesr: Hesr) -> None:
    path = tmp_path / "odd.csv"
    names = ["t", "q1", "q2", f"q{'9' * 5000}"]
    rows = [f"{0.01 * k},1,2,3" for k in range(9)]
    path.write_text("\n".join([",".join(names), *rows]), encoding="utf-8")
    said = hesr("inspect", path)
    assert said.code == 2
    assert said.err.startswith(f"hesr: {path}: column 'tau1' (torque) or 'i1' (current)")
    assert len(said.err) < 400


@pytest.mark.parametrize(
    ("names", "quantity", "unit"),
    [
        (["shoulder_joint.torque", "elbow_joint.torque"], "tau", None),
        (["joint1_torque", "joint2_torque"], "tau", None),
        (["axis1_current_mA", "axis2_current_mA"], "current", "mA"),
        (["joint_1", "joint_2"], "q", None),
        (["J1 vel [deg/s]", "J2 vel [deg/s]"], "dq", "deg/s"),
    ],
)
def test_a_joint_word_does_not_hide_the_quantity(
    names: list[str], quantity: str, unit: str | None
) -> None:
    columns = {"t": 0.01 * np.arange(5), "q1": np.arange(5.0), "q2": np.arange(5.0)}
    table = build_table(Path("log"), columns | {name: np.arange(5.0) for name in names})
    found = guess_columns(table, ("shoulder_joint", "elbow_joint"))
    if quantity != "q":
        assert found.columns[quantity] == tuple(names)
    assert found.units.get(quantity) == unit
