"""Names in a URDF: each is used, irrelevant with a reason, or left over and named."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import RobotError
from hesr_model.robots import urdf
from hesr_model.robots.robot import Robot

ARM = """<robot name="arm"><link name="l0"/>
<link name="l1"><inertial><origin xyz="0.2 0 0.1" rpy="0 0.1 0"/><mass value="2"/>
<inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.03" iyz="0" izz="0.03"/></inertial></link>
<link name="l2"><inertial><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
<joint name="j1" type="revolute"><parent link="l0"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="10" velocity="2"/></joint>
<joint name="j2" type="revolute"><parent link="l1"/><child link="l2"/><axis xyz="0 1 0"/>
<origin xyz="0.4 0 0"/><limit lower="-1" upper="1" effort="10" velocity="2"/>
<mimic joint="j1" multiplier="2" offset="0.1"/></joint></robot>"""

MISTYPED = [
    ('value="2"', 'valu="2"', "value"),
    ("<inertial><origin", "<inertal><origin", "inertial"),
    ("<mass value", "<maas value", "mass"),
    ('ixx="0.02"', 'Ixx="0.02"', "ixx"),
    ('<origin xyz="0.2 0 0.1"', '<orgin xyz="0.2 0 0.1"', "origin"),
    ('rpy="0 0.1 0"', 'rpi="0 0.1 0"', "rpy"),
    ('<axis xyz="0 1 0"/>\n<limit', '<axes xyz="0 1 0"/>\n<limit', "axis"),
    ('multiplier="2"', 'multiplyer="2"', "multiplier"),
    ('offset="0.1"', 'ofset="0.1"', "offset"),
    ('lower="-1"', 'lowr="-1"', "lower"),
    ("<mimic", "<mimick", "mimic"),
    ("<joint name", "<jont name", "joint"),
    ('<link name="l0"/>', '<lnk name="l0"/>', "link"),
]


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(("name", "mistyped", "near"), MISTYPED, ids=[m[1] for m in MISTYPED])
def test_a_mistyped_name_is_refused(name: str, mistyped: str, near: str, tmp_path: Path) -> None:
    assert name in ARM
    opening, closing = name[1:].split()[0], mistyped[1:].split()[0]
    text = ARM.replace(name, mistyped, 1)
    opening = opening.partition(">")[0]
    if name.startswith("<") and not name.endswith("/>"):
        text = text.replace(f"</{opening}>", f"</{closing.partition('>')[0]}>", 1)
    with pytest.raises(RobotError, match=f"did you mean '{near}'") as caught:
        Robot(write(tmp_path, text))
    assert caught.value.code == "name.misspelt"


@pytest.mark.parametrize(
    ("kind", "name"),
    [(kind, name) for kind, names in urdf._IRRELEVANT_NAMES.items() for name in names],
)
def test_what_is_irrelevant_changes_nothing(kind: str, name: str, tmp_path: Path) -> None:
    plain = Robot(write(tmp_path, ARM))
    before = {"robot": "</robot>", "link": "</link>", "joint": "</joint>"}.get(kind)
    if kind == "limit":
        text = ARM.replace('effort="10"', f'effort="10" {name}="3"')
    elif kind == "dynamics":
        numbers = {"damping": "1"} | {name: "3"}  # urdfdom wants damping or friction
        attributes = " ".join(f'{key}="{number}"' for key, number in numbers.items())
        text = ARM.replace("</joint>", f"<dynamics {attributes}/></joint>")
    else:
        inner = '<mass value="50"/><origin xyz="1 2 3"/>'
        text = ARM.replace(before, f'<{name} k_velocity="7" damping="7">{inner}</{name}>{before}')
    robot = Robot(write(tmp_path, text))
    assert robot.doubts == plain.doubts
    state = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 5, robot.n))
    np.testing.assert_array_equal(
        robot.torque(robot.nominal_parameters, *state),
        plain.torque(plain.nominal_parameters, *state),
    )
    np.testing.assert_array_equal(robot.limits, plain.limits)


def test_a_spring_of_a_joint_is_left_over(tmp_path: Path) -> None:
    text = ARM.replace("</joint>", '<dynamics damping="1" spring_stiffness="3"/></joint>')
    (doubt,) = (d for d in Robot(write(tmp_path, text)).doubts if d.check == "left-over")
    assert "'spring_stiffness' of <dynamics>" in doubt.found


def test_elements_of_other_tools_are_left_over_once(tmp_path: Path) -> None:
    """Even under the name of an element that belongs elsewhere."""
    text = ARM.replace("</link>", '<origin xyz="1 1 1"/><hydraulics p="3"/></link>')
    (doubt,) = (d for d in Robot(write(tmp_path, text)).doubts if d.check == "left-over")
    assert doubt.severity == "warning"
    assert "2 parts" in doubt.found
    assert "'hydraulics' of <link>" in doubt.found


def test_names_are_left_over_where_masses_are_placeholders(tmp_path: Path) -> None:
    path = write(tmp_path, ARM.replace("</robot>", "<hydraulics/></robot>"))
    description = Robot(path).description.model_copy(update={"known": ()})
    (doubt,) = Robot(description).doubts
    assert (doubt.check, doubt.severity) == ("left-over", "warning")
