"""A gas spring and a four-bar counterweight on the twin, simulated by MuJoCo, from their logs."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from cosim.loop.excite import load_arm, record
from fmu_src.arm.plant import Plant, servo_signals
from fmu_src.arm.table import ArmSignals, ArmStart
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.motions.trajectories import Fourier, random_fourier
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.observations import SLOW
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

pytestmark = pytest.mark.ci

FOLDER = models_folder() / "uf850"
AT_JOINT_2 = '<body name="link2" quat="0.5 0.5 -0.5 0.5" gravcomp="1">'

# Its force of 1500 N/m times (0.9 m - length) acts along the line between two points.
GAS_SPRING = {
    AT_JOINT_2: f'<site name="foot" pos="-0.12 0 -0.3"/>{AT_JOINT_2}'
    '<site name="rod" pos="0.08 0 0"/>',
    "<tendon>": '<tendon><spatial name="gas_spring" stiffness="1500" springlength="0.9">'
    '<site site="foot"/><site site="rod"/></spatial>',
}

# A parallelogram: the counterweight's crank turns with link 2, the coupler keeps its direction.
LINKAGE = """
<body name="crank" pos="-0.15 0 0" quat="0.5 0.5 -0.5 0.5">
  <inertial pos="-0.25 0.02 0" mass="8" diaginertia="0.02 0.03 0.03"/>
  <joint name="crank" axis="0 0 1"/>
  <body name="coupler" pos="0.15 0 0">
    <inertial pos="0.02 -0.07 0" mass="1.5" diaginertia="0.005 0.005 0.005"/>
    <joint name="coupler" axis="0 0 1"/>
  </body>
</body>
"""
CLOSED = """
<equality><connect body1="coupler" body2="link2" anchor="0 -0.15 0"
  solref="0.002 1" solimp="0.9999 0.9999 0.001"/></equality>
"""
FOLLOWING = """
<equality>
  <joint joint1="crank" joint2="joint2" polycoef="0 1 0 0 0"/>
  <joint joint1="coupler" joint2="joint2" polycoef="0 -1 0 0 0"/>
</equality>
"""

Signals = Callable[[Plant, float], ArmSignals]


def fourier(seed: int, velocity: tuple[float, ...]) -> Fourier:
    return random_fourier(
        seed=seed,
        harmonics=10,
        period=20.0,
        peak_velocity=np.array(velocity),
        offset=np.array([0.0, 0.1, -1.9]),
        periods=2,
    )


def changed(folder: Path, changes: dict[str, str]) -> Path:
    """A copy of the twin with another MJCF."""
    shutil.copytree(FOLDER, folder)
    text = (folder / "uf850.xml").read_text(encoding="utf-8")
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    (folder / "uf850.xml").write_text(text, encoding="utf-8")
    return folder


def logs_of(folder: Path, speed: float, signals: Signals | None = None) -> list[Log]:
    """Excitation, its reverse, and another motion at up to `speed` on joint 2."""
    plant, logs = Plant.read(folder / "plant.toml"), []
    first, other = fourier(86, (1.3, speed, 1.3)), fourier(5, (1.2, 0.8 * speed, 1.2))
    for number, motion in enumerate((first, first.reverse_time(), other)):
        at = float(motion.sample(np.zeros(1))[0][0, 1])
        own = signals(plant, at) if signals else None
        with load_arm(plant, signals=own) as arm:
            run = record(arm, motion, 1, name=f"log{number}", unlogged=(20.0, 0.0))
        logs.append(run.log)
    return logs


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """RMS (n,) [N.m] of training logs, and of another log in motion, beyond simple friction."""

    trained: np.ndarray
    other: np.ndarray


def residuals(robot: Robot, logs: list[Log]) -> Residuals:
    forward, backward, other = logs
    body = identify([forward], robot, reversed_logs=[backward])
    motion = smooth(other, robot.description.log.filter_cutoff)
    coulomb, viscous, offset = body.friction.T
    left = motion.tau - body.torque(robot, motion)
    left -= coulomb * np.sign(motion.dq) + viscous * motion.dq + offset
    moves = np.abs(motion.dq) > SLOW
    rms = np.sqrt((left**2 * moves).sum(axis=0) / moves.sum(axis=0))
    return Residuals(trained=body.rmse, other=rms)


def test_a_balancer_explains_a_gas_spring(tmp_path: Path) -> None:
    own = RobotDescription.read(FOLDER / "robot.toml")
    logs = logs_of(changed(tmp_path / "sprung", GAS_SPRING), 1.2)
    plain = residuals(Robot(own), logs_of(FOLDER, 1.2))
    unaware = residuals(Robot(own), logs)
    found = residuals(Robot(own.model_copy(update={"balancers": ("joint2",)})), logs)
    assert unaware.other[1] > 1.5 * plain.other[1]
    assert np.all(found.trained <= 1.05 * plain.trained)
    assert np.all(found.other <= 1.05 * plain.other)


def closed(plant: Plant, at: float) -> ArmSignals:
    """The servo's signals, with the linkage assembled at the start, where joint 2 is `at`."""
    signals = servo_signals(plant)
    crank, coupler = (signals.model.joint(name) for name in ("crank", "coupler"))
    starts = [
        replace(start, other=int(crank.qposadr[0]), held=(*start.held, int(crank.dofadr[0])))
        if start.name == "q0[2]"
        else start
        for start in signals.starts
    ]
    starts.append(ArmStart("coupler", "rad", int(coupler.qposadr[0]), -at))
    return replace(signals, starts=tuple(starts))


def of_file(robot: Robot, log: Log) -> np.ndarray:
    """RMS (n,) [N.m] beyond simple friction and the torque of the model file."""
    motion, rms = smooth(log, robot.description.log.filter_cutoff), []
    left = motion.tau - robot.torque(robot.nominal_parameters, motion.q, motion.dq, motion.ddq)
    for torque, v in zip(left.T, motion.dq.T, strict=True):
        columns = np.column_stack([np.sign(v), v, np.ones_like(v)])[np.abs(v) > SLOW]
        torque = torque[np.abs(v) > SLOW]
        more = columns @ np.linalg.lstsq(columns, torque, rcond=None)[0]
        rms.append(np.sqrt(np.mean((torque - more) ** 2)))
    return np.array(rms)


def test_a_four_bar_counterweight_is_predicted_as_an_open_chain(tmp_path: Path) -> None:
    """MuJoCo closes the loop by a point of both links, without the law that HESR uses."""
    plant = changed(
        tmp_path / "plant", {AT_JOINT_2: LINKAGE + AT_JOINT_2, "<actuator>": CLOSED + "<actuator>"}
    )
    folder = changed(
        tmp_path / "robot",
        {AT_JOINT_2: LINKAGE + AT_JOINT_2, "<actuator>": FOLLOWING + "<actuator>"},
    )
    robot = Robot(RobotDescription.read(folder / "robot.toml"))
    assert robot.follow is not None
    logs = logs_of(plant, 0.8, closed)
    bare, open_logs = Robot(FOLDER / "robot.toml"), logs_of(FOLDER, 0.8)
    plain, found = residuals(bare, open_logs), residuals(robot, logs)
    assert np.all(found.trained <= 1.05 * plain.trained)
    assert np.all(found.other <= 1.05 * plain.other)
    # The torque of the model file, where masses cannot make up for a wrong motion of the linkage.
    assert np.all(of_file(robot, logs[2]) <= 1.05 * of_file(bare, open_logs[2]))
    assert of_file(bare, logs[2])[1] > 1.5 * of_file(bare, open_logs[2])[1]
