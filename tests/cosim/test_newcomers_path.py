"""The path of a new user: from the README to an FMU, with logs as other recorders write them.

The commands are those of the README, with the names of the log and of the robot's model filled in.
Each runs in a separate process, and no file is edited between them.
"""

import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import ROOT

from cosim.study.sample_logs import plausible_friction, sample_settings, simulate_log
from fmu_src.friction.replay import replay
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.logs.robot_log import Log
from hesr_model.motions.excitation import random_motions
from hesr_model.motions.trajectories import Fourier
from hesr_model.robots.robot import Robot, RobotDescription

pytestmark = pytest.mark.ci

MOST_COMMANDS = 6

UR = tuple(
    f"{name}_joint"
    for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
)

LINKS = (
    # axis, origin, mass, centre of mass
    ("0 0 1", "0 0 0.18", 8.0, "0.01 -0.02 0.05"),
    ("0 1 0", "0 0.14 0", 9.0, "0.02 0.01 0.28"),
    ("0 1 0", "0 -0.12 0.6", 4.0, "0.01 0.02 0.25"),
    ("0 1 0", "0 0 0.57", 2.0, "0.02 0.1 0.01"),
    ("0 0 1", "0 0.12 0", 2.0, "-0.02 0.03 0.06"),
    ("0 1 0", "0 0 0.12", 1.0, "0.03 0.05 0.02"),
)


def urdf(names: Sequence[str]) -> str:
    """A serial arm with one joint per name."""
    links, joints = ['<link name="base"/>'], []
    for k, (name, (axis, origin, mass, centre)) in enumerate(zip(names, LINKS, strict=False)):
        size = 0.02 * mass
        links.append(
            f'<link name="link{k}"><inertial><origin xyz="{centre}"/><mass value="{mass}"/>'
            f'<inertia ixx="{size}" iyy="{1.2 * size}" izz="{0.7 * size}" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
        parent = f"link{k - 1}" if k else "base"
        joints.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{k}"/><origin xyz="{origin}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.5" upper="2.5" effort="150" velocity="2"/></joint>'
        )
    return f'<robot name="arm">{"".join(links)}{"".join(joints)}</robot>'


@dataclass(frozen=True, kw_only=True)
class Truth:
    """Truth behind a log."""

    log: Log
    laws: Sequence[FrictionLaw]
    unseen: Fourier

    def errors(self, fmu: Path, scale: np.ndarray) -> np.ndarray:
        """RMSE of an FMU in an unseen motion, relative to the standard deviation of true friction
        times a scale; one per joint."""
        t = np.arange(4000) / 200.0
        q, dq, _ = self.unseen.sample(t)
        truth = np.column_stack(
            [k * predict(law, t=t, dq=v) for k, law, v in zip(scale, self.laws, dq.T, strict=True)]
        )
        found = replay(fmu, t, dq, q=q)
        return np.sqrt(np.mean((found - truth) ** 2, axis=0)) / truth.std(axis=0)


def measured(model: Path, joints: Sequence[str], seconds: float) -> Truth:
    """Simulate the model with the true friction; its masses are those in the user's model file."""
    robot = Robot(RobotDescription(name="arm", model=model, joints=tuple(joints)))
    motion, unseen = random_motions(robot, sample_settings(robot), 2, 3)
    laws = plausible_friction(robot, motion)
    log = simulate_log(robot, motion, laws, name="log", seed=4, seconds=seconds)
    return Truth(log=log, laws=laws, unseen=unseen)


Write = Callable[[Path, Log], str]
"""Write a log into a folder; return its file name."""


def table(names: Sequence[str], columns: np.ndarray, *, separator: str) -> list[str]:
    """Lines of a table, header first."""
    return [
        separator.join(names),
        *(separator.join(f"{value:.7g}" for value in row) for row in columns),
    ]


def rtde(folder: Path, log: Log) -> str:
    """Format of Universal Robots: joints from 0, currents, also target columns."""
    n = log.q.shape[1]
    parts = {"target_q": log.q, "target_qd": log.dq, "target_moment": log.tau, "actual_q": log.q,
             "actual_qd": log.dq, "actual_current": log.tau / constants(n)}  # fmt: skip
    names = ["timestamp", *(f"{part}_{k}" for part in parts for k in range(n)), "runtime_state"]
    stamps = [f"{8123.456 + t:.3f}" for t in log.t]
    rows = np.hstack([*parts.values(), np.full((len(log.t), 1), 2.0)])
    lines = table(names[1:], rows, separator=" ")
    text = [" ".join(names), *(f"{t} {line}" for t, line in zip(stamps, lines[1:], strict=True))]
    (folder / "log.csv").write_text("\n".join(text) + "\n", encoding="utf-8", newline="\r\n")
    return "log.csv"


def constants(joints: int) -> np.ndarray:
    """Torque constants [N.m/A], unknown to the user."""
    return np.array([13.1, 13.1, 12.4, 9.8, 9.5, 9.2])[:joints]


def bag(folder: Path, log: Log) -> str:
    """Format of `ros2 bag record`: joints in alphabetical order, a gripper among them, stamps from
    1970."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = "sensor_msgs/msg/JointState"
    order = np.argsort(UR)
    with Writer(folder / "log", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        states = writer.add_connection("/joint_states", kind, typestore=store)
        for t, q, dq, tau in zip(log.t, log.q, log.dq, log.tau, strict=True):
            stamp = 1_700_000_000_000_000_000 + round(1e9 * t)
            types: Any = store.types
            message = types[kind](
                header=types["std_msgs/msg/Header"](
                    stamp=types["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000)),
                    frame_id="",
                ),
                name=["finger_joint", *(UR[k] for k in order)],
                position=np.array([0.02, *q[order]]),
                velocity=np.array([0.0, *dq[order]]),
                effort=np.array([0.5, *tau[order]]),
            )
            writer.write(states, stamp + 400_000, store.serialize_cdr(message, kind))
    return "log"


def messy(folder: Path, log: Log) -> str:
    """A spreadsheet: degrees, decimal commas, jitter, a gap, empty cells, text between rows."""
    rng = np.random.default_rng(0)
    n = log.q.shape[1]
    t = np.sort(log.t + rng.normal(0.0, 3e-4, len(log.t)))
    at = [np.interp(t, log.t, column) for part in (log.q, log.dq, log.tau) for column in part.T]
    values = np.column_stack([1e3 * t, *at[: 2 * n], *at[2 * n :]])
    values[:, 1 : 2 * n + 1] *= 180.0 / np.pi
    values = values[(t < 8.0) | (t > 8.4)]
    quantities = ("pos [deg]", "vel [deg/s]", "torque [Nm]")
    names = ["time [ms]", *(f"A{k + 1} {each}" for each in quantities for k in range(n)), "note"]
    lines = [line.replace(".", ",") for line in table(names, values, separator=";")]
    lines = ["# cell 7, second shift", "", *(f"{line};" for line in lines)]
    lines[2] = lines[2].removesuffix(";")
    for row in (300, 1700):
        cells = lines[row].split(";")
        cells[3] = ""
        lines[row] = ";".join(cells)
    lines.insert(900, "# the tool was changed")
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="latin-1")
    return "log.csv"


def commands_of_the_readme() -> list[str]:
    """Commands from an own log to a checked FMU: the first block of the section."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    section = text.partition("\n## Your own robot\n")[2]
    found = re.match(r"\n((?: {4}hesr .*\n)+)", section)
    assert found
    return [line.strip() for line in found[1].splitlines()]


def hesr(folder: Path, command: str) -> str:
    """Run a command as a shell does; return its output."""
    program = Path(sys.executable).with_name("hesr")
    said = subprocess.run(
        [program, *shlex.split(command)[1:]],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 0, said.stdout + said.stderr
    return said.stdout


@pytest.mark.parametrize(
    ("write", "joints", "seconds"),
    [
        (messy, 1, 12.0),
        # The first joint reverses late and only once.
        pytest.param(messy, 2, 12.0, marks=pytest.mark.soak),
        pytest.param(rtde, 6, 60.0, marks=pytest.mark.soak),
        pytest.param(bag, 6, 20.0, marks=pytest.mark.soak),
    ],
)
def test_a_log_becomes_an_fmu(write: Write, joints: int, seconds: float, tmp_path: Path) -> None:
    model = tmp_path / "arm.urdf"
    model.write_text(urdf(UR[:joints]), encoding="utf-8")
    truth = measured(model, UR[:joints], seconds)
    log = write(tmp_path, truth.log)
    inspect, run, check = (
        command.replace("log.csv", log).replace("my_arm.urdf", model.name)
        for command in commands_of_the_readme()
    )
    following = hesr(tmp_path, inspect).splitlines()[-1]
    assert run.startswith(following.removeprefix("Next: "))
    said = hesr(tmp_path, f"{run} --quick")
    recommended = re.match(r"Recommended: (\S+) \(", said)
    report = re.search(r"^Report: (.+)$", said, re.MULTILINE)
    assert recommended
    assert report
    fmu = tmp_path / recommended[1]
    if write is messy:
        assert "rows lack a number" in (tmp_path / report[1]).read_text("utf-8")
    checked = check.replace("results/my_arm/fmus/lugre.fmu", recommended[1])
    assert "no finding" in hesr(tmp_path, checked)
    # In the torque of the proposed constants if the log has currents.
    robot = RobotDescription.read(tmp_path / "robot.toml")
    scale = np.ones(joints)
    if write is rtde:
        scale = np.array(robot.log.torque_per_ampere) / constants(joints)
        assert scale == pytest.approx(1.0, abs=0.3)
    assert np.all(truth.errors(fmu, scale) < 0.05)


def test_the_path_is_short() -> None:
    """Installation, the commands above, and a look at the results."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    start = readme.partition("\n## Start\n")[2]
    assert start.partition("\n## ")[0].count("\n    pip install") == 1
    assert 1 + len(commands_of_the_readme()) + 1 <= MOST_COMMANDS
