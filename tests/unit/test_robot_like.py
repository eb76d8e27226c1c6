"""Robots from any kind of file, and objects accepted in place of a path."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import ConfigError, RobotError
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription, to_description, to_robot


def test_a_model_file_alone_describes_all_its_joints(arm: RobotDescription) -> None:
    for given in (arm.model, str(arm.model)):
        found = to_description(given)
        assert (found.name, found.joints, found.model) == ("arm", arm.joints, arm.model)


def test_a_robot_is_accepted_as_itself(arm: RobotDescription, arm_model: Robot) -> None:
    assert to_description(arm) is arm
    assert to_description(arm_model) is arm
    assert to_robot(arm_model) is arm_model
    assert isinstance(to_robot(arm), Robot)


def test_repr_of_a_robot_is_one_line(arm: RobotDescription) -> None:
    robot = Robot(arm)
    assert repr(robot) == "Robot('arm', 3 joints, arm.xml)"
    assert (robot.name, robot.joints) == (arm.name, arm.joints)


def test_a_robot_file_is_read(arm: RobotDescription) -> None:
    file = arm.model.with_name("robot.toml")
    file.write_text('name = "toml"\nmodel = "arm.xml"\njoints = ["j1", "j2"]\n', encoding="utf-8")
    assert Robot(str(file)).description.joints == ("j1", "j2")


def test_other_objects_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        Robot(3)  # type: ignore[arg-type]  # the mistake
    assert "a robot is given as int" in str(caught.value)
    with pytest.raises(RobotError, match="no such model file"):
        Robot(tmp_path / "none.urdf")


def test_a_log_read_from_a_path_has_its_robot(arm: RobotDescription, arm_log: Log) -> None:
    file = arm.model.with_name("log.csv")
    arm_log.write(str(file))
    log = Log.read(str(file), str(arm.model))
    assert log.robot is not None
    assert log.joints == log.robot.joints == arm.joints
    assert log.rows(slice(0, 9)).robot is log.robot
    np.testing.assert_array_equal(log.q, arm_log.q)
    with pytest.raises(ConfigError, match=r"a log is given as list; expected a path"):
        Log.read([file], arm)  # type: ignore[arg-type]  # the mistake
