"""Public arms: HESR's torques are those of MuJoCo and of Pinocchio, or the file is refused.

`pip install example-robot-data dm-control gymnasium-robotics pybullet` installs the files (0.4 GB).
"""

import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pytest

from hesr_model.errors import RobotError
from hesr_model.robots.mjcf import import_engine
from hesr_model.robots.model_file import load, set_joint
from hesr_model.robots.robot import Robot

ARMS = {
    "example-robot-data": """alex_description/urdf/alex_nub_hands.urdf
        anymal_b_simple_description/robots/anymal-kinova.urdf
        baxter_description/urdf/baxter.urdf
        borinot_description/urdf/borinot_flying_arm_2.urdf
        centauro_description/urdf/centauro.urdf
        double_pendulum_description/urdf/double_pendulum.urdf
        finger_edu_description/robots/finger_edu.urdf
        kinova_description/robots/kinova.urdf
        panda_description/urdf/panda.urdf
        so_arm_description/urdf/so100.urdf
        so_arm_description/urdf/so101.urdf
        talos_data/robots/talos_left_arm.urdf
        tiago_description/robots/tiago_no_hand.urdf
        tiago_pro_description/robots/tiago_pro.urdf
        ur_description/urdf/ur3_robot.urdf
        ur_description/urdf/ur5_robot.urdf
        ur_description/urdf/ur10_robot.urdf
        xarm_description/urdf/xarm7.urdf
        z1_description/urdf/z1.urdf""",
    "pybullet_data": "kuka_iiwa/model.urdf xarm/xarm6_robot.urdf mjcf/striker.xml mjcf/thrower.xml",
    "dm_control": """third_party/kinova/jaco_arm.xml suite/manipulator.xml suite/stacker.xml""",
    "gymnasium_robotics": "envs/assets/fetch/reach.xml envs/assets/hand/reach.xml",
}
REFUSED = {
    "alex_description/urdf/alex_psyonic_hands.urdf": r"joint '.*' follows joint '.*', which does "
    r"not move; correct its <mimic> or equality\.",
    "ur_description/urdf/ur3.urdf": r"cannot be parsed as a URDF \(.*\)\.",
}
FOLDERS = {"example-robot-data": "cmeel.prefix/share/example-robot-data/robots"}
LISTED = [(package, name) for package, names in ARMS.items() for name in names.split()]
TOLERANCE = 1e-9  # over the largest torque

States = tuple[np.ndarray, np.ndarray, np.ndarray]


def located(package: str, name: str) -> Path:
    for entry in sys.path:
        path = Path(entry, FOLDERS.get(package, package))
        if path.is_dir():
            return path / name
    pytest.skip(f"{package} is not installed; see the command at the top of this file")


def of_pinocchio(path: Path, robot: Robot, states: States) -> np.ndarray:
    """RNEA of the whole tree as Pinocchio reads a URDF, and as MuJoCo compiles an MJCF."""
    import pinocchio as pin

    found = load(path)
    model = pin.buildModelFromUrdf(str(path)) if path.suffix == ".urdf" else found.pin_model
    model.gravity.linear = robot.gravity
    data, rest = model.createData(), rests(path, robot)
    joints = [model.joints[model.getJointId(frame.name)] for frame in robot.tree]
    slopes, offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
    torques = []
    for q, dq, ddq in zip(*states, strict=True):
        state, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for name, position in rest.items():
            if model.existJointName(name):
                set_joint(model.joints[model.getJointId(name)], state, np.array(position))
        for joint, x in zip(joints, slopes @ q + offsets, strict=True):
            set_joint(joint, state, x)
        dofs = [joint.idx_v for joint in joints]
        v[dofs], a[dofs] = slopes @ dq, slopes @ ddq
        torques.append(slopes.T @ pin.rnea(model, data, state, v, a)[dofs])
    return np.array(torques)


def rests(path: Path, robot: Robot) -> dict[str, float]:
    """Positions of the joints that do not move, with their followers."""
    found = load(path)
    places = found.rest_positions | robot.description.locked
    moving = {frame.name for frame in robot.tree}
    for name, (leader, slope, offset) in found.followers.items():
        if name not in moving:
            places[name] = slope * places.get(leader, 0.0) + offset
    return places


def of_mujoco(path: Path, robot: Robot, states: States) -> np.ndarray:
    """mj_inverse of the whole file, without constraints and passive forces."""
    mujoco = import_engine()
    model = mujoco.MjModel.from_xml_path(str(path)) if path.suffix == ".xml" else urdf_model(path)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.opt.enableflags = 0
    model.dof_damping[:] = 0.0  # sums with large ones lose digits
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    data, torques = mujoco.MjData(model), []
    for name, position in rests(path, robot).items():
        if name in names:
            data.qpos[model.jnt_qposadr[names.index(name)]] = position
    joints = [names.index(frame.name) for frame in robot.tree]
    places, dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    slopes, offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
    for q, dq, ddq in zip(*states, strict=True):
        data.qpos[places] = slopes @ q + offsets
        data.qvel[dofs], data.qacc[dofs] = slopes @ dq, slopes @ ddq
        mujoco.mj_inverse(model, data)
        torques.append(slopes.T @ (data.qfrc_inverse + data.qfrc_passive)[dofs])
    return np.array(torques)


def urdf_model(path: Path) -> Any:
    """Compile a URDF with valid inertias, then set its own, which MuJoCo may not accept."""
    import pinocchio as pin

    mujoco, root = import_engine(), ElementTree.parse(path).getroot()
    own: dict[str, Element | None] = {}
    for part in list(root):
        if part.tag not in ("link", "joint"):
            root.remove(part)
        for element in [*part.findall("visual"), *part.findall("collision")]:
            part.remove(element)
        if part.tag == "link":
            own[part.get("name", "")] = inertial = part.find("inertial")
            if inertial is not None:
                part.remove(inertial)
            valid = SubElement(part, "inertial")
            SubElement(valid, "mass", value="1")
            SubElement(valid, "origin", xyz="0.1 0.2 0.3", rpy="0.1 0.2 0.3")
            SubElement(valid, "inertia", ixx="1", iyy="1.1", izz="1.2", ixy="0", ixz="0", iyz="0")
    spec = mujoco.MjSpec.from_string(ElementTree.tostring(root, encoding="unicode"))
    spec.compiler.fusestatic = False
    model = spec.compile()
    for body in range(1, model.nbody):
        inertial = own.get(model.body(body).name)
        mass, centre, about = 0.0, np.zeros(3), np.zeros((3, 3))
        if inertial is not None:
            frame = inertial.find("origin")
            words = (
                frame.get(k, "0 0 0") if frame is not None else "0 0 0" for k in ("xyz", "rpy")
            )
            centre, turn = (np.array([float(x) for x in word.split()]) for word in words)
            keys = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")
            inertia, rotation = inertial.find("inertia"), pin.rpy.rpyToMatrix(turn)
            numbers = [float(inertia.get(k, "0")) if inertia is not None else 0.0 for k in keys]
            about = rotation @ np.reshape(numbers, (3, 3)) @ rotation.T
            heavy = inertial.find("mass")
            mass = float(heavy.get("value", "0")) if heavy is not None else 0.0
        moments, axes = np.linalg.eigh(about)
        axes[:, 2] *= np.linalg.det(axes)
        model.body_mass[body], model.body_ipos[body] = mass, centre
        model.body_inertia[body] = moments
        mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
    return model


@pytest.mark.ci
@pytest.mark.parametrize(("package", "name"), LISTED)
def test_torques_are_those_of_mujoco_and_pinocchio(package: str, name: str) -> None:
    path = located(package, name)
    robot = Robot(path)
    states = tuple(np.random.default_rng(5).uniform(-1.0, 1.0, (3, 8, robot.n)))
    masses = robot.nominal_parameters
    masses[robot.inertial :] = 0.0  # springs are passive forces
    found = robot.torque(masses, *states)
    allowed = TOLERANCE * np.abs(found).max()
    assert allowed > 0.0
    np.testing.assert_allclose(of_pinocchio(path, robot, states), found, rtol=0, atol=allowed)
    np.testing.assert_allclose(of_mujoco(path, robot, states), found, rtol=0, atol=allowed)


@pytest.mark.ci
@pytest.mark.parametrize(("name", "reason"), REFUSED.items())
def test_other_files_are_refused_with_the_reason(name: str, reason: str) -> None:
    path = located("example-robot-data", name)
    with pytest.raises(RobotError, match=re.escape(f"{path}: ") + reason):
        Robot(path)


def test_nine_of_ten_arms_are_read() -> None:
    assert len(LISTED) >= 25
    assert len(LISTED) >= 9 * len(REFUSED)
