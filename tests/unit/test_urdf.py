"""URDF: mimic joints, names shared by joints and links, doubtful and refused numbers."""

import re
from pathlib import Path

import numpy as np
import pytest
from containing import Containing, OneSentence

from hesr_model.errors import RobotError
from hesr_model.robots import model_file
from hesr_model.robots.robot import Robot, RobotDescription

LINK = """<link name="{name}"><inertial><origin xyz="0.1 0 0.2"/><mass value="{mass}"/>
<inertia ixx="{xx}" iyy="0.02" izz="0.03" ixy="0" ixz="0.001" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0.2 0 0.1" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>{more}</joint>"""
LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="3"/>'


def chain(folder: Path, *changes: dict[str, str], link: dict[str, str] | None = None) -> Path:
    """A chain j1, j2, .. of joints about y; the last link can be changed."""
    parts = [LINK.format(name="base", mass=1, xx=0.02)]
    for k, change in enumerate(changes, start=1):
        known = {"name": f"j{k}", "kind": "revolute", "axis": "0 1 0", "more": LIMIT}
        known |= {"parent": f"j{k - 1}" if k > 1 else "base", "child": f"j{k}"}
        own = {"name": f"j{k}", "mass": str(k), "xx": "0.02"}
        own |= (link or {}) if k == len(changes) else {}
        parts += [JOINT.format(**(known | change)), LINK.format(**own)]
    path = folder / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def describe(path: Path, *joints: str, **more: object) -> RobotDescription:
    data = {"name": "arm", "model": path, "joints": joints} | more
    return RobotDescription.model_validate(data)


MIMIC = {"more": f'{LIMIT}<mimic joint="j2" multiplier="-1" offset="0.2"/>'}
AGAIN = {"more": f'{LIMIT}<mimic joint="j3" multiplier="2"/>'}


def test_followers_act_on_their_leader(tmp_path: Path) -> None:
    """Virtual work: tau = G' tau_all at G q + b; links and joints have the same names."""
    free = Robot(describe(chain(tmp_path, {}, {}, {}, {}), "j1", "j2", "j3", "j4"))
    robot = Robot(chain(tmp_path, {}, {}, MIMIC, AGAIN))
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 6, 2))
    slopes = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.0, -2.0]])
    states = q @ slopes.T + [0.0, 0.0, 0.2, 0.4], dq @ slopes.T, ddq @ slopes.T
    expected = free.torque(free.nominal_parameters, *states) @ slopes
    assert robot.joints == ("j1", "j2")
    found = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    mass, bias = robot.dynamics(robot.nominal_parameters, q, dq)
    rebuilt = np.einsum("kij,kj->ki", mass, ddq) + bias
    np.testing.assert_allclose(rebuilt, expected, atol=1e-12)


def test_followers_of_a_locked_joint_rest_with_it(tmp_path: Path) -> None:
    free = chain(tmp_path, {}, {}, {})
    rests = Robot(describe(free, "j1", locked={"j2": 0.5, "j3": -0.3}))
    path = chain(tmp_path, {}, {}, MIMIC)
    robot = Robot(describe(path, "j1", locked={"j2": 0.5}))
    np.testing.assert_allclose(robot.nominal_parameters, rests.nominal_parameters, atol=1e-14)
    for changes in ({"joints": ("j1", "j2", "j3")}, {"joints": ("j1",), "locked": {"j3": 0.1}}):
        with pytest.raises(RobotError, match=r"arm\.urdf: joint 'j3' follows joint 'j2', whose "):
            Robot(describe(path, "j1").model_copy(update=changes))


@pytest.mark.parametrize(
    ("joint", "link", "sentence"),
    [
        (
            {},
            {"mass": "2,5"},
            "'2,5' in <mass> of link 'j2'",
        ),
        (
            {"axis": "0 1"},
            {},
            "xyz = '0 1' in <axis>",
        ),
        (
            {"axis": "0 0 0"},
            {},
            "the axis of joint 'j2' is 0 0 0, which is no direction; give its <axis> a unit "
            "vector.",
        ),
        ({}, {"xx": "1e999"}, "infinite moment of inertia"),
        ({}, {"xx": "-inf"}, "infinite moment of inertia"),
        ({}, {"mass": "-1"}, "link 'j2' has a negative mass, -1 kg; correct its <mass>."),
        (
            {"more": LIMIT + '<mimic joint="j9"/>'},
            {},
            "joint 'j2' follows joint 'j9', which does not move; correct its <mimic> or equality.",
        ),
        (
            {"more": LIMIT + '<mimic joint="j2"/>'},
            {},
            "joint 'j2' follows joint 'j2', which follows it; correct its <mimic> or equality.",
        ),
    ],
)
def test_numbers_without_meaning_are_refused(
    tmp_path: Path, joint: dict[str, str], link: dict[str, str], sentence: str
) -> None:
    path = chain(tmp_path, {}, joint, link=link)
    with pytest.raises(RobotError) as caught:
        Robot(path)
    assert str(caught.value) == Containing(f"{path}: ", sentence)


@pytest.mark.parametrize(
    ("limit", "link", "found"),
    [
        (LIMIT.replace('"2"', '"-3"'), {}, "its position limits are reversed, -1 and -3, and cou"),
        (LIMIT.replace('"2"', '"-1"'), {}, "limits are equal, -1 and -1"),
        (LIMIT.replace('"2"', '"180"'), {}, "180 rad look like degrees: write"),
        (LIMIT, {"mass": "0"}, "its link has no mass: give the link an <inertial> if it is a "),
        ("", {}, "has no limits: state them in its <limit>; hesr excite needs them."),
        (LIMIT, {"xx": "0.2"}, "link 'j2' are 0.02, 0.03, 0.2"),
    ],
)
def test_doubtful_numbers_are_reported(
    tmp_path: Path, limit: str, link: dict[str, str], found: str
) -> None:
    assert Robot(chain(tmp_path, {}, {})).doubts == ()
    path = chain(tmp_path, {}, {"more": limit}, link=link)
    (doubt,) = Robot(path).doubts
    where = f"{path}, joint 'j2': " if doubt.joints else f"{path}: "
    assert doubt.sentence == Containing(where, found)


def test_a_link_with_two_joints_is_refused(tmp_path: Path) -> None:
    """Pinocchio would read it twice."""
    path = chain(tmp_path, {}, {}, {"child": "j1"})
    with pytest.raises(RobotError, match=r"link 'j1' .* joints 'j1' and 'j3'"):
        Robot(path)


def test_a_joint_that_moves_no_inertia_is_an_error(tmp_path: Path) -> None:
    """The last link turns about y without any inertia about it."""
    path = chain(tmp_path, {}, {})
    text = path.read_text(encoding="utf-8").replace('xyz="0.1 0 0.2"', 'xyz="0 0 0"')
    path.write_text(text.replace('iyy="0.02"', 'iyy="0"'), encoding="utf-8")
    first, *others = Robot(path).doubts
    assert (first.check, first.severity, first.joints) == ("no-inertia", "error", ("j2",))
    assert "0 kg.m2 (kg if it slides)" in (first.sentence)
    assert {doubt.check for doubt in others} == {"impossible-inertia"}
    head, last = text.rsplit("<inertia ", 1)
    last = re.sub(r'(i\w\w)="[^"]*"', r'\1="0"', last)
    path.write_text(f"{head}<inertia {last}", encoding="utf-8")
    rounded, *others = Robot(path).doubts
    assert rounded.sentence.startswith(f"{path}, joint 'j2': its link of ")
    assert "rounded: write more digits of" in rounded.sentence
    assert others == []
    known = Robot(describe(path, "j1", "j2", known=()))  # placeholders
    assert known.doubts == ()


@pytest.mark.parametrize(
    ("mimic", "lower", "upper", "speed"),
    [
        ('multiplier="-2" offset="0.2"', -0.9, 0.6, 1.5),  # -1 <= 0.2 - 2 q <= 2, speed 3
        ('multiplier="0.5"', -1.0, 2.0, 3.0),
        ('multiplier="1" offset="9"', -1.0, 2.0, 3.0),  # conflicts with its own range
    ],
)
def test_followers_limit_their_leader(
    tmp_path: Path, mimic: str, lower: float, upper: float, speed: float
) -> None:
    robot = Robot(chain(tmp_path, {}, {}, {"more": f'{LIMIT}<mimic joint="j2" {mimic}/>'}))
    np.testing.assert_allclose(np.array(robot.limits)[:, 1], [lower, upper, speed])
    np.testing.assert_array_equal(np.array(robot.limits)[:, 0], [-1.0, 2.0, 3.0])
    found = [doubt.found for doubt in robot.doubts]
    conflict = "limits count as none"
    assert found == ([Containing(conflict)] if "9" in mimic else [])


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ('lower="-1e30" upper="2"', (-np.inf, 2.0)),
        ('lower="-1" upper="1e30"', (-1.0, np.inf)),
        ('lower="-1e30" upper="1e30"', (-np.inf, np.inf)),
        ('lower="2" upper="-1"', (-np.inf, np.inf)),  # reversed
    ],
)
def test_a_limit_may_be_infinite_on_one_side(
    stated: str, expected: tuple[float, float], tmp_path: Path
) -> None:
    limit = f'<limit {stated} effort="5" velocity="3"/>'
    lower, upper, _ = Robot(chain(tmp_path, {"more": limit}, {})).limits
    assert (lower[0], upper[0]) == expected
    assert (lower[1], upper[1]) == (-1.0, 2.0)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_absent_limits_are_infinite(tmp_path: Path, kind: str) -> None:
    robot = Robot(chain(tmp_path, {"kind": kind, "more": ""}, {"kind": kind}))
    np.testing.assert_array_equal(robot.limits, [[-np.inf, -1], [np.inf, 2], [np.inf, 3]])
    np.testing.assert_array_equal(robot.torque_limits, [0.0, 5.0])
    assert np.all(np.isfinite(robot.reach))


def test_torques_that_differ_from_mujoco_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, compiled = chain(tmp_path, {}, {}), model_file.compute_urdf_torques
    Robot(path)

    def changed(text: str) -> object:
        return compiled(text.replace('mass value="2"', 'mass value="2.0001"'))

    monkeypatch.setattr(model_file, "compute_urdf_torques", changed)
    with pytest.raises(RobotError, match=r"arm\.urdf: the torque of joint 'j1' differs from MuJoC"):
        Robot(path)


@pytest.mark.parametrize("encoding", ["klingon", "utf-7", "idna"])
def test_unknown_encodings_are_refused(encoding: str, tmp_path: Path) -> None:
    path = chain(tmp_path, {})
    head = f'<?xml version="1.0" encoding="{encoding}"?>'
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(RobotError, match=r"arm\.urdf: cannot be parsed as a URDF \("):
        model_file.load(path)


def test_a_template_is_not_read_as_a_robot(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a"/>'
        "</robot>",
        encoding="utf-8",
    )
    with pytest.raises(RobotError) as caught:
        Robot(path)
    assert f"{path}: is a xacro template" in str(caught.value)


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
def test_a_limit_without_positions_states_none(tmp_path: Path, kind: str) -> None:
    """Of one position the other is 0; without both, they are not 0 and 0."""
    speed = {"kind": kind, "more": '<limit effort="5" velocity="3"/>'}
    upper = {"kind": kind, "more": '<limit upper="2" effort="5" velocity="3"/>'}
    zeros = {"kind": kind, "more": '<limit lower="0" upper="0" effort="5" velocity="3"/>'}
    robot = Robot(chain(tmp_path, speed, upper, zeros))
    np.testing.assert_array_equal(robot.limits[0], [-np.inf, 0.0, -np.inf])
    np.testing.assert_array_equal(robot.limits[2], [3.0, 3.0, 3.0])
    checks = {doubt.joints: doubt.check for doubt in robot.doubts}
    assert checks == {("j1",): "no-limits", ("j3",): "odd-limits"}


@pytest.mark.parametrize("declaration", ["", ' xmlns:gz="gazebo"'])
def test_prefixes_of_other_tools_need_no_declaration(declaration: str, tmp_path: Path) -> None:
    """As those of Drake in files of arms and grippers."""
    path = chain(tmp_path, {})
    plain_names = list(model_file.load(path).pin_model.names)
    text = path.read_text(encoding="utf-8")
    text = re.sub("<robot", f"<robot{declaration}", text, count=1)
    text = text.replace("</robot>", '<drake:collision_filter_group name="a"/><gz:x/></robot>')
    text = text.replace("<axis ", '<axis drake:note="http://a:b" ')
    path.write_text(text, encoding="utf-8")
    assert text.count("drake:") > 1
    assert list(model_file.load(path).pin_model.names) == plain_names


def test_a_template_without_a_declaration_is_one_as_well(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text('<robot name="r"><xacro:include filename="a"/></robot>', encoding="utf-8")
    with pytest.raises(RobotError, match="is a xacro template"):
        model_file.load(path)


def test_doubts_are_those_of_links_that_the_joints_move(tmp_path: Path) -> None:
    """Of a walking robot with an arm, neither the trunk nor a leg concerns the arm."""
    path = chain(tmp_path, {}, {"parent": "base", "more": ""}, {"parent": "j1"}, link={"xx": "0.2"})
    text = path.read_text(encoding="utf-8").replace('ixx="0.02"', 'ixx="0.2"', 1)
    path.write_text(text, encoding="utf-8")
    expected = {
        ("j1",): ["impossible-inertia"],
        ("j3",): ["impossible-inertia"],
        ("j2",): ["no-limits"],
        ("j1", "j2"): ["impossible-inertia", "no-limits"],
    }
    for joints, checks in expected.items():
        names = [name for name in model_file.load(path).pin_model.names[1:] if name in joints]
        doubts = Robot(describe(path, *names)).doubts
        assert sorted(doubt.check for doubt in doubts) == checks, joints
        assert all("'j3'" in doubt.found for doubt in doubts if not doubt.joints)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('<link name="b"/><link name="b"/>', "link 'b' is not unique"),
        ("", "No link elements found"),
        ('<link name="b"/><link name="c"/>', "Two root links found"),
        (
            '<link name="b"/><joint name="j" type="fixed"><parent link="b"/><child link="z"/>'
            "</joint>",
            "child link [z] of joint [j]",
        ),
        (
            '<link name="b"/><link name="c"/><joint name="j" type="revolut"><parent link="b"/>'
            '<child link="c"/></joint>',
            "Joint [j] has no known type",
        ),
    ],
)
def test_the_reason_of_the_parser_is_in_the_sentence(
    text: str, reason: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{text}</robot>', encoding="utf-8")
    with pytest.raises(RobotError) as error:
        Robot(path)
    assert str(error.value) == OneSentence(f"{path}: ", reason)
    assert capfd.readouterr().err == ""
