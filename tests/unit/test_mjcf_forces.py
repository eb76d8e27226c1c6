"""Forces of MJCF that the torque of a robot leaves out: each is named with what it is worth."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hesr_model.findings import Finding
from hesr_model.robots import mjcf_forces
from hesr_model.robots.mjcf import import_engine
from hesr_model.robots.robot import Robot

TABLE = tomllib.loads(Path(__file__).with_name("mjcf_schema.toml").read_text("utf-8"))
_LINE = re.compile(r"( *)(\S+) \(.\) *(.*)")
_INDENT = 3  # of an element within another
INERTIAL = '<inertial pos="0.2 0.01 0.02" mass="{}" diaginertia="0.02 0.03 0.04"/>'
WATER = '<option density="1000" viscosity="0.5"/>'
FIXED = (
    '<tendon><fixed name="t" {}><joint joint="a" coef="1"/><joint joint="b" coef="-0.5"/></fixed>'
    "</tendon>"
)
SPATIAL = '<tendon><spatial {}><site site="world"/><site site="tip"/></spatial></tendon>'
MESH = '<asset><mesh name="m" vertex="0 0 0 0.6 0 0 0 0.1 0 0 0 0.4"/></asset>'
FLEX = (
    '<deformable><flex name="f" dim="1" body="upper fore" vertex="0.1 0 0 0.2 0 0" element="0 1">'
    "<edge {}/></flex></deformable>"
)


def mjcf(joint: str = "", body: str = "", geom: str = "", options: str = "", more: str = "") -> str:
    return (
        f'<mujoco><compiler angle="radian"/>{options}<worldbody><site name="world" pos="0 1 1"/>'
        f'<body name="upper" {body}><joint name="a" axis="0 1 0" {joint}/>{INERTIAL.format(2)}'
        f'{geom}<body name="fore" pos="0.3 0 0" euler="0.3 0 0"><joint name="b" axis="0 1 0"/>'
        f'{INERTIAL.format(1)}<site name="tip" pos="0.3 0 0"/></body></body></worldbody>{more}'
        "</mujoco>"
    )


def motor(kind: str, text: str, more: str = "") -> str:
    needs = {"cylinder": 'area="1"', "dcmotor": 'motorconst="1" resistance="1"'}
    needs |= {"damper": 'kv="1" ctrlrange="0 1"', "muscle": 'lengthrange="0.1 1"'}
    needs |= {"intvelocity": 'actrange="0 1"'}
    return f"{more}<actuator><{kind} {needs.get(kind, '')} {text}/></actuator>"


KINDS = ("general", "motor", "position", "velocity", "intvelocity", "pid", "damper", "cylinder",
         "muscle", "dcmotor")  # fmt: skip
AT_TENDON = {
    f"armature of {kind}": (
        mjcf(more=motor(kind, 'tendon="t" armature="0.1"', FIXED.format(""))),
        "armature of <actuator>",
    )
    for kind in KINDS
}
DAMPED = {
    f"damping of {kind}": (
        mjcf(more=motor(kind, 'joint="a" damping="2" gear="3"')),
        "damping of <actuator>",
    )
    for kind in KINDS
}
FORCES = {
    "gravcomp": (mjcf(body='gravcomp="0.8"'), "gravcomp of <body>"),
    "damping": (mjcf('damping="2"'), "damping of <joint>"),
    "orders of damping": (mjcf('damping="0 3 1"'), "damping of <joint>"),
    "orders of stiffness": (mjcf('stiffness="0 3 1"'), "higher orders of stiffness of <joint>"),
    "stiffness of fixed": (
        mjcf(more=FIXED.format('stiffness="9" springlength="0.1"')),
        "stiffness of <tendon>",
    ),
    "stiffness of spatial": (
        mjcf(more=SPATIAL.format('stiffness="9" springlength="0.1"')),
        "stiffness of <tendon>",
    ),
    "damping of fixed": (mjcf(more=FIXED.format('damping="9"')), "damping of <tendon>"),
    "damping of spatial": (mjcf(more=SPATIAL.format('damping="9"')), "damping of <tendon>"),
    "armature of fixed": (mjcf(more=FIXED.format('armature="0.9"')), "armature of <tendon>"),
    "armature of spatial": (mjcf(more=SPATIAL.format('armature="0.9"')), "armature of <tendon>"),
    "density": (mjcf(options='<option density="1000"/>'), "density and viscosity of <option>"),
    "viscosity": (mjcf(options='<option viscosity="9"/>'), "density and viscosity of <option>"),
    "wind": (
        mjcf(options='<option density="9" wind="9 0 0"/>'),
        "density and viscosity of <option>",
    ),
    "ellipsoid": (
        mjcf(
            options=WATER,
            geom='<geom type="ellipsoid" size="0.1 0.2 0.3" fluidshape="ellipsoid"/>',
        ),
        "density and viscosity of <option>",
    ),
    "ellipsoid of a mesh": (
        mjcf(options=MESH + WATER, geom='<geom type="mesh" mesh="m" fluidshape="ellipsoid"/>'),
        "density and viscosity of <option>",
    ),
    "edges of flex": (mjcf(more=FLEX.format('stiffness="300"')), "elasticity of <flex>"),
    **AT_TENDON,
    **DAMPED,
}


def read_schema() -> Iterator[tuple[str, str]]:
    """Yield elements below others and attributes, without those of defaults."""
    path: list[str] = []
    names = ""
    for line in import_engine().mj_printSchema(False, False).splitlines():
        match = _LINE.fullmatch(line)
        names = line
        if match:
            path[len(match[1]) // _INDENT :] = [match[2].removeprefix("(world)")]
            names = match[3]
        if path[1:2] != ["default"]:
            element = "/".join(path[1:]) or path[0]
            yield from ((element, name) for name in names.split())


def compute_torques(text: str) -> np.ndarray:
    mujoco = import_engine()
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    torques = []
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 8, model.nv))
    for state in zip(*states, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = state
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse.copy())
    return np.array(torques)


def left_over(path: Path) -> list[Finding]:
    return [finding for finding in Robot(path).doubts if finding.check == "left-over"]


def test_every_attribute_of_the_schema_is_known() -> None:
    listed = [
        (element, name)
        for elements in TABLE.values()
        for element, names in elements.items()
        for name in names
    ]
    assert len(listed) == len(set(listed))
    assert set(read_schema()) - set(listed) == set()
    assert set(listed) - set(read_schema()) == set()


@pytest.mark.parametrize(("text", "force"), FORCES.values(), ids=FORCES)
def test_a_force_is_named_with_its_torque(text: str, force: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(text, encoding="utf-8")
    worth = np.abs(compute_torques(text) - compute_torques(mjcf())).max(axis=0)
    (finding,) = left_over(path)
    assert force in finding.found
    (sizes,) = re.findall(r"worth up to (.*) N\.m", finding.found)
    assert [float(size) for size in sizes.split(", ")] == pytest.approx(worth[worth > 0], rel=0.05)
    assert finding.joints == tuple(joint for joint, w in zip("ab", worth, strict=True) if w)
    torque = np.abs(compute_torques(mjcf())).max(axis=0)
    expected = "error" if (worth / torque).max() > 0.05 else "warning"
    assert finding.severity == ("advice" if force in mjcf_forces.FRICTION else expected)


def test_the_spring_of_a_follower_is_named(tmp_path: Path) -> None:
    """The robot file has springs of leaders only."""
    path = tmp_path / "arm.xml"
    equality = '<equality><joint joint1="b" joint2="a"/></equality>'
    text = mjcf('stiffness="4"', more=equality)
    text = text.replace('name="b"', 'name="b" stiffness="9" springref="0.4"')
    path.write_text(text, encoding="utf-8")
    (finding,) = Robot(path).doubts
    assert finding.joints == ("b",)
    (size,) = re.findall(r"stiffness of <joint>, worth up to (\S+) N\.m", finding.found)
    worth = np.abs(compute_torques(text) - compute_torques(text.replace('"9"', '"0"'))).max(axis=0)
    assert float(size) == pytest.approx(worth[1], rel=0.05)


@pytest.mark.parametrize("text", ['gear="3"', 'gear="3" armature="0.1"'])
def test_motors_of_joints_are_part_of_the_torque(text: str, tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    actuators = f'<motor joint="a" {text}/><motor joint="a" armature="0.02"/>'
    text = mjcf(more=f"<actuator>{actuators}</actuator>")
    path.write_text(text, encoding="utf-8")
    assert left_over(path) == []
    robot = Robot(path)
    q, dq, ddq = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 8, 2))
    torques = robot.torque(robot.nominal_parameters, q, dq, ddq)
    np.testing.assert_allclose(torques, compute_torques(text), rtol=1e-9)


def test_a_force_that_nothing_names_is_left_over() -> None:
    """A later MuJoCo may have further forces: all that remains is one."""
    torques = np.array([[1.0, 2.0]])
    worths = mjcf_forces.measure_forces(
        import_engine().MjModel.from_xml_string(mjcf()),
        lambda _: torques + np.array([[0.0, 0.5]]),
        torques,
        np.zeros(0, dtype=bool),
    )
    assert worths == {mjcf_forces.OTHERS: [0.0, 0.5]}
