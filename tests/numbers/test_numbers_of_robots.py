"""Robots from files: joint positions, limits, torques, motors and refusals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError
from pytest_regressions.data_regression import DataRegressionFixture
from unchanged import Unchanged

from hesr_model.errors import ArtifactError, ConfigError, RobotError
from hesr_model.logs.log_format import LogFormat, LogUnits, column_names
from hesr_model.robots.model_file import driven_joints, joints_of
from hesr_model.robots.robot import Robot, RobotDescription, description_of
from hesr_model.robots.transmission import Coupling, Transmission, onto

LINK = '<link name="l{k}"><inertial><origin xyz="0.1 0.02 {k}"/><mass value="{k}"/>'
LINK += '<inertia ixx="0.3" iyy="0.2" izz="0.1" ixy="0.01" ixz="0.02" iyz="0"/></inertial></link>'
JOINTS = (
    '<joint name="turn" type="revolute">{ends}<origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>'
    '<axis xyz="0 0 1"/><limit lower="-1.5" upper="2" effort="40" velocity="1.2"/></joint>',
    '<joint name="free" type="continuous">{ends}<axis xyz="0 1 0"/></joint>',
    '<joint name="slide" type="prismatic">{ends}<origin xyz="0 0.2 0"/><axis xyz="1 0 0"/>'
    '<limit lower="-0.1" upper="0.4" effort="0" velocity="0"/></joint>',
    '<joint name="last" type="revolute">{ends}<axis xyz="0.6 0 0.8"/>'
    '<limit lower="0" upper="0" effort="7" velocity="0.4"/></joint>',
    '<joint name="follower" type="revolute">{ends}<axis xyz="1 0 0"/><mimic joint="turn"/>'
    '<limit lower="-1" upper="1" effort="7" velocity="0.4"/></joint>',
    '<joint name="plane" type="planar">{ends}<axis xyz="0 0 1"/></joint>',
)
NAMES = ("turn", "free", "slide", "last")
MATRIX = ((50.0, 0.0, 0.0), (0.0, -80.0, 0.0), (0.0, 40.0, 40.0))
MJCF = """
<mujoco model="lift"><compiler {angle}/><worldbody><body name="a">
  <inertial pos="0 0 0.1" mass="2" diaginertia="0.02 0.03 0.02"/>
  <joint name="turn" axis="0 1 0" range="-0.5 0.75"/>
  <body name="b"><inertial pos="0 0 0.1" mass="1" diaginertia="0.02 0.03 0.02"/>
    <joint name="lift" type="slide" axis="0 0 1" range="-0.5 1.5" armature="0.3"/></body>
</body></worldbody></mujoco>
"""


@pytest.fixture
def model_file(tmp_path: Path) -> Path:
    parts = ['<link name="l0"/>']
    for k, joint in enumerate(JOINTS):
        ends = f'<parent link="l{k}"/><child link="l{k + 1}"/>'
        parts += [joint.format(ends=ends), LINK.format(k=k + 1)]
    path = tmp_path / "odd.urdf"
    path.write_text(f'<robot name="odd">{"".join(parts)}</robot>', encoding="utf-8")
    return path


def refusal(make: Callable[[], object], path: Path | None = None) -> str:
    try:
        made = make()
    except ValidationError as error:
        return error.errors()[0]["msg"]
    except (ConfigError, RobotError, ArtifactError) as error:
        return str(error).replace(f"{path.parent}/", "") if path else str(error)
    return f"none: {made}" if isinstance(made, tuple) else "none"


def four(path: Path, **more: object) -> RobotDescription:
    return RobotDescription.model_validate(
        {"name": "odd", "model": path, "joints": NAMES, "locked": {}} | more
    )


def test_a_robot_with_all_kinds_of_joints(model_file: Path, unchanged: Unchanged) -> None:
    path = model_file
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('type="planar"', 'type="fixed"'), encoding="utf-8")
    model = Robot(four(path))
    locked = Robot(
        four(path, joints=("turn", "last"), locked={"free": 0.7, "slide": 0.2}, rotor_inertia=False)
    )
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, 5, 4))
    nominal = model.nominal_parameters
    each = nominal * (1.0 + 0.1 * rng.normal(size=(5, len(nominal))))
    long = rng.normal(size=(3, 8200, 4))
    with model.under_gravity() as set_gravity:
        set_gravity((1.0, 2.0, 3.0))
        elsewhere = model.torque(nominal, q, dq, ddq)
    unchanged(
        {
            "limits": model.limits,
            "torque limits": model.torque_limits,
            "tree": model.tree,
            "parents": [joint.parent for joint in model.tree],
            "kinds": [joint.prismatic for joint in model.tree],
            "nominal": nominal,
            "regressor": model.regressor(q, dq, ddq)[:1],
            "torque": model.torque(nominal, q, dq, ddq),
            "each its own": model.torque(each, q, dq, ddq),
            "none": len(model.torque(nominal, q[:0], dq[:0], ddq[:0])),
            "many": model.torque(nominal, *long)[[0, 4095, 4096, 8191, 8192, 8199]],
            "dynamics": model.dynamics(nominal, q, dq),
            "dynamics, each": model.dynamics(each, q, dq),
            "elsewhere": elsewhere,
            "back": model.torque(nominal, q, dq, ddq),
            "locked": locked.torque(locked.nominal_parameters, q[:, :2], dq[:, :2], ddq[:, :2]),
            "locked limits": locked.limits,
        },
        rtol=1e-7,
    )


@pytest.mark.parametrize("angle", ["", 'angle="degree"', 'angle="radian"'])
def test_ranges_of_an_mjcf(tmp_path: Path, angle: str, unchanged: Unchanged) -> None:
    path = tmp_path / "lift.xml"
    path.write_text(MJCF.format(angle=angle), encoding="utf-8")
    model = Robot(path)
    unchanged(
        {
            "limits": model.limits,
            "rotors": model.rotor_nominal,
            "sides": [joint.slides for joint in joints_of(path)],
        },
        rtol=1e-9,
    )


def test_coupled_motors(arm: RobotDescription, unchanged: Unchanged) -> None:
    transmission = Transmission(matrix=MATRIX, logs="motor", friction=("motor", "motor", "joint"))
    model = Robot(RobotDescription(**{**dict(arm), "transmission": transmission}))
    coupling = Coupling.of(transmission.motors)
    assert coupling
    assert Coupling.of(transmission.coordinates) is None
    assert Coupling.of(np.eye(2)) is None
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 4, 3))
    regressor = model.regressor(q, dq, ddq)
    unchanged(
        {
            "ratios": [transmission.ratios, model.description.gear_ratio],
            "matrices": [transmission.motors, transmission.coordinates],
            "coupling": [coupling.forward, coupling.backward],
            "motion": coupling.motion(q),
            "torque": coupling.torque(q),
            "torque of a regressor": coupling.torque(regressor),
            "at joints": coupling.at_joints(q),
            "onto": [onto(coupling, q), onto(None, q)],
            "rotors": regressor[:, :, 30:],
        }
    )


def test_refused_robots(
    model_file: Path, arm: RobotDescription, data_regression: DataRegressionFixture
) -> None:
    path = model_file

    def robot(**more: object) -> str:
        return refusal(lambda: Robot(four(path, **more)), path)

    def toml(matrix: str) -> str:
        (file := path.with_name("robot.toml")).write_text(
            f'name = "x"\nmodel = "odd.urdf"\njoints = ["turn"]\n[transmission]\nmatrix = {matrix}',
            encoding="utf-8",
        )
        return refusal(lambda: RobotDescription.read(file), path)

    def nearly(x: float) -> tuple[tuple[float, float], ...]:
        return ((1.0, 1.0), (1.0, 1.0 + x))

    def units(*sliding: bool, **given: object) -> str:
        own = LogUnits.model_validate(given)
        return refusal(lambda: own.require_fitting("ab", sliding))

    joints = [str(x) for x in joints_of(path)]
    data_regression.check(
        {
            "joints": joints,
            "driven": [
                refusal(lambda w=w: driven_joints(path, w), path)
                for w in ((), ("last", "turn"), ("nobody",), ("follower",), ("plane",))
            ],
            "robots": [
                robot(), robot(joints=("turn", "turn")), robot(joints=("slide", "free")),
                robot(joints=("turn", "plane")), robot(locked={"turn": 1.0}),
                robot(locked={"nobody": 1.0}), robot(locked={"plane": 1.0}),
                robot(gear_ratio=(1.0, 2.0)), robot(gear_ratio=(1.0, 0.0, 1.0, 1.0)),
                robot(gear_ratio=(1.0, 0.1, 1.0, 1.0)), robot(joints=()),
                robot(log={"zero": (1.0,)}), robot(log={"units": {"q": ("rad", "mm")}}),
                robot(log={"units": {"q": "mm"}}), robot(log={"columns": {"tau": ("a", "b")}}),
            ],
            "matrices": [toml(m) for m in (
                "[]", "[[]]", "[[0.0]]", "[[3.0]]", "[[1.0, 2.0]]", "[[1.0, 2.0], [0.5, 1.0]]",
                "[[1.0, 0.0], [0.0, 0.0]]",
            )],
            "transmissions": [
                refusal(lambda x=x: Transmission(matrix=nearly(x))) for x in (3.9e-8, 4.1e-8)
            ],
            "sides": [
                refusal(lambda n=n: Transmission(matrix=MATRIX, friction=("motor",) * n))
                for n in (2, 3, 4)
            ],
            "couplings": [
                refusal(lambda m=m: Coupling(m))
                for m in ((), ((1.0,),), ((1.0, 2.0),), ((0.0,),), ((1.0,), (2.0,)),
                          nearly(3.9e-8), nearly(4.1e-8))
            ],
            "turning": [
                refusal(lambda s=s: Transmission(matrix=MATRIX).require_turning("abc", s))
                for s in ((False,) * 3, (True,) * 3, (True, False, False), (False, True, False))
            ],
            "gears": [
                refusal(lambda g=g: RobotDescription(**{**dict(arm), "gear_ratio": g,
                        "transmission": Transmission(matrix=MATRIX)}))
                for g in (None, (50.0, 80.0, 40.0), (50.0, 80.0, 41.0))
            ],
            "units": [
                units(False, True, q="deg"), units(False, True, q=("deg", "mm")),
                units(True, False, tau=("mN.m", "N.m")), units(False, True, q=("rev", 2.0)),
                units(False, False, dq=("rpm", "mm/s")), units(False, True),
            ],
            "log formats": [
                refusal(lambda d=d: LogFormat.model_validate(d))
                for d in ({"sample_rate": 0}, {"sample_rate": 0.5}, {"filter_cutoff": 0},
                          {"filter_cutoff": 0.5}, {"columns": {"q": "q"}}, {"columns": {"q": ""}},
                          {"columns": {"dq": ""}}, {"columns": {"q": "{}{0}"}},
                          {"columns": {"q": "{}{}"}}, {"units": {"q": 0.0}}, {"units": {"q": 1.0}},
                          {"units": {"q": "mile"}}, {"units": {"q": ("deg", 0)}},
                          {"units": {"tau": "--N.m"}}, {"units": {"t": "-s"}})
            ],
            "columns": [
                str(column_names(c, ("a", "b")))
                for c in ("q{}", "q{0}", "q{1}_x", "{name}_q", ("x", "y"))
            ],
            "defaults": [str(LogFormat()), str(description_of(arm).rotor_inertia)],
            "kelvin": [LogUnits(temperature=x).zero_of_temperature for x in ("K", "degC")],
            "factors": str([LogUnits(q=("deg", "-rev", 2.0)).factors("q", 3).round(9).tolist(),
                            LogUnits().factors("dq", 2).tolist()]),
        }
    )  # fmt: skip
