"""Public arms: accelerations of the generated plant are those of MuJoCo and of Pinocchio.

See test_arms.py for the packages with the files.
"""

import sys
from pathlib import Path

import numpy as np
import pytest
from test_arms import LISTED, located, rests, urdf_model

from fmu_src.arm.signals import read_signals
from hesr_model.errors import ConfigError
from hesr_model.robots.mjcf import import_engine
from hesr_model.robots.model_file import load, set_joint
from hesr_model.robots.robot import Robot

sys.path.append(str(Path(__file__).parents[1] / "fmu" / "plant"))
from test_plant_dynamics import AGREEMENT, Generated, worst

LOCKED = 1e15  # rotor inertia of the joints that do not move [kg.m2]
STATES = 8
FEWEST = 25
IMPOSSIBLE = ("tiago_description/robots/tiago_no_hand.urdf",)
"""Arms with a negative inertia, which MuJoCo refuses."""

Array = np.ndarray
State = tuple[Array, Array, Array]  # position, speed, and torque of each joint


class MuJoCo:
    """`mj_forward` of the whole file, without constraints and passive forces."""

    def __init__(self, path: Path, robot: Robot) -> None:
        self._mujoco = mujoco = import_engine()
        is_mjcf = path.suffix == ".xml"
        model = mujoco.MjModel.from_xml_path(str(path)) if is_mjcf else urdf_model(path)
        flags = mujoco.mjtDisableBit
        model.opt.disableflags |= int(flags.mjDSBL_CONSTRAINT) | int(flags.mjDSBL_ACTUATION)
        model.opt.enableflags = 0
        model.dof_damping[:] = 0.0  # sums with large ones lose digits
        names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
        self.model, self.data = model, mujoco.MjData(model)
        for name, position in rests(path, robot).items():
            if name in names:
                self.data.qpos[model.jnt_qposadr[names.index(name)]] = position
        joints = [names.index(frame.name) for frame in robot.tree]
        self.places, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        others = np.setdiff1d(np.arange(model.nv), self.dofs)
        model.dof_armature[others] = LOCKED

    def acceleration(self, q: Array, dq: Array, tau: Array) -> Array:
        """Return the accelerations of the moving joints."""
        data, mujoco = self.data, self._mujoco
        data.qpos[self.places], data.qvel[self.dofs] = q, dq
        mujoco.mj_fwdPosition(self.model, data)
        mujoco.mj_fwdVelocity(self.model, data)
        data.qfrc_applied[self.dofs] = tau - data.qfrc_passive[self.dofs]
        mujoco.mj_forward(self.model, data)
        return data.qacc[self.dofs].copy()


class Pinocchio:
    """ABA of the whole tree as Pinocchio reads a URDF, and as MuJoCo compiles an MJCF."""

    def __init__(self, path: Path, robot: Robot) -> None:
        import pinocchio as pin

        found = load(path)
        model = pin.buildModelFromUrdf(str(path)) if path.suffix == ".urdf" else found.pin_model
        model.gravity.linear = robot.gravity
        self._pin, self.model, self.data = pin, model, model.createData()
        self.state = pin.neutral(model)
        for name, position in rests(path, robot).items():
            if model.existJointName(name):
                set_joint(model.joints[model.getJointId(name)], self.state, np.array(position))
        self.joints = [model.joints[model.getJointId(frame.name)] for frame in robot.tree]
        self.dofs = [joint.idx_v for joint in self.joints]
        others = np.setdiff1d(np.arange(model.nv), self.dofs)
        armature = model.armature.copy()
        armature[others] = LOCKED
        model.armature = armature

    def acceleration(self, q: Array, dq: Array, tau: Array) -> Array:
        """Return the accelerations of the moving joints."""
        v, torque = np.zeros(self.model.nv), np.zeros(self.model.nv)
        for joint, x in zip(self.joints, q, strict=True):
            set_joint(joint, self.state, x)
        v[self.dofs], torque[self.dofs] = dq, tau
        return self._pin.aba(self.model, self.data, self.state, v, torque)[self.dofs]


def states(robot: Robot) -> list[State]:
    rng, n = np.random.default_rng(6), robot.n
    return [tuple(rng.uniform(-1.0, 1.0, (3, n))) for _ in range(STATES)]


@pytest.mark.ci
@pytest.mark.parametrize(("package", "name"), LISTED)
def test_accelerations_are_those_of_mujoco_and_pinocchio(
    package: str, name: str, tmp_path: Path
) -> None:
    path = located(package, name)
    robot = Robot(Robot(path).description.model_copy(update={"springs": ()}))  # passive forces
    slopes, offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
    generated, others = Generated(robot, tmp_path), (MuJoCo(path, robot), Pinocchio(path, robot))
    for q, dq, tau in states(robot):
        found = generated.acceleration(q, dq, tau)
        for other in others:
            at = slopes @ q + offsets, slopes @ dq
            if robot.follow:
                # Torques on all joints that give the followers the accelerations of their leaders.
                expected = followed(other, *at, slopes, tau)
            else:
                expected = other.acceleration(*at, tau)
            assert worst(found, expected) < AGREEMENT


def followed(other: MuJoCo | Pinocchio, q: Array, dq: Array, slopes: Array, tau: Array) -> Array:
    """Return the accelerations of leaders from those of all joints under unit torques."""
    links = len(q)
    free = other.acceleration(q, dq, np.zeros(links))
    columns = [other.acceleration(q, dq, unit) - free for unit in np.eye(links)]
    mass = np.linalg.inv(np.column_stack(columns))
    bias = -mass @ free
    return np.linalg.solve(slopes.T @ mass @ slopes, tau - slopes.T @ bias)


@pytest.mark.ci
@pytest.mark.parametrize(("package", "name"), LISTED)
def test_arms_become_plants_of_mujoco(package: str, name: str) -> None:
    """Every joint can be driven or is driven by the file's actuators, and is measured."""
    path = located(package, name)
    if name in IMPOSSIBLE:
        with pytest.raises(ConfigError, match="cannot be compiled as a URDF"):
            read_signals(path)
        return
    signals = read_signals(path)
    kinds = signals.model.jnt_type
    joints = int(np.count_nonzero(kinds >= 2))  # slides and hinges
    assert len(signals.starts) == joints
    assert signals.inputs
    if path.suffix == ".urdf":
        assert len(signals.inputs) == joints
        assert len(signals.outputs) == 3 * joints


def test_enough_arms_are_compared() -> None:
    assert len(LISTED) >= FEWEST
