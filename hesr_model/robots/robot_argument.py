"""A robot by whatever file describes it: a robot file (TOML), or its URDF or MJCF alone."""

from os import PathLike

from hesr_model.robots.model_file import driven_joints
from hesr_model.robots.robot import RobotDescription, RobotModel
from hesr_model.support.files import path_of

RobotLike = RobotDescription | RobotModel | str | PathLike[str]
"""What stands for a robot: a robot, its description, or the path of a file that describes it."""


def described(robot: RobotLike) -> RobotDescription:
    """Return the description of a robot.

    A URDF or MJCF alone describes a robot with all its joints, whose logs have the default
    columns ``t, q1.., dq1.., tau1..``.

    Raises
    ------
    ConfigError
        If a robot file cannot be used, or what is given is neither a robot nor a path.
    RobotError
        If a model file cannot be used.
    """
    if isinstance(robot, RobotModel):
        return robot.description
    if isinstance(robot, RobotDescription):
        return robot
    path = path_of(robot, "a robot")
    if path.suffix.lower() == ".toml":
        return RobotDescription.read(path)
    joints = tuple(joint.name for joint in driven_joints(path))
    return RobotDescription(name=path.stem, model=path.resolve(), joints=joints)


class Robot(RobotModel):
    """A robot: its joints, the format of its logs, and its rigid-body dynamics.

    Parameters
    ----------
    source : path of a robot file (TOML), a URDF or an MJCF (``.xml``), or a description.

    Raises
    ------
    ConfigError
        If a robot file cannot be used, or what is given is neither a robot nor a path.
    RobotError
        If a model file cannot be used, or a joint of the description is not in it.
    """

    def __init__(self, source: RobotLike) -> None:
        super().__init__(described(source))


def model_of(robot: RobotLike) -> RobotModel:
    """Return the dynamics of a robot; one that is made already is returned as it is."""
    return robot if isinstance(robot, RobotModel) else Robot(robot)
