"""Unusual but valid MJCFs and URDFs: torques are those of the file, or a left-over names the force.

MuJoCo compiles each MJCF as it is, with all passive forces and without constraints; Pinocchio reads
each URDF.
"""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from torque_comparison import compare
from torque_reference import UrdfReference, draw_motion

from hesr_model.errors import RobotError
from hesr_model.robots.robot import Robot

CAPSULE = '<geom type="capsule" size="0.1 0.2" pos="0.3 0 0"/>'
LINE = '<joint joint="a" coef="2"/><joint joint="b" coef="1"/>'
MESH = '<asset><mesh name="m" inertia="shell" scale="1 2 -1" refpos="0.1 0 0" refquat="1 1 0 0"'
MESH += ' vertex="0 0 0 0.3 0 0 0 0.1 0 0 0 0.2 0.1 0.1 0.3"/></asset>'
PART = """<mujoco><default><joint damping="2"/><geom density="700"/></default><worldbody>
<body name="arm" gravcomp="0.4"><joint name="a" axis="0 1 0" stiffness="4"/>
<geom type="capsule" size="0.1 0.2" pos="0.2 0 0"/></body></worldbody>
<actuator><motor joint="a" armature="0.3" gear="2"/></actuator></mujoco>"""


def mjcf(
    a: str = "",
    b: str = "",
    *,
    upper: str = "",
    fore: str = "",
    first: str = "",
    inner: str = "",
    last: str = "",
) -> str:
    """Two links; attributes of joints and bodies, content of the upper and the lower one."""
    return f"""<mujoco><compiler angle="radian"/>{first}<worldbody><site name="w" pos="0 1 1"/>
        <body name="upper" {upper}><joint name="a" axis="0 1 0" {a}/>
        <inertial pos="0.2 0.01 0.02" mass="2" diaginertia="0.02 0.03 0.04"/>{inner}
        <body name="fore" pos="0.3 0 0" euler="0.3 0 0" {fore}><joint name="b" axis="0 1 0" {b}/>
        <inertial pos="0.1 0.01 0.02" mass="1" diaginertia="0.02 0.03 0.04"/>
        <site name="tip" pos="0.3 0 0"/></body></body></worldbody>{last}</mujoco>"""


def world(content: str, more: str = "") -> str:
    return f"<mujoco><worldbody>{content}</worldbody>{more}</mujoco>"


MJCFS = {
    "classes within classes": (
        mjcf(
            'class="y"',
            'class="x"',
            first='<default><joint damping="1"/><default class="x"><joint stiffness="3 1 0"/>'
            '<default class="y"><joint damping="0 2 0" springref="0.2"/></default></default>'
            "</default>",
        ),
        "left-over",
    ),
    "frames with a class": (
        f"""<mujoco><default><default class="x"><joint damping="4"/></default></default><worldbody>
        <frame euler="30 0 0" pos="1 0 0" childclass="x"><body gravcomp="0.5"><joint axis="0 1 0"/>
        {CAPSULE}<frame euler="0 45 0"><body pos="0.3 0 0"><joint name="q" stiffness="3"/>{CAPSULE}
        </body></frame></body></frame></worldbody></mujoco>""",
        "left-over",
    ),
    "replicates": (
        world(
            '<replicate count="2" offset="0 1 0"><replicate count="2" offset="1 0 0" sep="-">'
            f'<body name="r"><joint name="j" axis="0 1 0" damping="1" stiffness="2"/>{CAPSULE}'
            "</body></replicate></replicate>"
        ),
        "left-over",
    ),
    "models within a model": (
        '<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody><body>'
        '<joint name="s"/><geom size="0.2"/><attach model="part" body="arm" prefix="l_"/>'
        '<frame pos="0 1 0" euler="0 90 0"><attach model="part" body="arm" prefix="r_"/></frame>'
        "</body></worldbody></mujoco>",
        "left-over",
    ),
    "several motors of a joint": (
        mjcf(
            last='<actuator><motor joint="a" gear="-3" armature="0.1" damping="2"/>'
            '<position joint="a" kp="3" kv="1" armature="0.2"/>'
            '<motor jointinparent="b" gear="4" armature="0.05" damping="0 1 0"/></actuator>'
        ),
        "left-over",
    ),
    "references of joints and springs": (
        mjcf(
            'ref="0.4" springref="-0.3" stiffness="7"',
            'type="slide" ref="-0.7" stiffness="50" springref="0.1"',
        ),
        "equal",
    ),
    "time constants of a spring": (mjcf('springdamper="0.1 1"'), "left-over"),
    "a spring that yields": (mjcf('stiffness="30" springyield="0.01"'), "equal"),
    "a spring without effect": (
        mjcf('stiffness="30"', first='<option><flag spring="disable"/></option>'),
        "equal",
    ),
    "no passive forces": (
        mjcf(
            'stiffness="30" damping="2"',
            upper='gravcomp="1"',
            first='<option density="9"><flag damper="disable" spring="disable"/></option>',
        ),
        "equal",
    ),
    "compensation by an actuator": (
        mjcf('actuatorgravcomp="true"', upper='gravcomp="1"', fore='gravcomp="0.5"'),
        "left-over",
    ),
    "compensation of a fixed part": (
        mjcf(
            first='<compiler fusestatic="true"/>',
            inner='<body pos="0.2 0 0" gravcomp="0.5"><geom size="0.1"/></body>',
        ),
        "left-over",
    ),
    "a tendon around a cylinder": (
        mjcf(
            inner='<geom name="c" type="cylinder" size="0.05 0.1" euler="1.57 0 0" pos="0.3 0 0"/>',
            last='<tendon><spatial stiffness="90" springlength="0.1 0.3" range="0 9" damping="1">'
            '<site site="w"/><geom geom="c"/><site site="tip"/><pulley divisor="2"/>'
            '<site site="w"/><site site="tip"/></spatial></tendon>',
        ),
        "left-over",
    ),
    "a tendon with a dead band": (
        mjcf(
            last='<tendon><fixed stiffness="50 10 0" springlength="-0.2 0.2" damping="0 2 1">'
            f"{LINE}</fixed></tendon>"
        ),
        "left-over",
    ),
    "a motor of a tendon": (
        mjcf(
            last=f'<tendon><fixed name="t">{LINE}</fixed></tendon><actuator>'
            '<motor tendon="t" gear="-2" armature="0.3" damping="1"/></actuator>'
        ),
        "left-over",
    ),
    "adhesion and moving surfaces": (
        mjcf(
            inner='<geom type="box" size="0.1 0.1 0.1" adhesion="3" surfacevel="1 0 0 0 0 0"/>',
            last='<actuator><adhesion body="fore" ctrlrange="0 1" gain="10"/></actuator>',
        ),
        "equal",
    ),
    "wind around ellipsoids": (
        mjcf(
            first='<option density="1000" viscosity="0.1" wind="1 0 0"/>',
            inner='<geom type="capsule" size="0.05" fromto="0 0 0 0.3 0 0" fluidshape="ellipsoid" '
            'fluidcoef="1 0.25 1.5 1 1"/><geom type="box" size="0.1 0.2 0.1"/>',
        ),
        "left-over",
    ),
    "inertia of a scaled shell": (
        f'<mujoco>{MESH}<worldbody><body><joint axis="0 1 0"/><geom type="mesh" mesh="m"/></body>'
        "</worldbody></mujoco>",
        "equal",
    ),
    "followers of followers": (
        world(
            "".join(
                f'<body pos="{k} 0 0"><joint name="j{k}" axis="0 1 0" ref="{5 * k}" damping="1" '
                f'stiffness="{k}"/>{CAPSULE}</body>'
                for k in range(4)
            ),
            '<equality><joint joint1="j2" joint2="j1" polycoef="0.1 -1 0 0 0"/>'
            '<joint joint1="j1" joint2="j0" polycoef="0.2 2 0 0 0"/>'
            '<joint joint1="j3" polycoef="0.3 0 0 0 0"/></equality>',
        ),
        "left-over",
    ),
    "equalities that are not active": (
        mjcf(
            last='<equality><joint joint1="b" joint2="a" polycoef="0 1 0.5 0 0" active="false"/>'
            '<weld body1="fore" active="false"/></equality>'
        ),
        "equal",
    ),
    "a body that a mocap leads": (
        mjcf(
            last='<worldbody><body name="m" mocap="true"/></worldbody>'
            '<equality><weld body1="m" body2="fore"/></equality>'
        ),
        "equal",
    ),
    "a free base with forces": (
        world(
            '<body pos="0 0 1" euler="20 0 0" gravcomp="1"><joint type="free" damping="3"/>'
            f'<geom size="0.2"/><body><joint axis="0 1 0" damping="0.3"/>{CAPSULE}</body></body>'
        ),
        "left-over",
    ),
    "a ball with a spring": (
        world(
            '<body euler="20 0 0"><joint name="b" type="ball" stiffness="5" damping="2"/>'
            f'<geom size="0.2"/><body><joint name="a" axis="0 1 0"/>{CAPSULE}</body></body>',
            '<actuator><motor joint="b" gear="1 2 3" armature="2"/><orientation joint="b" kp="3"/>'
            "</actuator>",
        ),
        "equal",
    ),
    "three joints of one body": (
        world(
            '<body euler="10 20 30"><joint name="x" type="slide" axis="1 2 0" stiffness="100" '
            'springref="0.1"/><joint name="y" axis="0 1 1" ref="20" pos="0.1 0.2 0.3" damping="2"/>'
            f'<joint name="z" axis="0 0 3" pos="0 0.2 0.3" stiffness="0 5 0"/>{CAPSULE}</body>'
        ),
        "left-over",
    ),
    "groups of shapes": (
        '<mujoco><compiler inertiagrouprange="1 2" balanceinertia="true"/><worldbody><body>'
        '<joint axis="0 1 0"/><geom size="0.3"/><geom size="0.1" pos="0.2 0 0" group="1"/>'
        "</body></worldbody></mujoco>",
        "equal",
    ),
    "an elastic beam": (
        mjcf(
            last='<deformable><flex name="f" dim="2" body="upper fore fore" element="0 1 2" '
            'vertex="0.1 0 0 0.2 0 0 0.1 0.2 0"><elasticity young="1e5" poisson="0.1" '
            'thickness="0.01" elastic2d="both" damping="1"/></flex></deformable>'
        ),
        "left-over",
    ),
    "a solver of its own": (
        mjcf(
            'damping="3" frictionloss="2" limited="true" range="-0.1 0.1"',
            first='<option integrator="implicit"><flag invdiscrete="enable" energy="enable"/>'
            "</option>",
            last='<keyframe><key qpos="0.5 0.2" qvel="1 1"/></keyframe>',
        ),
        "left-over",
    ),
    "an actuator of a plugin": (
        mjcf(
            first='<extension><plugin plugin="mujoco.pid"><instance name="p"><config key="kp" '
            'value="4"/></instance></plugin></extension>',
            last='<actuator><plugin joint="a" plugin="mujoco.pid" instance="p" armature="0.1" '
            'damping="2" gear="2"/></actuator>',
        ),
        "left-over",
    ),
}
LINK = """<link name="{name}"><inertial><origin xyz="0.1 0.02 0.2" rpy="1.5 -0.7 2.9"/>
<mass value="{mass}"/><inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0" ixz="0.001" iyz="0"/>
</inertial></link>"""
LIMIT = '<limit lower="-1" upper="2" effort="5" velocity="3"/>'
AXIS = '<axis xyz="1 2 3"/>'


def urdf(*joints: tuple[str, str]) -> str:
    """A chain of joints j1, j2, .. of a type, with more elements."""
    parts = [LINK.format(name="l0", mass=1)]
    for k, (kind, more) in enumerate(joints, start=1):
        parts.append(LINK.format(name=f"l{k}", mass=k))
        parts.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0.2 0 0.1" rpy="0.1 1.5707963267948966 0.3"/>{more}</joint>'
        )
    return f'<robot name="r">{"".join(parts)}</robot>'


def mimic(leader: str, slope: float, offset: float = 0.0) -> str:
    return f'{AXIS}{LIMIT}<mimic joint="{leader}" multiplier="{slope}" offset="{offset}"/>'


TURNS = ("revolute", AXIS + LIMIT)
URDFS = {
    "a mimic": urdf(TURNS, ("prismatic", mimic("j1", -0.5, 0.3)), TURNS),
    "a mimic of a mimic": urdf(
        TURNS, ("revolute", mimic("j1", -2, 0.3)), ("prismatic", mimic("j2", 0.5)), TURNS
    ),
    "a mimic before its leader": urdf(("revolute", mimic("j3", -2, 0.3)), TURNS, TURNS),
    "a mimic that turns on": urdf(
        ("continuous", AXIS), ("continuous", AXIS + '<mimic joint="j1" multiplier="3"/>'), TURNS
    ),
    "a mimic that rests": urdf(TURNS, ("revolute", mimic("j1", 0, 0.5)), TURNS),
    "a floating base": urdf(("floating", ""), TURNS, TURNS),
    "a planar base": urdf(("planar", AXIS), TURNS, TURNS),
    "a default axis": urdf(TURNS, ("continuous", ""), ("prismatic", LIMIT)),
    "fixed masses": urdf(("fixed", ""), TURNS, ("fixed", ""), ("fixed", ""), TURNS, ("fixed", "")),
    "friction": urdf(TURNS, ("revolute", f'{AXIS}{LIMIT}<dynamics damping="3" friction="2"/>')),
    "a transmission": urdf(TURNS, TURNS).replace(
        "</robot>",
        '<transmission name="t"><joint name="j1"/><actuator name="m"><mechanicalReduction>50'
        "</mechanicalReduction></actuator></transmission></robot>",
    ),
    "two axes": urdf(("revolute", AXIS + '<axis xyz="0 1 0"/>' + LIMIT), TURNS),
}


@pytest.mark.ci
@pytest.mark.parametrize("kind", MJCFS)
def test_torques_of_an_mjcf_are_those_of_mujoco_or_left_over(kind: str, tmp_path: Path) -> None:
    text, outcome = MJCFS[kind]
    path = tmp_path / "robot.xml"
    path.write_text(text, encoding="utf-8")
    (tmp_path / "part.xml").write_text(PART, encoding="utf-8")
    assert compare(path) == outcome


@pytest.mark.parametrize("kind", URDFS)
def test_torques_of_a_urdf_are_those_of_pinocchio(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(URDFS[kind], encoding="utf-8")
    assert compare(path) == "equal"


def test_mimics_are_those_of_pinocchio(tmp_path: Path) -> None:
    """Its model of mimic joints reads no chains of them."""
    path = tmp_path / "robot.urdf"
    path.write_text(URDFS["a mimic"], encoding="utf-8")
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    q, dq, ddq = draw_motion(2, 1)
    expected = [
        pin.rnea(model, model.createData(), *state) for state in zip(q, dq, ddq, strict=True)
    ]
    robot = Robot(path)
    torques = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(torques, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    reference = UrdfReference(path).compute(list(robot.joints), (q, dq, ddq), {})
    np.testing.assert_allclose(reference, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_plugin_that_mujoco_lacks_is_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    plugin = '<extension><plugin plugin="mujoco.elasticity.cable"/></extension>'
    path.write_text(mjcf(first=plugin), encoding="utf-8")
    with pytest.raises(RobotError, match=r"mujoco\.elasticity\.cable"):
        Robot(path)
