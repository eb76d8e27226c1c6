"""`hesr new`: a project folder is created, run, given own logs and run again."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from containing import Containing, OneSentence
from small_study import Hesr, contents, hesr_here, uf850

from cosim.study.sample_logs import (
    is_sample,
    mark_samples,
    plausible_friction,
    sample_settings,
)
from cosim.study.starter import start
from cosim.study.study import Study
from hesr_model.errors import ConfigError, RobotError
from hesr_model.friction.model import FrictionModel
from hesr_model.health.examine import examine
from hesr_model.logs.robot_log import Log
from hesr_model.motions.excitation import random_motions
from hesr_model.rigid_body.identification import identify
from hesr_model.robots.robot import Robot, RobotDescription, to_description
from hesr_model.support.files import sha256

ROBOTS = Path(__file__).parents[2] / ".." / "shared"
UR10E = ROBOTS / "data" / "ur10e"

INERTIA = '<inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
LINK = f'<inertial><origin xyz="0.2 0 0"/><mass value="2"/>{INERTIA}</inertial>'

ONE_JOINT = f"""
<robot name="one">
  <link name="base"/>
  <joint name="pitch" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="40" velocity="2"/>
  </joint>
  <link name="arm">{LINK}
    <visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>
  </link>
</robot>
"""

# A continuous joint, a slide, and a gripper whose second finger mimics the first.
MANY_JOINTS = f"""
<robot name="many">
  <link name="base"/><link name="turret">{LINK}</link><link name="boom">{LINK}</link>
  <link name="left">{LINK}</link><link name="right">{LINK}</link><link name="tool"/>
  <joint name="turn" type="continuous">
    <parent link="base"/><child link="turret"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="turret"/><child link="boom"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.5" effort="0" velocity="0.3"/>
  </joint>
  <joint name="left" type="revolute">
    <parent link="boom"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.9" effort="1" velocity="1"/>
  </joint>
  <joint name="right" type="revolute">
    <parent link="boom"/><child link="right"/><axis xyz="0 1 0"/>
    <mimic joint="left" multiplier="-1"/>
    <limit lower="-0.9" upper="0" effort="1" velocity="1"/>
  </joint>
  <joint name="flange" type="fixed"><parent link="boom"/><child link="tool"/></joint>
</robot>
"""

JOINT = f"""<link name="{{name}}_link">{LINK}</link><joint name="{{name}}" type="continuous">
<parent link="{{parent}}"/><child link="{{name}}_link"/><axis xyz="0 1 0"/></joint>"""

BALL = """
<mujoco><worldbody><body name="ball"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="ball" type="ball"/></body></worldbody></mujoco>
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def model_file(folder: Path, text: str, name: str = "arm.urdf") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.ci
def test_a_new_project_runs_at_once_and_with_own_logs(
    tmp_path: Path, hesr: Hesr, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    model_file(tmp_path, ONE_JOINT)
    answer = hesr("new", "my_arm", "--robot", "arm.urdf")
    assert (answer.code, answer.err) == (0, "")
    assert "my_arm: a study of the joints pitch.\n" in answer.out
    assert "replace them with yours: see my_arm/README.txt" in answer.out
    command = answer.out.splitlines()[-1].removeprefix("Next: hesr ").split()
    assert command == ["run", "my_arm/study.toml"]

    answer = hesr(*command, "--verbose")
    assert answer.code == 0, answer.err
    assert "LuGre" in answer.out
    assert "results/my_arm/fmus/parfam_h.fmu" in answer.out
    before = FrictionModel.read(Path("results/my_arm/laws/lugre.json"))
    assert "Sample data, not measured" in Path("results/my_arm/report.html").read_text("utf-8")

    # Own logs with other friction and another rate, and another choice of laws.
    study = Path("my_arm/study.toml")
    laws = '["stribeck", "lugre", "parfam_h"]'
    study.write_text(study.read_text().replace(f"\nlaws = {laws}", '\nlaws = ["lugre"]'))
    description = RobotDescription.read(Path("my_arm/robot.toml"))
    for name, phase in (("sample_training", 0.0), ("sample_test", 2.0)):
        own_log(description, name, phase).write(Path(f"my_arm/logs/{name}.csv"))
    answer = hesr(*command, "--verbose")
    assert answer.code == 0, answer.err
    assert "Stribeck" not in answer.out
    assert "The logs were measured" in Path("results/my_arm/report.html").read_text("utf-8")
    after = FrictionModel.read(Path("results/my_arm/laws/lugre.json"))
    recorded = {f["name"]: f["sha256"] for f in after.provenance["files"]}
    assert recorded["sample_training.csv"] == sha256(Path("my_arm/logs/sample_training.csv"))
    assert after.laws[0].values["F_c"] == pytest.approx(3.0, rel=0.1)  # from the own log, see below
    assert before.laws[0].values["F_c"] < 2.0


def own_log(description: RobotDescription, name: str, phase: float) -> Log:
    """A log with Coulomb friction of 3 N.m and viscous friction, at 250 Hz."""
    model = Robot(description)
    t = np.arange(5000) / 250.0
    rates = 2 * np.pi * np.array([0.1, 0.23, 0.41])
    angle = np.outer(t, rates) + phase * np.arange(1, 4)
    size = np.array([0.6, 0.3, 0.15])
    q, dq, ddq = (
        (size * x).sum(axis=1)[:, None]
        for x in (np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle))
    )
    tau = model.torque(model.nominal_parameters, q, dq, ddq) + 3.0 * np.tanh(dq / 0.001) + 0.5 * dq
    noise = np.random.default_rng(1).normal(scale=0.02, size=tau.shape)
    return Log(name=name, t=t, q=q, dq=dq, tau=tau + noise)


def test_the_project_is_complete_and_states_that_its_logs_are_samples(tmp_path: Path) -> None:
    model = model_file(tmp_path, ONE_JOINT)
    start(tmp_path / "new", model)
    assert set(contents(tmp_path / "new")) == {
        "README.txt",
        "arm.urdf",
        "robot.toml",
        "study.toml",
        "logs/sample_training.csv",
        "logs/SAMPLES.sha256",
        "logs/sample_test.csv",
    }
    assert "SAMPLE DATA" in (tmp_path / "new" / "README.txt").read_text()
    assert "Columns: t, q1, dq1, tau1." in (tmp_path / "new" / "README.txt").read_text()
    assert "SAMPLE DATA" in (tmp_path / "new" / "study.toml").read_text()
    assert (tmp_path / "new" / "arm.urdf").read_bytes() == model.read_bytes()


def test_the_same_robot_gives_the_same_folder(tmp_path: Path) -> None:
    model = model_file(tmp_path, ONE_JOINT)
    for folder in ("a/new", "b/new"):
        start(tmp_path / folder, model)
    name = (tmp_path / "a").as_posix().encode(), (tmp_path / "b").as_posix().encode()
    a, b = contents(tmp_path / "a"), contents(tmp_path / "b")
    assert a == {file: text.replace(name[1], name[0]) for file, text in b.items()}


BLOCK = re.compile(r"(?:^# (?:[a-z_]+ = |\[|  \[|\]).*\n)+", re.MULTILINE)
"""Lines of a template that are commented out, without prose."""


@pytest.mark.parametrize(
    ("file", "schema", "blocks"), [("robot.toml", RobotDescription, 8), ("study.toml", Study, 4)]
)
def test_every_commented_out_option_is_valid(
    tmp_path: Path, file: str, schema: type[RobotDescription] | type[Study], blocks: int
) -> None:
    model = model_file(tmp_path, MANY_JOINTS)
    start(tmp_path / "new", model, ["turn", "left"])
    path = tmp_path / "new" / file
    text = path.read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    assert len(found) == blocks
    for block in found:
        used = re.sub(r"^# ", "", block.group(), flags=re.MULTILINE)
        rest = text[: block.start()]
        if tomllib.loads(used).keys() == {"laws"}:  # an alternative to the given choice
            rest = re.sub(r"^laws = .*\n", "", rest, flags=re.MULTILINE)
        path.write_text(rest + used + text[block.end() :], encoding="utf-8")
        read = schema.read(path)
        if isinstance(read, RobotDescription):
            Robot(read)


def test_all_kinds_of_joints_are_supported(tmp_path: Path, hesr: Hesr) -> None:
    model = model_file(tmp_path, MANY_JOINTS)
    answer = hesr("new", tmp_path / "all", "--robot", model)
    assert (answer.code, answer.err) == (0, "")
    assert "a study of the joints turn, slide, left.\n" in answer.out
    assert "Followers of other joints: right.\n" in answer.out
    assert "Locked" not in answer.out
    description = RobotDescription.read(tmp_path / "all" / "robot.toml")
    log = Log.read(tmp_path / "all" / "logs" / "sample_training.csv", description)
    robot = Robot(description)
    lower, upper, speed = robot.limits
    assert log.dq is not None
    assert np.all(log.q > lower)
    assert np.all(log.q < upper)
    assert np.all(np.abs(log.dq).max(axis=0) < 1.01 * speed)
    # The rigid body is identified again, so the residual is friction.
    body = identify([log], robot)
    still = np.zeros((1, 3))
    q = np.array([[0.3, 0.2, 0.5]])
    truth = robot.torque(robot.nominal_parameters, q, still, still)
    np.testing.assert_allclose(robot.torque(body.parameters, q, still, still), truth, atol=0.5)
    assert np.abs(truth).max() > 20.0

    answer = hesr("new", tmp_path / "two", "--robot", model, "--joints", "turn, left")
    locked = "slide = 0; --joints selects other"
    assert answer.out == Containing("Followers of other joints: right.\n", locked)
    assert RobotDescription.read(tmp_path / "two" / "robot.toml").joints == ("turn", "left")
    assert '[locked]\n"slide" = 0.0\n\n[log]' in (tmp_path / "two" / "robot.toml").read_text()
    assert "--joints A,B,.." in (tmp_path / "two" / "README.txt").read_text()


def test_fingers_are_proposed_as_locked(tmp_path: Path, hesr: Hesr) -> None:
    text = MANY_JOINTS.replace('type="revolute"', 'type="prismatic"').replace('"0.9"', '"0.04"')
    text = text.replace('lower="0" upper="0.04"', 'lower="0.01" upper="0.04"')
    model = model_file(tmp_path, text)
    answer = hesr("new", tmp_path / "all", "--robot", model)
    assert (answer.code, answer.err) == (0, "")
    assert "a study of the joints turn, slide.\n" in answer.out
    assert "left = 0.01; --joints selects other" in answer.out
    assert RobotDescription.read(tmp_path / "all" / "robot.toml").locked == {"left": 0.01}
    assert to_description(model).joints == ("turn", "slide")
    answer = hesr("new", tmp_path / "own", "--robot", model, "--joints", "turn,slide,left")
    assert "Locked" not in answer.out


def branch(side: str, joints: int, parent: str) -> str:
    """A chain of joints that ends in a gripper with one jaw, which cannot close to 0."""
    text = ""
    for k in range(1, joints + 1):
        name = f"{side}{k}" if k < joints else f"{side}_gripper"
        text += f"""<link name="{name}_link">{LINK}</link><joint name="{name}" type="revolute">
            <parent link="{parent}"/><child link="{name}_link"/><axis xyz="0 1 0"/>
            <limit lower="0.1" upper="0.9" effort="1" velocity="1"/></joint>"""
        parent = f"{name}_link"
    return text


def test_one_arm_is_proposed(tmp_path: Path, hesr: Hesr) -> None:
    """Wheels, the second arm and grippers rest within their limits; the torso moves."""
    wheel = JOINT.format(name="wheel", parent="base")
    torso = JOINT.format(name="torso", parent="base")
    arms = branch("left", 4, "torso_link") + branch("right", 4, "torso_link")
    robot = f'<robot name="two"><link name="base"/>{wheel}{torso}{arms}</robot>'
    model = model_file(tmp_path, robot)
    answer = hesr("new", tmp_path / "new", "--robot", model)
    assert (answer.code, answer.err) == (0, "")
    assert "a study of the joints torso, left1, left2, left3.\n" in answer.out
    places = "left_gripper = 0.1, right1 = 0.1, right2 = 0.1, right3 = 0.1, right_gripper = 0.1"
    assert f"Locked [rad or m]: {places} and 1 more; --joints selects" in answer.out
    found = RobotDescription.read(tmp_path / "new" / "robot.toml")
    assert (len(found.locked), found.locked["wheel"]) == (6, 0.0)


def test_doubts_about_the_model_are_printed(tmp_path: Path, hesr: Hesr) -> None:
    model = model_file(tmp_path, ONE_JOINT.replace('upper="1.5"', 'upper="150"'))
    answer = hesr("new", tmp_path / "new", "--robot", model)
    copy = tmp_path / "new" / "arm.urdf"
    doubt = "'pitch': its limits -1.5 and 150"
    assert doubt in answer.out, answer.out
    assert not copy.with_name("MUJOCO_LOG.TXT").exists()


def test_an_mjcf_and_an_odd_folder_name_are_accepted(tmp_path: Path) -> None:
    start(tmp_path / "-my arm é", uf850("uf850.xml"))
    study = Study.read(tmp_path / "-my arm é" / "study.toml")
    assert study.name == "my_arm_"
    assert RobotDescription.read(study.robot).joints == ("joint1", "joint2", "joint3")


@pytest.mark.parametrize(
    ("path", "joints"),
    [
        (UR10E / "ur10e.urdf", ("shoulder_pan_joint", "wrist_3_joint")),
        (ROBOTS / "robots" / "uf850.urdf", ("joint1", "joint6")),
    ],
    ids=["UR10e", "UFACTORY 850"],
)
def test_public_arm_models_are_accepted(
    tmp_path: Path, path: Path, joints: tuple[str, str]
) -> None:
    if not path.is_file():
        pytest.skip(f"the model is not next to the repository, at {path}")
    made = start(tmp_path / "new", path)
    assert (made.joints[0], made.joints[-1], len(made.joints)) == (*joints, 6)
    description = RobotDescription.read(tmp_path / "new" / "robot.toml")
    for log in Study.read(tmp_path / "new" / "study.toml").logs.identification:
        assert Log.read(tmp_path / "new" / log, description).q.shape == (4001, 6)


ERRORS = [
    ("arm.urdf", ONE_JOINT, ["lift"], r"arm\.urdf: has no joint 'lift'; it has pitch\.$"),
    (
        "arm.urdf",
        MANY_JOINTS,
        ["right"],
        r"arm\.urdf: joint 'right' follows another \(mimic\)",
    ),
    (
        "ball.xml",
        BALL,
        ["ball"],
        r"ball\.xml: joint 'ball' has several degrees",
    ),
    (
        "ball.xml",
        BALL,
        [],
        r"ball\.xml: has no revolute or prismatic",
    ),
    ("arm.urdf", "<robot", [], r"arm\.urdf: cannot be parsed as a URDF \(.+\)\.$"),
    (
        "arm.urdf.xacro",
        ONE_JOINT,
        [],
        r"first: xacro arm\.urdf\.xacro > arm\.urdf",
    ),
]


def test_a_slow_joint_has_sample_logs_that_identify_it(tmp_path: Path) -> None:
    slow = ONE_JOINT.replace('velocity="2"', 'velocity="0.0005"')
    start(tmp_path / "new", model_file(tmp_path, slow), [])
    robot = Robot(tmp_path / "new" / "robot.toml")
    log = Log.read(tmp_path / "new" / "logs" / "sample_training.csv", robot.description)
    assert 0.0 < np.max(np.abs(log.dq)) < 0.0005
    assert not examine([log], robot.description, robot).findings
    assert identify([log], robot).parameters.size


def test_friction_of_sample_logs_is_plausible(arm_model: Robot) -> None:
    (motion,) = random_motions(arm_model, sample_settings(arm_model), 1, 0)
    q, dq, ddq = motion.sample(np.arange(0.0, 20.0, 0.005))
    torque = np.abs(arm_model.torque(arm_model.nominal_parameters, q, dq, ddq)).max(axis=0)
    for law, largest, speed, travel in zip(
        plausible_friction(arm_model, motion),
        np.maximum(torque, torque.max() / 20.0),
        np.abs(dq).max(axis=0),
        np.ptp(q, axis=0),
        strict=True,
    ):
        values = law.values
        assert values["F_c"] == pytest.approx(0.15 * largest)
        assert values["F_s"] == pytest.approx(1.3 * values["F_c"])
        # At the largest speed viscous friction is that of Coulomb.
        assert values["sigma_2"] * speed == pytest.approx(values["F_c"])
        assert values["v_s"] == pytest.approx(0.05 * speed)
        assert values["F_c"] / values["sigma_0"] == pytest.approx(1e-3 * travel)


# The hand of Baxter's arm: a fixed joint and the link it holds have one name.
FIXED_NAME = ONE_JOINT.replace(
    "</robot>",
    """<joint name="hand" type="fixed"><parent link="arm"/><child link="hand"/></joint>
    <link name="hand"/>
    <joint name="grip" type="revolute"><parent link="hand"/><child link="finger"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
    <link name="finger"/></robot>""",
)


def test_a_link_named_as_its_fixed_joint_can_be_locked(tmp_path: Path) -> None:
    project = start(tmp_path / "new", model_file(tmp_path, FIXED_NAME), ["pitch"])
    assert dict(project.locked) == {"grip": 0.0}


@pytest.mark.parametrize(("name", "text", "joints", "message"), ERRORS)
def test_an_unusable_robot_leaves_no_files(
    tmp_path: Path, name: str, text: str, joints: list[str], message: str
) -> None:
    model = model_file(tmp_path, text, name)
    with pytest.raises(RobotError, match=message):
        start(tmp_path / "new", model, joints)
    assert set(contents(tmp_path)) == {name}
    assert not (tmp_path / "new").exists()


def test_a_non_empty_folder_is_left_alone(tmp_path: Path, hesr: Hesr) -> None:
    model = model_file(tmp_path, ONE_JOINT)
    with pytest.raises(RobotError, match=r"none\.urdf: no such model file\.$"):
        start(tmp_path / "new", tmp_path / "none.urdf")
    before = contents(tmp_path)
    with pytest.raises(ConfigError, match="not empty"):
        start(tmp_path, model)
    with pytest.raises(ConfigError, match=r"arm\.urdf: is a file"):
        start(model, model)
    answer = hesr("new", tmp_path, "--robot", model)
    assert answer.code == 2
    assert answer.err == OneSentence(f"hesr: {tmp_path}: is not empty")
    assert contents(tmp_path) == before


@pytest.mark.parametrize("count", [1, 2])
def test_only_unchanged_sample_logs_count_as_samples(tmp_path: Path, count: int) -> None:
    files = [tmp_path / f"{k}.csv" for k in range(count)]
    own = tmp_path / "own.csv"
    for file in (*files, own):
        file.write_text(f"log {file.name}", encoding="utf-8")
    assert not is_sample(files[0])
    mark_samples(files)
    assert [is_sample(file) for file in (*files, own)] == [True] * count + [False]
    files[0].write_text("replaced", encoding="utf-8")
    assert not is_sample(files[0])


def test_files_that_an_mjcf_includes_come_with_it(tmp_path: Path) -> None:
    inertial = '<inertial pos="0 0 0.1" mass="{}" diaginertia="0.1 0.1 0.1"/>'
    hinge = '<joint name="{}" axis="0 1 0" range="-1 1"/>'
    parts = tmp_path / "given" / "parts"
    parts.mkdir(parents=True)
    tip = f'<body name="tip">{hinge.format("b")}{inertial.format(3)}</body>'
    (parts / "tip.xml").write_text(f"<mujoco>{tip}</mujoco>", encoding="utf-8")
    defaults = '<default><joint armature="0.2"/></default><include file="parts/step.xml"/>'
    (parts / "defaults.xml").write_text(f"<mujoco>{defaults}</mujoco>", encoding="utf-8")
    (parts / "step.xml").write_text('<mujoco><option timestep="0.001"/></mujoco>', encoding="utf-8")
    body = f'<body>{hinge.format("a")}{inertial.format(2)}<include file="parts/tip.xml"/></body>'
    model = model_file(
        parts.parent,
        '<mujoco><compiler angle="radian"/><include file="parts/defaults.xml"/>'
        f"<worldbody>{body}</worldbody></mujoco>",
        "arm.xml",
    )
    start(tmp_path / "new", model)
    expected, found = Robot(model), Robot(tmp_path / "new" / "robot.toml")
    assert found.joints == expected.joints == ("a", "b")
    np.testing.assert_array_equal(found.nominal_parameters, expected.nominal_parameters)
    np.testing.assert_array_equal(found.rotor_nominal, [0.2, 0.2])


def test_springs_of_an_mjcf_are_listed(tmp_path: Path, hesr: Hesr, arm: RobotDescription) -> None:
    text = arm.model.read_text(encoding="utf-8")
    spring = text.replace('<joint name="j2"', '<joint name="j2" stiffness="40" springref="0.3"')
    arm.model.write_text(spring, encoding="utf-8")
    answer = hesr("new", tmp_path / "own", "--robot", arm.model)
    assert (answer.code, answer.err) == (0, "")
    robot = Robot(RobotDescription.read(tmp_path / "own" / "robot.toml"))
    assert [term.joint for term in robot.springs] == [1, 1]
    np.testing.assert_allclose(robot.nominal_parameters[robot.inertial :], [40.0, -12.0])


def box(x: float, y: float, z: float) -> str:
    """Return a box as a mesh, whose mass MuJoCo computes."""
    corners = [(i, j, k) for i in (-x, x) for j in (-y, y) for k in (-z, z)]
    faces = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {i} {j} {k}" for i, j, k in corners] + [f"f {face}" for face in faces]
    return "\n".join(lines)


MESHES = """<mujoco><compiler meshdir="assets"/><include file="parts.xml"/><worldbody>
<body name="a"><joint name="j1" axis="0 1 0" range="-2 2" limited="true"/>
<geom type="mesh" mesh="link" pos="0 0 .2" density="1000"/>
<body name="b" pos="0 0 .4"><joint name="j2" axis="0 1 0" range="-2 2" limited="true"/>
<geom type="mesh" mesh="tip" pos="0 0 .1" density="500"/></body></body></worldbody></mujoco>"""
PARTS = """<mujoco><asset><mesh file="one/link.obj"/><mesh name="tip" file="two/link.obj"/>
<mesh name="cover" file="two/cover.obj"/></asset></mujoco>"""


def test_meshes_of_masses_are_part_of_a_project(tmp_path: Path) -> None:
    """Two have the same name; that of the appearance is missing and not needed."""
    model = model_file(tmp_path, MESHES, "arm.xml")
    model_file(tmp_path, PARTS, "parts.xml")
    for name, sizes in (("one", (0.05, 0.04, 0.2)), ("two", (0.02, 0.03, 0.1))):
        (tmp_path / "assets" / name).mkdir(parents=True)
        model_file(tmp_path / "assets" / name, box(*sizes), "link.obj")
    expected = Robot(model).nominal_parameters
    project = start(tmp_path / "project", model)
    (tmp_path / "assets").rename(tmp_path / "gone")
    copy = Robot(project.folder / "robot.toml")
    assert copy.joints == ("j1", "j2")
    np.testing.assert_allclose(copy.nominal_parameters[:20], expected[:20])
    assert expected[0] == pytest.approx(8 * 0.05 * 0.04 * 0.2 * 1000)


def test_a_missing_mesh_is_named_with_the_folder_of_the_model(tmp_path: Path) -> None:
    model = model_file(tmp_path, MESHES, "arm.xml")
    model_file(tmp_path, PARTS, "parts.xml")
    with pytest.raises(RobotError, match="inertia of body") as caught:
        start(tmp_path / "project", model)
    assert str(tmp_path / "assets") in str(caught.value)
    assert not (tmp_path / "project").exists()
