"""Which joints of a robot are inspected: those named, those of the arm, those of a robot file."""

from pathlib import Path

import pytest

from hesr_model.errors import RobotError
from hesr_model.health.joints import choose_joints
from hesr_model.robots.robot import RobotDescription

LINK = """<link name="{0}"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="2" effort="5" velocity="3"/></joint>"""


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Three joints of an arm, and a finger that branches off its upper link."""
    parts = [LINK.format(name) for name in ("base", "upper", "lower", "hand", "finger")]
    parts += [
        JOINT.format("j1", "base", "upper"),
        JOINT.format("j2", "upper", "lower"),
        JOINT.format("j3", "lower", "hand"),
        JOINT.format("f1", "upper", "finger"),
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def test_a_model_file_is_inspected_as_its_longest_chain(model: Path) -> None:
    description, reason = choose_joints(model, ())
    assert description.joints == ("j1", "j2", "j3")
    assert set(description.locked) == {"f1"}
    assert "longest chain" in reason


def test_named_joints_are_those_inspected(model: Path) -> None:
    description, reason = choose_joints(model, ("j2", "f1"))
    assert (set(description.joints), reason) == ({"j2", "f1"}, "")
    assert set(description.locked) == {"j1", "j3"}


def test_a_robot_file_names_its_joints(model: Path) -> None:
    own = RobotDescription(name="own", model=model, joints=("j1", "f1"), locked={"j2": 0, "j3": 0})
    assert choose_joints(own, ()) == (own, "")
    description, reason = choose_joints(own, ("f1",))
    assert (description.joints, reason) == (("f1",), "")
    with pytest.raises(RobotError, match="has no joint 'j3'"):
        choose_joints(own, ("j3",))
