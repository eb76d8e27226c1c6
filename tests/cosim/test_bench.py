"""Benches without a model: from a motor's or axis's log to its FMU in three commands."""

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from containing import Containing
from documents import ROOT
from small_study import Hesr, contents, hesr_here

import hesr as api
from fmu_src.friction.replay import replay
from hesr_model.errors import ArgumentError, FitError
from hesr_model.health.joints import apply_changes
from hesr_model.health.proposal import inspect_logs
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.accumulation import StreamedProblem
from hesr_model.rigid_body.identification import identify
from hesr_model.robots.robot import Robot, RobotDescription

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
        """The largest relative error of sliding friction, for speeds [SI] held for 0.5 s."""
        speeds = sum(self.speeds) * np.linspace(0.15, 0.8, 8)
        errors = []
        for speed in np.concatenate([speeds, -speeds]):
            true = self.friction(speed)
            errors.append(abs(friction(np.full((100, 1), speed))[-1, 0] / true - 1.0))
        return float(max(errors))


SPIN = Truth(
    inertia=0.01,
    coulomb=0.3,
    knee=0.05,
    viscous=0.02,
    noise=0.01,
    speeds=(7.0, 4.0, 2.0),
    rates=(0.1, 0.225, 0.25),
    drift=0.5,
)
AXIS = Truth(
    inertia=80.0,
    coulomb=18.0,
    knee=0.002,
    viscous=150.0,
    noise=1.5,
    speeds=(0.1257,),
    rates=(1.0 / 6.0,),
)
PENDULUM = Truth(
    inertia=0.05,
    coulomb=0.3,
    knee=0.05,
    viscous=0.02,
    noise=0.02,
    moment=1.5,
    phase=0.4,
    speeds=(1.5, 1.0, 0.5),
    rates=(0.1, 0.23, 0.41),
)
LIFT = Truth(
    inertia=80.0,
    coulomb=18.0,
    knee=0.002,
    viscous=150.0,
    noise=1.5,
    weight=784.8,
    speeds=(0.06, 0.04),
    rates=(0.1, 0.23),
)

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
    own = {
        "time": c["t"],
        "motor_pos": c["q"],
        "motor_vel": c["dq"],
        "motor_current": c["tau"] / 0.2,
    }
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


MX, MZ = 1.5 / 9.81 * np.sin(0.4), -1.5 / 9.81 * np.cos(0.4)  # first moments [kg.m]
AMPERES = ("--log", "torque_per_ampere=0.2")
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
    assert '# refinement = "output_error"' in study.read_text(encoding="utf-8")
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
@pytest.mark.parametrize("name", ["archive", "known pendulum"])
def test_three_commands_lead_to_an_fmu(tmp_path: Path, hesr: Hesr, name: str) -> None:
    """A sliding axis and a body with gravity; a motor is in the documentation's commands."""
    _, command = inspect(name, tmp_path, hesr)
    answer = hesr(*command, "-o", tmp_path / "results")
    assert (answer.code, answer.err) == (0, "")
    advised = re.search(r"Recommended: (\S+\.fmu)", answer.out)
    assert advised, answer.out
    t = np.arange(100) * 0.005
    assert CASES[name].truth.worst(lambda dq: replay(Path(advised[1]), t, dq)) < 0.03


def test_the_command_line_and_python_create_the_same_bench(tmp_path: Path, hesr: Hesr) -> None:
    numbers = ("--inertia", "2,1", "--moment", "1", "--phase", "0,0.5", "--gear-ratio", "100")
    log = (
        "--log",
        "torque_per_ampere=[3.0,2.0]",
        "--log",
        'units.q="deg"',
        "--log",
        "units.t='ms'",
    )
    hesr("new", tmp_path / "a" / "b", "--bench", "rotary", "--joints", "x,y", *numbers, *log)
    made = api.new(
        tmp_path / "c" / "b",
        bench="rotary",
        joints=["x", "y"],
        inertia=(2.0, 1.0),
        moment=1.0,
        phase=[0.0, 0.5],
        gear_ratio=100,
        log={"torque_per_ampere": [3.0, 2.0], "units": {"q": "deg", "t": "ms"}},
    )
    assert made.joints == ("x", "y")
    assert contents(tmp_path / "a") == contents(tmp_path / "c")
    assert set(contents(tmp_path / "c")) == {"b/bench.urdf", "b/robot.toml"}


def test_one_torque_constant_and_its_source_are_those_of_all_motors(
    tmp_path: Path, hesr: Hesr
) -> None:
    given = ("new", tmp_path / "b", "--bench", "rotary", "--joints", "x,y")
    assert hesr(*given, *AMPERES, "--source", "datasheet").code == 0
    robot = RobotDescription.read(tmp_path / "b" / "robot.toml")
    assert robot.log.torque_per_ampere == (0.2, 0.2)
    assert robot.sources.expand_per_joint("torque_per_ampere", 2) == ("datasheet", "datasheet")
    said = hesr(*given, "--source", "measured")
    assert said.code == 2
    assert said.err.startswith("hesr: --source needs 'torque_per_ampere' in --log, whose source")


def test_known_numbers_of_a_pendulum_are_those_of_its_model(tmp_path: Path) -> None:
    """tau = inertia ddq + moment sin(q - phase), also of several joints and vertical axes."""
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 2))
    inertia, moment, phase = np.array([[0.05, 2.0], [1.5, 0.1], [0.4, -3.0]])
    known: dict[str, Any] = {
        "inertia": inertia.tolist(),
        "moment": moment.tolist(),
        "phase": phase.tolist(),
    }
    api.new(tmp_path / "a", bench="rotary", joints=["x,y"], **known)
    robot = Robot(tmp_path / "a" / "robot.toml")
    tau = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(tau, inertia * ddq + moment * np.sin(q - phase), atol=1e-9)
    api.new(tmp_path / "b", bench="sliding", joints=["x,y"], inertia=[80.0, 3.0], gravity=True)
    robot = Robot(tmp_path / "b" / "robot.toml")
    tau = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(tau, np.array([80.0, 3.0]) * (ddq + 9.81), atol=1e-9)


@pytest.mark.parametrize(
    ("given", "known", "unknown"),
    [
        ({"gravity": True}, {}, {"Iyy": 0.05, "mx": MX, "mz": MZ}),
        ({"inertia": 0.05, "gravity": True}, {"Iyy": 0.05}, {"mx": MX, "mz": MZ}),
        ({"moment": 1.5, "phase": 0.4}, {"mx": MX, "mz": MZ}, {"Iyy": 0.05}),
        ({"moment": 1.5, "phase": 0.4, "inertia": 0.05}, {"Iyy": 0.05, "mx": MX, "mz": MZ}, {}),
    ],
)
def test_numbers_are_known_or_identified(
    tmp_path: Path, given: Mapping[str, Any], known: Columns, unknown: Columns
) -> None:
    api.new(tmp_path / "bench", bench="rotary", **given)
    proposal = inspect_logs([pendulum(tmp_path)], tmp_path / "bench" / "robot.toml")
    robot = Robot(proposal.description)
    body = identify(proposal.logs, robot)
    found = dict(zip(body.names, body.parameters, strict=True))
    assert {body.names[k] for k in body.base} == {f"motor.{name}" for name in unknown}
    for name, value in known.items():
        assert found[f"motor.{name}"] == pytest.approx(value, rel=1e-12, abs=0.0)
    for name, value in unknown.items():
        assert found[f"motor.{name}"] == pytest.approx(value, rel=0.01)
    coulomb, viscous, offset = body.friction[0]
    assert coulomb + 2.0 * viscous == pytest.approx(PENDULUM.friction(np.array(2.0)), rel=0.01)
    assert offset == pytest.approx(0.0, abs=0.005)
    # A fleet adds the same rows one log at a time.
    motion = smooth(proposal.logs[0], proposal.description.log.filter_cutoff)
    stream = StreamedProblem(robot)
    stream.add(motion)
    assert stream.is_consistent
    streamed = stream.body([motion], "the log").parameters
    np.testing.assert_allclose(streamed, body.parameters, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["one motor", "encoder", "pendulum", "known pendulum", "archive"])
def test_a_torque_that_counts_backwards_is_found(tmp_path: Path, hesr: Hesr, name: str) -> None:
    """Also where the body is identified from that torque."""
    log, _ = inspect(name, tmp_path, hesr)
    robot = RobotDescription.read(tmp_path / "bench" / "robot.toml")
    gains = robot.log.torque_per_ampere
    changes: dict[str, Any] = {"log.units.tau": "-N" if name == "archive" else "-N.m"}
    if gains:
        changes = {"log.torque_per_ampere": tuple(-gain for gain in gains)}
    proposal = inspect_logs([log], apply_changes(robot, changes))
    (found,) = proposal.first_findings
    assert (found.check, found.severity) == ("torque-sign", "error")
    assert proposal.examination.findings == ()


@pytest.mark.parametrize("logged", [False, True], ids=["position", "position and velocity"])
def test_millimetres_are_found(logged: bool, tmp_path: Path) -> None:
    t = np.arange(0.0, 40.0, 0.005)
    x, v = 150.0 * np.sin(0.8 * t), 120.0 * np.cos(0.8 * t)  # mm, mm/s
    force = 80.0 * -0.096 * np.sin(0.8 * t) + 40.0 * np.tanh(v) + 0.1 * v
    columns = {"time": t, "position": x} | ({"velocity": v} if logged else {}) | {"force": force}
    path = tmp_path / "axis.csv"
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.9g", ",", header=",".join(columns), comments="")
    api.new(tmp_path / "axis", bench="sliding")
    robot = tmp_path / "axis" / "robot.toml"
    found = api.inspect(path, robot=robot, write=robot)
    units = RobotDescription.read(robot).log.units
    assert (units.q, units.dq) == ("mm", "mm/s" if logged else "rad/s")
    assert not [f for f in found.findings if f.severity == "error"]
    assert not api.inspect(path, robot=robot).findings


def test_a_joint_that_rests_is_locked(tmp_path: Path) -> None:
    api.new(tmp_path / "bench", bench="rotary", joints=["a,b"], inertia=[0.01, 2.0])
    c = SPIN.columns(SPUN)
    still = dict.fromkeys(("q2", "dq2", "tau2"), np.zeros_like(SPUN))
    log = write(
        tmp_path / "log.csv", {"t": c["t"], "q1": c["q"], "dq1": c["dq"], "tau1": c["tau"], **still}
    )
    proposal = inspect_logs([log], tmp_path / "bench" / "robot.toml")
    assert (proposal.description.known, proposal.description.locked) == (("a.Izz",), {"b": 0.0})
    assert not proposal.first_findings
    assert [finding.check for finding in proposal.examination.findings] == ["left-over"]
    assert identify(proposal.logs, Robot(proposal.description)).parameters.max() == 0.01


def test_a_bench_that_rests_has_no_body_to_check(tmp_path: Path) -> None:
    api.new(tmp_path / "bench", bench="rotary")
    slow = replace(SPIN, speeds=[1e-4], rates=[0.1], drift=0.0).columns(SPUN)
    rng = np.random.default_rng(0)
    slow["q"] = 1e-5 * rng.normal(size=len(slow["t"]))  # the noise of an encoder
    slow["dq"] = 1e-4 * rng.normal(size=len(slow["t"]))
    log = write(
        tmp_path / "log.csv",
        {"t": slow["t"], "q1": slow["q"], "dq1": slow["dq"], "tau1": slow["tau"]},
    )
    assert not inspect_logs([log], tmp_path / "bench" / "robot.toml").examination.torques


def test_physical_masses_exclude_known_ones(tmp_path: Path) -> None:
    api.new(tmp_path / "bench", bench="rotary", inertia=0.01)
    c = SPIN.columns(SPUN)
    log = Log(name="run", t=c["t"], q=c["q"][:, None], dq=c["dq"][:, None], tau=c["tau"][:, None])
    with pytest.raises(FitError, match="'bench': 'physical' excludes 'known'"):
        identify([log], Robot(tmp_path / "bench" / "robot.toml"), physical=True)


def test_unknown_parameters_cannot_be_known(tmp_path: Path, hesr: Hesr) -> None:
    log, _ = inspect("one motor", tmp_path, hesr)
    robot = tmp_path / "bench" / "robot.toml"
    robot.write_text(robot.read_text().replace("known = []", 'known = ["motor.I"]'))
    answer = hesr("fit", log, "--robot", robot, "--law", "stribeck", "-o", tmp_path / "law.json")
    assert answer.code == 2
    assert "'known' of robot 'bench' contains 'motor.I'" in answer.err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--bench", "rotary", "--robot", "a.urdf"], "--robot and --bench exclude each other; a "),
        (["--robot", "a.urdf", "--gravity"], "--gravity needs --bench: other robots have a model "),
        (["--robot", "a.urdf", "--gear-ratio", "9"], "--gear-ratio needs --bench: other robots "),
        (["--robot", "a.urdf", "--log", "rate=9"], "--log needs --bench: other robots have a "),
        (["--bench", "rotary", "--inertia", "0"], "--inertia is 0; it must be positive."),
        (["--bench", "rotary", "--inertia", "inf"], "--inertia is inf; it must be positive."),
        (["--bench", "rotary", "--moment", "-1", "--phase", "0"], "--moment is -1; it must be po"),
        (["--bench", "rotary", "--moment", "1", "--phase", "nan"], "--phase is nan; it must be fi"),
        (["--bench", "rotary", "--moment", "1"], "--moment and --phase belong together; give "),
        (["--bench", "rotary", "--phase", "1"], "--moment and --phase belong together; give both"),
        (["--bench", "sliding", "--phase", "1"], "--moment and --phase are for a rotary bench; "),
        (["--bench", "rotary", "--joints", "a,b,a"], "--joints has 'a' twice; every joint needs "),
        (["--bench", "rotary", "--inertia", "1,2"], "--inertia: found 2 values, but the model has"),
        (["--bench", "rotary", "--log", "rat=1"], "bench/robot.toml: unknown key 'log.rat'; did "),
        (["--bench", "rotary", "--gear-ratio", "0"], "bench/robot.toml: key 'gear_ratio.0' is 0.0"),
        (["--bench", "rotary", "--log", "zero=[1,2]"], "key 'log.zero' of robot 'bench' has 2 ent"),
    ],
)
def test_wrong_options_are_refused(
    tmp_path: Path,
    hesr: Hesr,
    monkeypatch: pytest.MonkeyPatch,
    options: Sequence[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    answer = hesr("new", "bench", *options)
    assert answer.code == 2
    assert answer.err.startswith(f"hesr: {said}")
    assert len(answer.err.splitlines()) == 1
    assert contents(tmp_path) == {}


def test_other_kinds_of_benches_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="'bench' is 'linear'; it must"):
        api.new(tmp_path / "bench", bench="linear")  # type: ignore[arg-type]  # a refused kind


@pytest.mark.ci
def test_the_commands_of_the_documentation_lead_to_an_fmu(
    tmp_path: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    one_motor(tmp_path).rename("motor.csv")
    page = (ROOT / "docs" / "file-formats.md").read_text(encoding="utf-8")
    section = page.partition("\n## Benches\n")[2].partition("\n## ")[0]
    commands = re.findall(r"(?m)^ {4}hesr (.*)", section)
    assert len(commands) == 3
    answers = [hesr(*shlex.split(command)) for command in commands]
    assert [answer.code for answer in answers] == [0, 0, 0]
    assert [answer.err for answer in answers[:2]] == ["", ""]
    # The recommended law may have reached a limit.
    assert answers[2].err == "" or answers[2].err == Containing("motor", "[bound]")
    advised = re.search(r"Recommended: (\S+\.fmu)", answers[-1].out)
    assert advised, answers[-1].out
    t = np.arange(100) * 0.005
    assert SPIN.worst(lambda dq: replay(Path(advised[1]), t, dq)) < 0.03
