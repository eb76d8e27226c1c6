"""MJCF as MuJoCo compiles it: torques, references, trees, equalities and refusals."""

import re
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import RobotError
from hesr_model.motions.limits import Limits, MotionLimits
from hesr_model.robots.mjcf import import_engine
from hesr_model.robots.robot import Robot, RobotDescription, describe_model, to_description

INERTIAL = '<inertial pos="0.2 0.01 0.02" mass="{}" diaginertia="0.02 0.03 0.04"/>'


def mjcf(folder: Path, body: str, more: str = "", options: str = "") -> Path:
    path = folder / "arm.xml"
    compiler = '<compiler angle="radian"/>'
    text = f"<mujoco>{compiler}{options}<worldbody>{body}</worldbody>{more}</mujoco>"
    path.write_text(text, encoding="utf-8")
    return path


def arm(name: str, frame: str, *joints: str) -> str:
    """A chain of bodies with a joint each, below a body without joint."""
    chain = ""
    for k, joint in reversed(list(enumerate(joints, start=1))):
        own = f'<joint name="{name}{k}" {joint}/>{INERTIAL.format(k)}'
        chain = f'<body name="{name}_link{k}" pos="0.3 0.1 0" euler="0.2 0 0.3">{own}{chain}</body>'
    return f'<body name="{name}" {frame}>{chain}</body>'


def torques(robot: Robot, path: Path, *, others: dict[str, float] | None = None) -> np.ndarray:
    """Compare with mj_inverse of the whole file without damping; return HESR's torques."""
    mujoco = import_engine()
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    q, dq, ddq = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 5, robot.n))
    names = [joint.name for joint in robot.tree]
    slopes, offsets = robot.follow or (np.eye(robot.n), np.zeros(robot.n))
    place = [model.joint(name).qposadr[0] for name in names]
    dofs = [model.joint(name).dofadr[0] for name in names]
    expected = []
    for name, position in (others or {}).items():
        data.joint(name).qpos = position
    for state in zip(q, dq, ddq, strict=True):
        data.qpos[place] = slopes @ state[0] + offsets
        data.qvel[dofs], data.qacc[dofs] = slopes @ state[1], slopes @ state[2]
        mujoco.mj_inverse(model, data)
        expected.append(slopes.T @ (data.qfrc_inverse + data.qfrc_damper)[dofs])
    found = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    return found


MOUNTS = ('pos="0 0 1" euler="0 1.5707963 0"', 'quat="0 1 0 0"', 'pos="1 2 3"')


@pytest.mark.parametrize("frame", MOUNTS)
def test_the_pose_of_a_first_body_without_joint_counts(tmp_path: Path, frame: str) -> None:
    path = mjcf(tmp_path, arm("a", frame, 'axis="0 1 0"', 'axis="0 1 0.2" armature="0.4"'))
    torques(Robot(path), path)


@pytest.mark.filterwarnings("ignore:.*settotalmass:UserWarning")
def test_references_frames_slides_and_a_shared_body(tmp_path: Path) -> None:
    """`ref`, `<frame>`, the order of Euler angles, springs and several joints of one body."""
    body = arm("a", 'euler="0.3 0.2 0.1"', 'axis="0 1 0" ref="0.4" stiffness="9" damping="3"')
    body = f'<frame pos="0 0 1" euler="0.5 0 0">{body}</frame>'.replace(
        "<inertial", '<joint name="s" type="slide" axis="1 0 1" ref="-0.2" pos="0 1 0"/><inertial'
    )
    path = mjcf(tmp_path, body, options='<compiler eulerseq="zyx" settotalmass="7"/>')
    robot = Robot(path)
    torques(robot, path)
    assert robot.slides == (False, True)
    assert robot.nominal_parameters[10] == pytest.approx(7.0)
    locked = Robot(RobotDescription(name="x", model=path, joints=("a1",), springs=("a1",)))
    torques(locked, path, others={"s": -0.2})  # its reference


def test_springs_of_the_file_are_terms_of_the_body(tmp_path: Path) -> None:
    turning = 'axis="0 1 0" stiffness="30" springref="0.4" ref="0.1" frictionloss="0.7"'
    path = mjcf(tmp_path, arm("a", "", turning, 'type="slide" axis="1 0 0" stiffness="8"'))
    robot = Robot(path)
    assert robot.description.springs == ("a1", "a2")
    torques(robot, path)
    assert not [doubt for doubt in robot.doubts if doubt.check == "no-spring"]
    without = Robot(robot.description.model_copy(update={"springs": ("a1",)}))
    (doubt,) = [doubt for doubt in without.doubts if doubt.check == "no-spring"]
    assert (doubt.joints, doubt.where) == (("a2",), str(path))


def test_gravity_and_inertias_of_shapes_are_those_of_the_file(tmp_path: Path) -> None:
    body = arm("a", "", 'axis="0 1 0"').replace(
        INERTIAL.format(1), '<geom type="box" size="0.1 0.2 0.3" pos="0.1 0 0"/>'
    )
    path = mjcf(tmp_path, body, options='<option gravity="1 2 -3"/>')
    robot = Robot(path)
    np.testing.assert_array_equal(robot.gravity, [1.0, 2.0, -3.0])
    torques(robot, path)
    path = mjcf(tmp_path, body, options='<option><flag gravity="disable"/></option>')
    np.testing.assert_array_equal(Robot(path).gravity, np.zeros(3))


MESH = '<asset><mesh name="m" vertex="0 0 0 0.3 0 0 0 0.1 0 0 0 0.2"/></asset>'
SITES = '<site type="mesh" mesh="m"/><site type="capsule" size="1" fromto="0 0 0 1 1 1"'
UNUSUAL = {
    "springs disabled": (
        ('axis="0 1 0" stiffness="30"',), "", '<option><flag spring="disable"/></option>', {}
    ),
    "negative spring": (('axis="0 1 0" stiffness="-3" springref="0.2"',), "", "", {}),
    "gigabytes for contacts": (('axis="0 1 0"',), "", '<size njmax="9000" nconmax="900000"/>', {}),
    "mesh of a site": (('axis="0 1 0"', f'axis="0 1 0"/>{SITES}'), MESH, "", {}),
    "equalities disabled": (
        ('axis="0 1 0"', 'axis="0 1 0"'),
        '<equality><joint joint1="a2" joint2="a1"/></equality>',
        '<option><flag equality="disable"/></option>',
        {},
    ),
    "follower of a held joint": (
        ('axis="0 1 0"', 'axis="0 1 0"', 'axis="1 0 0" ref="0.2"'),
        '<equality><joint joint1="a3" joint2="a2" polycoef="0.1 2 0 0 0"/>'
        '<joint joint1="a2" polycoef="0.3 0 0 0 0"/></equality>',
        "",
        {"a2": 0.3, "a3": 0.2 + 0.1 + 2 * 0.3},
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", UNUSUAL)
def test_unusual_files_are_read_as_by_mujoco(kind: str, tmp_path: Path) -> None:
    joints, more, options, held = UNUSUAL[kind]
    path = mjcf(tmp_path, arm("a", "", *joints), more, options)
    robot = Robot(path)
    assert len(robot.tree) == len(joints) - len(held)
    torques(robot, path, others=held)


def test_parts_without_a_name_get_one_of_their_own(tmp_path: Path) -> None:
    """Even if others are called after their numbers."""
    body = f'<body name="body2"><joint axis="0 1 0"/>{INERTIAL.format(1)}<body>'
    body += f'<joint name="joint0" axis="0 1 0" pos="0.1 0 0"/>{INERTIAL.format(2)}</body></body>'
    path = mjcf(tmp_path, body)
    robot = Robot(path)
    assert robot.joints == ("joint0_", "joint0")
    named = mjcf(tmp_path, body.replace("<joint axis", '<joint name="first" axis'))
    np.testing.assert_array_equal(robot.nominal_parameters, Robot(named).nominal_parameters)


def test_the_robot_file_turns_the_base(tmp_path: Path) -> None:
    turned = mjcf(tmp_path, arm("a", 'euler="0.4 0 0"', 'axis="0 1 0"', 'axis="1 1 0"'))
    expected = torques(Robot(turned), turned)
    path = mjcf(tmp_path, arm("a", "", 'axis="0 1 0"', 'axis="1 1 0"'))
    level = RobotDescription(name="x", model=path, joints=("a1", "a2"))
    mounted = Robot(level.model_copy(update={"mount": (0.4, 0.0, 0.0)}))
    q, dq, ddq = np.random.default_rng(1).uniform(-1.0, 1.0, (3, 5, 2))
    found = mounted.torque(mounted.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    down = Robot(level.model_copy(update={"gravity": tuple(mounted.gravity)}))
    np.testing.assert_array_equal(down.torque(down.nominal_parameters, q, dq, ddq), found)


def test_a_body_selects_one_of_two_arms(tmp_path: Path) -> None:
    two = arm("left", 'pos="0 1 0"', 'axis="0 1 0"', 'axis="0 1 0"')
    two += arm("right", 'euler="1 0 0"', 'axis="0 1 0"', 'axis="0 1 0"')
    path = mjcf(tmp_path, two)
    assert to_description(path).joints == ("left1", "left2", "right1", "right2")
    torques(Robot(path), path)
    one = RobotDescription(name="x", model=path, joints=("right1", "right2"), root="right")
    torques(Robot(one), path)
    for root, message in (
        ("left", r"arm\.xml: has no joint 'right1'; it has left1, left2\.$"),
        (
            "leg",
            "'root' is 'leg', and no body",
        ),
    ):
        with pytest.raises(RobotError, match=message):
            Robot(one.model_copy(update={"root": root}))


EQUALITY = """<equality><joint joint1="a3" joint2="a2" polycoef="0.1 -1.5 {more} 0 0"/>
<joint joint1="a4" polycoef="0.3 0 0 0 0"/></equality>"""
FOUR = ('axis="0 1 0"', 'axis="0 1 0" ref="0.3"', 'axis="0 1 0" armature="2"', 'axis="1 0 0"')


def test_joint_equalities_are_one_linear_map(tmp_path: Path) -> None:
    path = mjcf(tmp_path, arm("a", "", *FOUR), EQUALITY.format(more=0))
    robot = Robot(path)
    assert robot.joints == ("a1", "a2")
    slopes, offsets = robot.follow or (0, 0)
    np.testing.assert_allclose(slopes, [[1, 0], [0, 1], [0, -1.5]])
    np.testing.assert_allclose(offsets, [0, 0, 0.1 + 1.5 * 0.3])
    torques(robot, path, others={"a4": 0.3})
    assert len(robot.parameter_names) == 10 * 3 + 2
    np.testing.assert_allclose(robot.rotor_nominal, [0.0, 1.5**2 * 2.0])


def test_followers_by_an_equality_limit_their_leader(tmp_path: Path) -> None:
    """a3 = 0.55 - 1.5 a2 lies between -1 and 0.7; a4 does not move."""
    ranged = (FOUR[0], f'{FOUR[1]} range="-3 0.9"', f'{FOUR[2]} range="-1 0.7"', FOUR[3])
    robot = Robot(mjcf(tmp_path, arm("a", "", *ranged), EQUALITY.format(more=0)))
    low, high, _ = robot.limits
    np.testing.assert_allclose(low, [-np.inf, -0.1])
    np.testing.assert_allclose(high, [np.inf, 0.9])
    limited = Limits.from_settings(
        robot, MotionLimits(position=((-1, 1), (-0.1, 0.9)), velocity=(1, 1))
    )
    np.testing.assert_allclose(limited.upper, [1.0, 0.9])
    with pytest.raises(RobotError, match=r"'a2' is -0\.5 to 0\.9; the model allows -0\.1 to 0\.9"):
        Limits.from_settings(robot, MotionLimits(position=((-1, 1), (-0.5, 0.9)), velocity=(1, 1)))


@pytest.mark.parametrize(
    ("body", "more", "message"),
    [
        (
            arm("a", "", 'axis="0 1 0"').replace(
                INERTIAL.format(1), '<geom type="mesh" mesh="link"/>'
            ),
            '<asset><mesh name="link" file="link.stl"/></asset>',
            "the inertia of body 'a_link1' comes from the mesh 'link.stl', which is not in",
        ),
    ],
)
def test_files_without_determined_torques_are_refused(
    tmp_path: Path, body: str, more: str, message: str
) -> None:
    with pytest.raises(RobotError, match=r"arm\.xml: ") as caught:
        Robot(mjcf(tmp_path, body, more))
    assert message in str(caught.value)


LOOPS = {
    "bodies": (
        '<equality><connect body1="a_link3" body2="a_link1" anchor="0 0 0"/></equality>',
        {"a2", "a3"},
        "the bodies 'a_link3' and 'a_link1'",
    ),
    "base": (
        '<equality><weld body1="a_link2"/></equality>',
        {"a1", "a2"},
        "the bodies 'a_link2' and 'world'",
    ),
    "two leaders": (
        '<equality><joint joint1="a3" joint2="a2"/><joint joint1="a3" joint2="a4"/></equality>',
        {"a2", "a3", "a4"},
        "joints a3, a2, a4 are coupled by several equalities of 'a3'",
    ),
    "polynomial": (
        '<equality><joint joint1="a3" joint2="a2" polycoef="0 1 2 0 0"/></equality>',
        {"a2", "a3"},
        "the polynomial of an equality of 'a3'",
    ),
    "tendon of joints": (
        '<tendon><fixed name="t"><joint joint="a2" coef="1"/><joint joint="a4" coef="1"/></fixed>'
        '</tendon><equality><tendon tendon1="t"/></equality>',
        {"a2", "a4"},
        "an equality of tendon t",
    ),
    "tendon along sites": (
        '<tendon><spatial name="t"><site site="low"/><site site="high"/></spatial></tendon>'
        '<equality><tendon tendon1="t"/></equality>',
        {"a2", "a3"},
        "an equality of tendon t",
    ),
}


def with_sites(body: str) -> str:
    for number, name in ((1, "low"), (3, "high")):
        place = f'<body name="a_link{number}"'
        assert place in body
        end = body.index(">", body.index(place)) + 1
        body = f'{body[:end]}<site name="{name}" pos="0.1 0 0.1"/>{body[end:]}'
    return body


@pytest.mark.parametrize("kind", LOOPS)
def test_joints_in_a_loop_rest_unless_they_are_asked_for(kind: str, tmp_path: Path) -> None:
    more, looped, cause = LOOPS[kind]
    path = mjcf(tmp_path, with_sites(arm("a", "", *FOUR)), more)
    others = [name for name in ("a1", "a2", "a3", "a4") if name not in looped]
    robot = Robot(path)
    assert list(robot.joints) == others
    (doubt,) = (doubt for doubt in robot.doubts if doubt.check == "loop")
    assert doubt.severity == "advice"
    assert cause in doubt.found
    assert "fixed" not in doubt.found
    torques(robot, path)
    with pytest.raises(RobotError, match="undetermined") as caught:
        Robot(describe_model(path, ["a1", "a2", "a3", "a4"]))
    (named,) = re.findall(r"take only joints (.*)\.", str(caught.value))
    assert named.split(", ") == others
    assert Robot(describe_model(path, named.split(", "))).joints == robot.joints


def test_an_arm_that_is_a_loop_is_refused(tmp_path: Path) -> None:
    body = arm("a", "", *FOUR[:2])
    path = mjcf(tmp_path, body, '<equality><weld body1="a_link2"/></equality>')
    with pytest.raises(RobotError, match=r"'a1' is undetermined; remove the equality\."):
        Robot(path)


def test_appearance_may_be_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes, textures and what refers to them; nothing is written into the current folder."""
    monkeypatch.chdir(tmp_path)
    geom = '<geom type="mesh" mesh="m"/>'
    body = arm("a", "", 'axis="0 1 0"').replace("<inertial", f"{geom}<inertial")
    asset = '<asset><mesh name="m" file="m.stl"/><texture name="t" type="2d" file="t.png"/>'
    asset += '<material name="c" texture="t"/></asset>'
    path = mjcf(tmp_path, body.replace("<geom", '<site material="c"/><geom material="c"'), asset)
    assert Robot(path).n == 1
    assert [file.name for file in tmp_path.iterdir()] == ["arm.xml"]


@pytest.mark.parametrize("name", ["tip.xml", "../parts/tip.xml"])
def test_an_included_file_counts(name: str, tmp_path: Path) -> None:
    """Also for the cache of compiled files."""
    folder = tmp_path / "arm"
    tip = folder / name
    for place in (folder, tip.parent):
        place.mkdir(exist_ok=True)
    path = mjcf(
        folder,
        arm("a", "", 'axis="0 1 0"').replace(
            "</body></body>", f'<include file="{name}"/></body></body>'
        ),
    )
    masses = []
    for mass in (1.0, 2.0):
        tip.write_text(f'<mujoco><body name="tip">{INERTIAL.format(mass)}</body></mujoco>')
        masses.append(Robot(path).nominal_parameters[0])
        torques(Robot(path), path)
    assert masses == [2.0, 3.0]
