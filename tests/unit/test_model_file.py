"""The joints of a model file, and the joints that can describe a robot."""

from pathlib import Path

import pytest

from hesr_model.errors import RobotError
from hesr_model.robots.model_file import find_driven_joints, read_joints
from hesr_model.robots.robot import Robot

LINK = """<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
  ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>{more}</joint>"""


def urdf(folder: Path, *joints: dict[str, str]) -> Path:
    """A chain of joints."""
    links = [f"l{k}" for k in range(len(joints) + 1)]
    parts = [LINK.format(name) for name in links] + [
        JOINT.format(**({"more": ""} | joint), parent=links[k], child=links[k + 1])
        for k, joint in enumerate(joints)
    ]
    path = folder / "chain.urdf"
    path.write_text(f'<robot name="chain">{"".join(parts)}</robot>', encoding="utf-8")
    return path


@pytest.fixture
def chain(tmp_path: Path) -> Path:
    return urdf(
        tmp_path,
        {"name": "turn", "kind": "revolute"},
        {"name": "stuck", "kind": "fixed"},
        {"name": "slide", "kind": "prismatic"},
        {"name": "finger", "kind": "revolute", "more": '<mimic joint="turn" multiplier="2"/>'},
        {"name": "float", "kind": "floating"},
    )


def test_moving_joints_are_listed_from_base_to_tip(chain: Path) -> None:
    found = [(joint.name, joint.freedom, joint.slides) for joint in read_joints(chain)]
    assert found == [
        ("turn", 1, False), ("slide", 1, True), ("finger", 0, False), ("float", 6, False)
    ]  # fmt: skip


def test_a_robot_uses_joints_with_one_degree_of_freedom(chain: Path) -> None:
    assert [joint.name for joint in find_driven_joints(chain)] == ["turn", "slide"]
    assert [joint.name for joint in find_driven_joints(chain, ["slide"])] == ["slide"]
    assert [joint.name for joint in find_driven_joints(chain, ["slide", "turn"])] == [
        "turn",
        "slide",
    ]


@pytest.mark.parametrize(
    ("wanted", "sentence"),
    [
        ("elbow", "has no joint 'elbow'; it has turn, slide, finger, float"),
        ("finger", "joint 'finger' follows another"),
        ("float", "joint 'float' has several degrees of freedom"),
    ],
)
def test_joints_that_cannot_be_driven_are_refused(chain: Path, wanted: str, sentence: str) -> None:
    with pytest.raises(RobotError, match=sentence):
        find_driven_joints(chain, ["turn", wanted])


def test_a_file_without_drivable_joints_is_refused(tmp_path: Path) -> None:
    path = urdf(tmp_path, {"name": "float", "kind": "floating"})
    with pytest.raises(RobotError, match="revolute or prismatic joint"):
        find_driven_joints(path)


def test_a_name_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = urdf(tmp_path, {"name": "turn", "kind": "revolute"})
    path.write_bytes(path.read_bytes().replace(b'"turn"', b'"t\xf4rn"'))
    with pytest.raises(
        RobotError, match=r"chain\.urdf: cannot be parsed as a URDF \(not well-formed"
    ):
        read_joints(path)


def test_joints_with_several_degrees_of_freedom_are_held(chain: Path) -> None:
    held = [doubt.joints for doubt in Robot(chain).doubts if doubt.check == "held-joint"]
    assert held == [("float",)]


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_joint_with_several_degrees_of_freedom_may_be_anywhere(
    kind: str, place: int, tmp_path: Path
) -> None:
    """MuJoCo, with which the torques are compared, splits a planar joint into three."""
    joints = [{"name": f"j{k}", "kind": "revolute"} for k in (1, 2)]
    joints.insert(place, {"name": "free", "kind": kind})
    robot = Robot(urdf(tmp_path, *joints))
    assert robot.joints == ("j1", "j2")
    assert [doubt.joints for doubt in robot.doubts if doubt.check == "held-joint"] == [("free",)]
