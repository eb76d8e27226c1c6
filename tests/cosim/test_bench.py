"""Benches without a model: from a motor's or axis's log to its FMU in three commands."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import ROOT
from small_study import Hesr, hesr_here

import hesr as api
from cosim.study.bench import Bench, start_bench
from fmu_src.run.replay import replay
from hesr_model.errors import ArgumentError, FitError, RobotError
from hesr_model.health.proposal import inspected
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.accumulation import Streamed
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.observations import slow_speeds
from hesr_model.logs.signals import smooth
from hesr_model.robots.robot import Robot

Columns = Mapping[str, np.ndarray]

MOTOR = """<robot name="bench"><link name="base"/><link name="rotor"><inertial><mass value="0.5"/>
<origin xyz="0 0 0"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
</link><joint name="j1" type="continuous"><parent link="base"/><child link="rotor"/>
<axis xyz="0 0 1"/></joint></robot>"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A body with Coulomb and viscous friction, in a motion of some sines."""

    inertia: float
    coulomb: float
    knee: float
    viscous: float
    speeds: Sequence[float]  # amplitudes
    rates: Sequence[float]  # [Hz]
    drift: float = 0.0
    moment: float = 0.0
    phase: float = 0.0
    weight: float = 0.0
    noise: float

    def friction(self, dq: np.ndarray) -> np.ndarray:
        return self.coulomb * np.tanh(dq / self.knee) + self.viscous * dq

    def columns(self, t: np.ndarray) -> Columns:
        rate, size = 2 * np.pi * np.array(self.rates), np.array(self.speeds)
        angle = np.outer(t, rate) + np.arange(len(rate))
        q = self.drift * t + np.sin(angle) @ (size / rate)
        dq, ddq = self.drift + np.cos(angle) @ size, -np.sin(angle) @ (size * rate)
        tau = self.inertia * ddq + self.moment * np.sin(q - self.phase) + self.weight
        noise = np.random.default_rng(0).normal(0.0, self.noise, len(t))
        return {"t": t, "q": q, "dq": dq, "tau": tau + self.friction(dq) + noise}

    def worst(self, friction: Callable[[np.ndarray], np.ndarray]) -> float:
        """The largest relative error of sliding friction, for speeds [SI] held for .5 s."""
        speeds = sum(self.speeds) * np.linspace(0.15, 0.8, 8)
        errors = []
        for speed in np.concatenate([speeds, -speeds]):
            true = self.friction(speed)
            errors.append(abs(friction(np.full((100, 1), speed))[-1, 0] / true - 1.0))
        return float(max(errors))


SPIN = Truth(
    inertia=0.01, coulomb=0.3, knee=0.05, viscous=0.02, noise=0.01,
    speeds=(7.0, 4.0, 2.0), rates=(0.1, 0.225, 0.25), drift=0.5,
)  # fmt: skip
AXIS = Truth(
    inertia=80.0, coulomb=18.0, knee=0.002, viscous=150.0, noise=1.5,
    speeds=(0.1257,), rates=(1.0 / 6.0,),
)  # fmt: skip
PENDULUM = Truth(
    inertia=0.05, coulomb=0.3, knee=0.05, viscous=0.02, noise=0.02, moment=1.5, phase=0.4,
    speeds=(1.5, 1.0, 0.5), rates=(0.1, 0.23, 0.41),
)  # fmt: skip
LIFT = Truth(
    inertia=80.0, coulomb=18.0, knee=0.002, viscous=150.0, noise=1.5, weight=784.8,
    speeds=(0.06, 0.04), rates=(0.1, 0.23),
)  # fmt: skip

SPUN, SLID = np.arange(6000) / 200.0, np.arange(2400) / 100.0


def write(path: Path, columns: Columns, form: str = "%.7g", names: bool = True) -> Path:
    head = ",".join(columns) if names else ""
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, form, "," if names else "\t", header=head, comments="")
    return path


def spin(folder: Path) -> Path:
    c = SPIN.columns(SPUN)
    return write(folder / "spin.csv", {"t": c["t"], "q1": c["q"], "dq1": c["dq"], "tau1": c["tau"]})


def one_motor(folder: Path) -> Path:
    c = SPIN.columns(SPUN)
    own = {"time": c["t"], "motor_pos": c["q"], "motor_vel": c["dq"], "motor_current": c["tau"] / 0.2}
    return write(folder / "one_motor.csv", own)


def uart(folder: Path) -> Path:
    steps = np.random.default_rng(1).choice([0.03, 0.04, 0.05, 0.08], 1500, p=[0.4, 0.3, 0.2, 0.1])
    c = SPIN.columns(np.cumsum(steps))
    return write(folder / "uart.csv", {"t": c["t"], "q1": c["q"], "dq1": c["dq"], "tau1": c["tau"]})


def archive(folder: Path) -> Path:
    c = {name: column[:, None] for name, column in AXIS.columns(SLID).items()}
    path = folder / "axis.npz"
    np.savez(path, time=c["t"][:, 0], q=c["q"], qd=c["dq"], tau_measured=c["tau"])
    return path


def without_header(folder: Path) -> Path:
    c = AXIS.columns(SLID)
    scaled = {"t": 1e3 * c["t"], "q": 1e3 * c["q"], "dq": 1e3 * c["dq"], "i": c["tau"] / 40.0}
    return write(folder / "axis.txt", scaled, names=False)


def without_time(folder: Path) -> Path:
    c = AXIS.columns(SLID)
    target = c["q"] + 0.002 * np.sin(c["t"])
    own = {"tau_est_0": c["tau"], "joint_pos_0": c["q"], "joint_pos_target_0": target}
    return write(folder / "axis.csv", {**own, "joint_vel_0": c["dq"]}, "%.6g")


def encoder(folder: Path) -> Path:
    """12 bits per turn, the velocity of a drive, and noise of the current."""
    c = SPIN.columns(SPUN)
    grid = 2 * np.pi / 4096
    current = c["tau"] / 0.2 + np.random.default_rng(2).normal(0.0, 0.05, len(SPUN))
    own = {"time": c["t"], "position": np.round(c["q"] / grid) * grid, "current": current}
    return write(folder / "encoder.csv", own)


def pendulum(folder: Path) -> Path:
    c = PENDULUM.columns(SPUN)
    own = {"time": c["t"], "angle": c["q"], "speed": c["dq"], "torque": c["tau"]}
    return write(folder / "pendulum.csv", own)


def lift(folder: Path) -> Path:
    c = LIFT.columns(SLID)
    own = {"time": c["t"], "position": c["q"], "velocity": c["dq"], "force": c["tau"]}
    return write(folder / "lift.csv", own)


@dataclass(frozen=True, kw_only=True)
class Case:
    log: Callable[[Path], Path]
    truth: Truth
    new: Sequence[object] = ()  # none with the URDF of the motor
    api: Mapping[str, Any] = field(default_factory=dict)


AMPERES = ("--log", "torque_per_ampere=[0.2]")
SCALED = (
    *("--log", 'columns=["t","q","dq","i"]', "--log", "torque_per_ampere=[40.0]"),
    *("--log", 'units={t="ms",q="mm"}', "--log", 'units.dq="mm/s"'),
)
HUNG = ("--moment", "1.5", "--phase", "0.4", "--inertia", "0.05")
CASES = {
    "spin": Case(log=spin, truth=SPIN),
    "uart": Case(log=uart, truth=SPIN),
    "one motor": Case(log=one_motor, truth=SPIN, new=("rotary", *AMPERES)),
    "encoder": Case(log=encoder, truth=SPIN, new=("rotary", "--inertia", "0.01", *AMPERES)),
    "archive": Case(log=archive, truth=AXIS, new=("sliding",)),
    "no header": Case(log=without_header, truth=AXIS, new=("sliding", *SCALED)),
    "no time": Case(log=without_time, truth=AXIS, new=("sliding", "--log", "rate=100")),
    "known mass": Case(log=archive, truth=AXIS, new=("sliding", "--inertia", "80")),
    "pendulum": Case(log=pendulum, truth=PENDULUM, new=("rotary", "--gravity")),
    "known pendulum": Case(log=pendulum, truth=PENDULUM, new=("rotary", *HUNG)),
    "lift": Case(log=lift, truth=LIFT, new=("sliding", "--gravity", "--inertia", "80")),
}


def inspect(name: str, folder: Path, hesr: Hesr) -> tuple[Path, list[str]]:
    """Create the bench of a case and inspect its log; return the log and the next command."""
    case = CASES[name]
    log, robot, study = case.log(folder), folder / "bench" / "robot.toml", folder / "study.toml"
    given = model = folder / "motor.urdf"
    model.write_text(MOTOR, encoding="utf-8")
    if case.new:
        answer = hesr("new", folder / "bench", "--bench", *case.new)
        assert (answer.code, answer.err) == (0, "")
        _, command = answer.out.splitlines()
        own = folder / "bench" / "study.toml"
        options = f"--robot {robot} --write {robot} --study {own}"
        assert command == f"Next: hesr inspect LOG {options}"
        given, study = robot, own
    answer = hesr("inspect", log, "--robot", given, "--write", robot, "--study", study)
    assert (answer.code, answer.err) == (0, "")
    assert answer.out.startswith("Nothing wrong or unusual was found.\n")
    return log, answer.out.splitlines()[-1].removeprefix("Next: hesr ").split()


@pytest.mark.parametrize("name", CASES)
def test_a_log_is_inspected_without_a_finding_and_fitted(
    tmp_path: Path, hesr: Hesr, name: str
) -> None:
    log, _ = inspect(name, tmp_path, hesr)
    law = api.fit(log, robot=tmp_path / "bench" / "robot.toml", law="stribeck")
    t = np.arange(100) * 0.005
    assert CASES[name].truth.worst(lambda dq: law.predict(t=t, dq=dq)) < 0.03


@pytest.mark.ci
@pytest.mark.parametrize("name", ["encoder", "archive", "uart", "known pendulum"])
def test_three_commands_lead_to_an_fmu(tmp_path: Path, hesr: Hesr, name: str) -> None:
    _, command = inspect(name, tmp_path, hesr)
    answer = hesr(*command, "-o", tmp_path / "results")
    assert (answer.code, answer.err) == (0, "")
    advised = re.search(r"Recommended: (\S+\.fmu)", answer.out)
    assert advised, answer.out
    t = np.arange(100) * 0.005
    assert CASES[name].truth.worst(lambda dq: replay(Path(advised[1]), t, dq)) < 0.03
