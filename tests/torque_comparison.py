"""Comparison of HESR's torques of a model file with those of `torque_reference`."""

import re
from pathlib import Path

import numpy as np
import pytest
from torque_reference import REMOVALS, MjcfReference, UrdfReference, draw_motion

from hesr_model.errors import HesrError
from hesr_model.robots.model_file import read_joints
from hesr_model.robots.robot import Robot, describe_model

MOST_DIFFERENCE = 1e-9  # over the largest torque
FORCE = re.compile(r"(?:leaves out |(?<=N\.m), )([^,]+), worth up to ([^N]+) N\.m")


def open_reference(path: Path) -> MjcfReference | UrdfReference | None:
    """Return the reference, None if its own reader refuses the file."""
    kind = UrdfReference if path.suffix == ".urdf" else MjcfReference
    try:
        return kind(path)
    except (ValueError, RuntimeError):
        return None


def find_forces(robot: Robot) -> dict[str, dict[str, float]]:
    """Return what the left-overs are worth [N.m or N] by the name of the force and the joint."""
    worths: dict[str, dict[str, float]] = {}
    for doubt in robot.doubts:
        for force, text in FORCE.findall(doubt.found):
            assert force not in worths
            sizes = zip(doubt.joints, map(float, text.split(", ")), strict=True)
            worths[force] = {name: size for name, size in sizes if size}
    return worths


def require_sizes(path: Path, moving: list[str], forces: dict[str, dict[str, float]]) -> None:
    """Compare what the left-overs say with the torques of the file without each force."""
    reference = MjcfReference(path)
    names, motion = reference.draw_free_motion()
    whole = reference.compute_apart(names, motion)
    least = MOST_DIFFERENCE * np.abs(whole).max()
    for force, sizes in forces.items():
        rest = MjcfReference(path, {force: names}).compute_apart(names, motion)
        worth = dict(zip(names, np.abs(whole - rest).max(axis=0), strict=True))
        for name in moving:
            if force != "stiffness of <joint>" or name in sizes:  # springs of leaders are modelled
                expected = pytest.approx(worth[name], rel=0.05, abs=10.0 * least)
                assert sizes.get(name, 0.0) == expected, (path, force, name)


def read_robot(path: Path) -> Robot | str:
    """Return the robot of all joints with a torque of their own, or why the file is refused."""
    try:
        joints = read_joints(path)
        names = [joint.name for joint in joints if joint.freedom == 1 and not joint.in_loop]
        return Robot(describe_model(path, names))
    except HesrError as error:
        return str(error)


def compare(path: Path) -> str:
    """Return the outcome of a file; it fails if a torque or a refusal is wrong."""
    reference = open_reference(path)
    robot = read_robot(path)
    if isinstance(robot, str):
        assert robot.startswith(f"{path}: ")
        assert "\n" not in robot
        assert reference is None or not reference.can_move, robot
        return "refused"
    if reference is None:
        return "no reference"
    names = list(robot.joints)
    motion = draw_motion(robot.n, 1)
    held = robot.description.locked
    torques = robot.torque(robot.nominal_parameters, *motion)
    expected = reference.compute(names, motion, held)
    if np.abs(torques - expected).max() <= MOST_DIFFERENCE * np.abs(expected).max():
        return "equal"
    forces = find_forces(robot)
    assert forces, path
    assert forces.keys() <= REMOVALS.keys()
    removed = {force: tuple(sizes) for force, sizes in forces.items()}
    rest = MjcfReference(path, removed).compute(names, motion, held)
    np.testing.assert_allclose(
        torques, rest, rtol=0, atol=MOST_DIFFERENCE * np.abs(rest).max(), err_msg=str(path)
    )
    require_sizes(path, MjcfReference(path).find_followers(names), forces)
    return "left-over"
