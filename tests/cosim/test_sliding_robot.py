"""A robot with a prismatic joint end to end: created, fitted, its friction connected to its arm."""

from pathlib import Path

import numpy as np
import pytest
from small_study import Hesr, hesr_here

from hesr_model.friction.model import FrictionModel
from hesr_model.logs.tables import read_table

LIFT = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="column">
      <joint name="lift" type="slide" axis="0 0 1" range="-0.5 0.5" stiffness="800"/>
      <geom type="box" size="0.1 0.1 0.1" mass="4"/>
      <body name="forearm">
        <joint name="arm" axis="0 0 1" range="-90 90" stiffness="9"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0.5 0 0" mass="2"/>
      </body>
    </body>
  </worldbody>
  <sensor>
    <jointpos name="place" joint="lift"/><jointvel name="speed" joint="lift"/>
    <jointpos name="angle" joint="arm"/><jointvel name="turning" joint="arm"/>
  </sensor>
</mujoco>
"""

SYSTEM = """
name = "lift"
step = 0.005
stop = 0.5
observe = ["friction.tau[1]", "friction.tau[2]", "arm.speed"]

[[components]]
name = "arm"
fmu = "Arm.fmu"

[[components]]
name = "friction"
fmu = "Friction.fmu"
start = { tau_load = 0.0 }

[connections]
"friction.dq[1]" = "arm.speed"
"friction.q[1]" = "arm.place"
"friction.dq[2]" = "arm.turning"
"friction.q[2]" = "arm.angle"
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.mark.ci
def test_a_log_leads_to_an_arm_with_its_friction(tmp_path: Path, hesr: Hesr) -> None:
    mjcf, law, body = (tmp_path / name for name in ("lift.xml", "law.json", "body.json"))
    mjcf.write_text(LIFT, encoding="utf-8")
    (tmp_path / "system.toml").write_text(SYSTEM, encoding="utf-8")

    def done(*arguments: object) -> str:
        answer = hesr(*arguments)
        assert answer.code == 0, answer.err
        return answer.out

    done("new", tmp_path / "lift", "--robot", mjcf)
    robot = ("--robot", tmp_path / "lift" / "robot.toml")
    training = tmp_path / "lift" / "logs" / "sample_training.csv"
    assert "N.m (N where it slides).\n" in done("identify", training, *robot, "-o", body)

    given = (*robot, "--rigid-body", body)
    said = done("fit", training, *given, "--law", "stribeck", "-o", law, "--verbose")
    lift, arm = said.partition("\nlift: 95 % intervals")[2].split("\narm: 95 % intervals")
    assert " N.s/m" in lift
    assert " N.m.s/rad" not in lift
    assert " N.m.s/rad" in arm
    assert "Slope dtau/ddq at rest [N.m.s/rad (N.s/m where it slides)]" in " ".join(said.split())
    assert FrictionModel.read(law).sliding == (True, False)
    said = done("test", law, "--on", training, *given, "--verbose")
    assert "predicted torque [N.m (N where it slides)] over all rows" in " ".join(said.split())

    assert "the position [mrad (mm where it slides)]" in " ".join(said.split())

    done("export", law, "-o", tmp_path / "Friction.fmu")
    done("export", mjcf, "-o", tmp_path / "Arm.fmu")
    done("simulate", tmp_path / "system.toml", "-o", tmp_path / "lift.csv")
    rows = read_table(tmp_path / "lift.csv").numbers(["friction.tau[1]", "arm.speed"])
    assert np.abs(rows).max(axis=0).min() > 0.1
