import sys
from pathlib import Path

import cloudpickle
import numpy as np
import pinocchio as pin
import pytest

from hesr_model.errors import ConfigError, RobotError
from hesr_model.logs.log_format import LogFormat, LogUnits
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

ARM_TOML = """
name = "arm"
model = "arm.xml"
joints = ["j1", "j2", "j3"]
"""

# The last joint has no limits; the first is a sliding joint.
LIFT_URDF = """
<robot name="lift">
  <link name="base"/>
  <joint name="lift" type="prismatic">
    <parent link="base"/><child link="column"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.35" effort="2000" velocity="0.07"/>
  </joint>
  <link name="column">
    <inertial><origin xyz="0 0 0.1"/><mass value="10"/>
      <inertia ixx="0.3" iyy="0.3" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="arm" type="continuous">
    <parent link="column"/><child link="forearm"/><origin xyz="0.2 0 0" rpy="0 0.5 0"/>
    <axis xyz="0 0 1"/>
  </joint>
  <link name="forearm">
    <inertial><origin xyz="0.2 0.05 0"/><mass value="2"/>
      <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""

FREE_MJCF = """
<mujoco><worldbody><body name="ball"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
<freejoint name="free"/></body></worldbody></mujoco>
"""

FREE_MJCF_ARM = """
<body name="arm"><inertial pos="0.1 0 0" mass="1" diaginertia="1 1 1"/>
<joint name="hinge" axis="0 0 1"/></body>
"""


@pytest.fixture
def states() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, dq, ddq = np.random.default_rng(1).uniform(-1.5, 1.5, (3, 20, 3))
    return q, dq, ddq


def describe(folder: Path, text: str, more: str = "") -> Path:
    path = folder / "robot.toml"
    path.write_text(text + more, encoding="utf-8")
    return path


def test_regressor_times_parameters_is_the_library_torque(
    arm: RobotDescription, arm_model: Robot, states: tuple[np.ndarray, ...]
) -> None:
    # The library's rnea includes the armature of the MJCF; here it is a column of the regressor.
    reference = pin.buildModelFromMJCF(str(arm.model))
    data = reference.createData()
    expected = np.array([pin.rnea(reference, data, *state) for state in zip(*states, strict=True)])
    torque = arm_model.torque(arm_model.nominal_parameters, *states)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-12)
    regressor = arm_model.regressor(*states)
    assert regressor.shape == (20, 3, 33)
    np.testing.assert_array_equal(regressor @ arm_model.nominal_parameters, torque)


def test_parameters_are_named_link_by_link_then_rotor_by_rotor(arm_model: Robot) -> None:
    names = dict(zip(arm_model.parameter_names, arm_model.nominal_parameters, strict=True))
    assert list(names)[:4] == ["j1.m", "j1.mx", "j1.my", "j1.mz"]
    assert list(names)[-3:] == ["j1.Ir", "j2.Ir", "j3.Ir"]
    assert names["j1.m"] == pytest.approx(4.0)
    assert names["j2.mx"] == pytest.approx(2.5 * 0.15)
    assert names["j3.Ixx"] == pytest.approx(0.01 + 1.2 * (0.02**2 + 0.03**2))
    assert names["j1.Ir"] == pytest.approx(0.4)


def test_without_rotors_the_model_has_ten_parameters_per_link(
    arm: RobotDescription, states: tuple[np.ndarray, ...]
) -> None:
    model = Robot(arm.model_copy(update={"rotor_inertia": False}))
    assert model.nominal_parameters.shape == (30,)
    assert model.regressor(*states).shape == (20, 3, 30)


def test_gravity_comes_from_the_description(arm: RobotDescription) -> None:
    still = np.zeros((1, 3))
    q = np.array([[0.1, 0.4, -0.2]])
    down = Robot(arm)
    away = Robot(arm.model_copy(update={"gravity": (0.0, 0.0, 0.0)}))
    assert np.abs(down.torque(down.nominal_parameters, q, still, still)).max() > 1.0
    np.testing.assert_array_equal(away.torque(away.nominal_parameters, q, still, still), still)


def test_unlisted_joints_are_locked_at_the_given_positions(
    arm: RobotDescription, arm_model: Robot
) -> None:
    locked = arm.model_copy(update={"joints": ("j1", "j3"), "locked": {"j2": 0.7}})
    model = Robot(locked)
    q = np.array([[0.3, 0.7, -0.5]])
    zero = np.zeros((1, 3))
    whole = arm_model.torque(arm_model.nominal_parameters, q, zero, zero)
    part = model.torque(model.nominal_parameters, q[:, [0, 2]], zero[:, :2], zero[:, :2])
    np.testing.assert_allclose(part, whole[:, [0, 2]], atol=1e-12)


def test_a_sliding_and_an_unlimited_joint(tmp_path: Path) -> None:
    path = tmp_path / "lift.urdf"
    path.write_text(LIFT_URDF, encoding="utf-8")
    model = Robot(RobotDescription(name="lift", model=path, joints=("lift", "arm")))
    q, dq, ddq = np.array([[0.2, 2.0]]), np.array([[0.0, 0.0]]), np.array([[1.0, 0.0]])
    torque = model.torque(model.nominal_parameters, q, dq, ddq)
    assert torque[0, 0] == pytest.approx(12.0 * (9.81 + 1.0))
    lower, upper, speed = model.limits
    np.testing.assert_allclose(
        [lower, upper, speed], [[0, -np.inf], [0.35, np.inf], [0.07, np.inf]]
    )
    lift, arm = model.tree
    assert (lift.prismatic, lift.parent, arm.prismatic, arm.parent) == (True, -1, False, 0)
    np.testing.assert_allclose(lift.translation, [0, 0, 0.5])
    np.testing.assert_allclose(arm.rotation @ [0, 0, 1], [np.sin(0.5), 0, np.cos(0.5)])


@pytest.mark.parametrize(
    ("units", "message"),
    [
        (
            LogUnits(q="deg"),
            r"'log\.units\.q' is 'deg' for joint 'lift'",
        ),
        (
            LogUnits(dq=("mm/s", "mm/s")),
            r"'log\.units\.dq' is 'mm/s' for joint 'arm'",
        ),
    ],
)
def test_units_must_match_the_kind_of_joint(tmp_path: Path, units: LogUnits, message: str) -> None:
    path = tmp_path / "lift.urdf"
    path.write_text(LIFT_URDF, encoding="utf-8")
    lift = RobotDescription(name="lift", model=path, joints=("lift", "arm"))
    Robot(lift.model_copy(update={"log": LogFormat(units=LogUnits(q=("mm", "deg")))}))
    with pytest.raises(RobotError, match=message):
        Robot(lift.model_copy(update={"log": LogFormat(units=units)}))


def test_the_tree_places_the_joints(arm_model: Robot) -> None:
    j1, j2, j3 = arm_model.tree
    assert [j1.parent, j2.parent, j3.parent] == [-1, 0, 1]
    np.testing.assert_allclose(j3.translation, [0.3, 0, 0.05])
    np.testing.assert_allclose(j3.axis, np.array([0, 1, 0.3]) / np.hypot(1, 0.3))


def test_a_description_is_read_and_finds_its_model(tmp_path: Path, arm: RobotDescription) -> None:
    path = describe(tmp_path, ARM_TOML, "[log]\ntorque_per_ampere = [1, 2, 3]\n")
    description = RobotDescription.read(path)
    assert description.model == arm.model.resolve()
    assert description.log.torque_per_ampere == (1.0, 2.0, 3.0)
    assert Robot(description).n == 3


def test_one_torque_constant_is_that_of_all_joints(tmp_path: Path) -> None:
    path = describe(tmp_path, ARM_TOML, "[log]\ntorque_per_ampere = 0.2\n")
    assert RobotDescription.read(path).log.torque_per_ampere == (0.2, 0.2, 0.2)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            "[log]\ntorque_per_ampere = [1, 2]\n",
            "'log.torque_per_ampere' of robot 'arm' has 2",
        ),
        (
            "[log.columns]\nq = ['a', 'b']\n",
            "'log.columns.q' of robot 'arm' has 2",
        ),
        (
            "[log.units]\nq = ['deg', 'deg']\n",
            "'log.units.q' of robot 'arm' has 2",
        ),
        (
            "[log.bag]\njoints = ['a', 'b']\n",
            "'log.bag.joints' of robot 'arm' has 2",
        ),
    ],
)
def test_one_entry_per_joint_is_needed(tmp_path: Path, more: str, message: str) -> None:
    with pytest.raises(RobotError, match=r"robot\.toml: .*" + message):
        RobotDescription.read(describe(tmp_path, ARM_TOML, more))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            "[log.units]\nq = 'grad'\n",
            r"key 'log\.units\.q' is 'grad': known units are 'rad', 'deg', 'rev', 'm', 'mm'\.$",
        ),
        (
            "[log.units]\nt = 'min'\n",
            r"key 'log\.units\.t' is 'min': known units are 's', 'ms', 'us', 'ns'\.$",
        ),
        (
            "[log.units]\ntau = ['N.m', 'kgf.m', 'N.m']\n",
            r"key 'log\.units\.tau' is .*'kgf\.m'.*: known units are 'N\.m', 'mN\.m', 'N'\.$",
        ),
        ("[log]\nfilter_cutoff = 0\n", r"key 'log\.filter_cutoff' is 0: .*greater than 0"),
        (
            "[log.columns]\nq = 'q'\n",
            r"key 'log\.columns\.q' is 'q': the pattern",
        ),
        (
            "[log.columns]\nq = 'q{}_{name}'\n",
            r"key 'log\.columns\.q' is 'q\{\}_\{name\}': the pattern needs '\{\}' \(joint",
        ),
        ("rotor = true\n", r"unknown key 'rotor'; did you mean 'root'"),
    ],
)
def test_a_wrong_key_is_named(tmp_path: Path, more: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"robot\.toml: .*" + message):
        RobotDescription.read(describe(tmp_path, ARM_TOML, more))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joints": ("j1", "j4")}, r"arm\.xml: has no joint 'j4'; it has j1, j2, j3\.$"),
        ({"locked": {"wrist": 0.0}}, r"arm\.xml: has no joint 'wrist'; it has j1, j2, j3\.$"),
        ({"locked": {"j3": 0.0}}, "joint 'j3' is in both 'joints'"),
        ({"joints": ("j2", "j1")}, "joints j2, j1 must be listed"),
        ({"joints": ("j1", "j1")}, "joints j1, j1 must be listed"),
    ],
)
def test_joints_that_do_not_match_the_model_are_named(
    arm: RobotDescription, change: dict[str, object], message: str
) -> None:
    with pytest.raises(RobotError, match=message):
        Robot(arm.model_copy(update=change))


def test_gains_are_checked_for_a_description_made_in_code(arm: RobotDescription) -> None:
    log = arm.log.model_copy(update={"torque_per_ampere": (1.0,)})
    with pytest.raises(RobotError, match=r"^key 'log\.torque_per_ampere' of robot 'arm' has 1"):
        Robot(arm.model_copy(update={"log": log}))


def test_a_missing_or_broken_model_file_is_named(arm: RobotDescription, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"none\.urdf: no such model file\.$"):
        Robot(arm.model_copy(update={"model": tmp_path / "none.urdf"}))
    for name, kind in (("broken.urdf", "parsed as a URDF"), ("broken.xml", "parsed as an MJCF")):
        path = tmp_path / name
        path.write_text("<robot><link", encoding="utf-8")
        with pytest.raises(RobotError, match=rf"{name}: cannot be {kind} \(.+\)\.$"):
            Robot(arm.model_copy(update={"model": path}))


LIFT = """<mujoco model="lift">{compiler}<worldbody><body name="carriage">
  <joint name="z" type="slide" axis="0 0 1" range="-0.5 1.5"/>
  <inertial mass="2" pos="0 0 0" diaginertia="1e-3 1e-3 1e-3"/>
  <body name="arm"><joint name="a" axis="0 0 1" range="{range}"/>
  <inertial mass="1" pos="0.1 0 0" diaginertia="1e-3 1e-3 1e-3"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("compiler", "range_"),
    [("", "-90 90"), ('<compiler angle="radian"/>', "-1.5707963267948966 1.5707963267948966")],
)
def test_the_range_of_a_sliding_joint_is_a_length(
    compiler: str, range_: str, tmp_path: Path
) -> None:
    path = tmp_path / "lift.xml"
    path.write_text(LIFT.format(compiler=compiler, range=range_), encoding="utf-8")
    robot = Robot(RobotDescription(name="lift", model=path, joints=("z", "a")))
    lower, upper, _ = robot.limits
    np.testing.assert_allclose(lower, [-0.5, -np.pi / 2])
    np.testing.assert_allclose(upper, [1.5, np.pi / 2])


def test_a_joint_of_many_degrees_of_freedom_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "free.xml"
    path.write_text(FREE_MJCF, encoding="utf-8")
    description = RobotDescription(name="ball", model=path, joints=("free",))
    with pytest.raises(RobotError, match="joint 'free' has several degrees"):
        Robot(description)
    path.write_text(FREE_MJCF.replace("</body>", FREE_MJCF_ARM + "</body>"), encoding="utf-8")
    description = RobotDescription(name="ball", model=path, joints=("hinge",), locked={"free": 1})
    with pytest.raises(RobotError, match="joint 'free' has several degrees"):
        Robot(description)


def test_a_robot_goes_to_worker_processes() -> None:
    robot = Robot(models_folder() / "uf850" / "robot.toml")
    copy = cloudpickle.loads(cloudpickle.dumps(robot))
    q = np.array([[0.1, -0.5, 0.4]])
    expected = robot.torque(robot.nominal_parameters, q, q, q)
    np.testing.assert_array_equal(copy.torque(copy.nominal_parameters, q, q, q), expected)
    assert [list(limit) for limit in copy.limits] == [list(limit) for limit in robot.limits]


def test_a_missing_library_of_pinocchio_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(
        RobotError, match=r"Pinocchio \(package 'pin'\) cannot be loaded: .*libgomp1"
    ):
        Robot(models_folder() / "uf850" / "robot.toml")
