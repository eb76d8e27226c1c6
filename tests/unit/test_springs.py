"""Springs and balancers: their torque, base parameters, identification, and messages."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hesr_model.errors import RobotError
from hesr_model.health.examine import examine
from hesr_model.health.joints import remove_joints
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.accumulation import StreamedProblem
from hesr_model.rigid_body.base_parameters import base_columns, unknown_columns
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.observations import friction_columns
from hesr_model.rigid_body.torque_constants import torque_constants
from hesr_model.robots.robot import Robot, RobotDescription

MakeMotion = Callable[..., Motion]

PENDULUM = """
<robot name="pendulum">
  <link name="base"/>
  <link name="body"><inertial><origin xyz="0.3 0 0.1"/><mass value="2"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="a" type="TYPE"><parent link="base"/><child link="body"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="2"/></joint>
</robot>
"""


@pytest.fixture
def sprung(arm: RobotDescription) -> Robot:
    """The arm with a spring on its first joint and a balancer on its second."""
    more = {"springs": ("j1",), "balancers": ("j2",)}
    return Robot(arm.model_copy(update=more))


def pendulum(folder: Path, kind: str = "revolute", **more: object) -> Robot:
    urdf = folder / "pendulum.urdf"
    urdf.write_text(PENDULUM.replace("TYPE", kind), encoding="utf-8")
    own = {"name": "pendulum", "model": urdf, "joints": ("a",), "rotor_inertia": False}
    return Robot(RobotDescription.model_validate(own | more))


def with_springs(motion: Motion) -> Motion:
    q1, q2 = motion.q[:, 0], motion.q[:, 1]
    more = np.zeros_like(motion.tau)
    more[:, 0] = 7.0 * (q1 - 0.4)
    more[:, 1] = 60.0 * np.cos(q2 - 0.7) - 8.0 * np.sin(2.0 * q2 + 0.1) + 3.0
    return replace(motion, tau=motion.tau + more)


def test_parameters_of_springs_come_last(sprung: Robot) -> None:
    names = ("j1.k", "j1.const", "j2.const", "j2.cos", "j2.sin", "j2.cos2", "j2.sin2")
    assert sprung.parameter_names[sprung.inertial :] == names
    assert not sprung.nominal_parameters[sprung.inertial :].any()


def test_a_joint_with_both_has_one_constant(arm: RobotDescription) -> None:
    more = {"springs": ("j2",), "balancers": ("j2",)}
    robot = Robot(arm.model_copy(update=more))
    names = [name.removeprefix("j2.") for name in robot.parameter_names[robot.inertial :]]
    assert names == ["k", "const", "cos", "sin", "cos2", "sin2"]
    assert len(base_columns(robot)) == len(base_columns(Robot(arm))) + 6


def test_the_torque_of_springs_is_that_of_their_joint(arm_model: Robot, sprung: Robot) -> None:
    q, dq, ddq = np.random.default_rng(1).uniform(-2, 2, (3, 20, 3))
    numbers = np.array([7.0, -2.8, 1.8, 45.0, -38.0, 0.8, -7.9])
    parameters = sprung.nominal_parameters.copy()
    parameters[sprung.inertial :] = numbers
    found = sprung.torque(parameters, q, dq, ddq)
    found -= arm_model.torque(arm_model.nominal_parameters, q, dq, ddq)
    x = q[:, 1]
    waves = [np.ones(20), np.cos(x), np.sin(x), np.cos(2 * x), np.sin(2 * x)]
    np.testing.assert_allclose(found[:, 0], 7.0 * q[:, 0] - 2.8, atol=1e-11)
    np.testing.assert_allclose(found[:, 1], numbers[2:] @ np.array(waves), atol=1e-11)
    np.testing.assert_allclose(found[:, 2], 0.0, atol=1e-11)


def test_springs_replace_no_base_parameter_of_masses(arm_model: Robot, sprung: Robot) -> None:
    base = base_columns(sprung)
    assert tuple(k for k in base if k < sprung.inertial) == base_columns(arm_model)
    offset = friction_columns(sprung, base)[:, 2]
    assert offset.tolist() == [False, False, True]  # the constant of a spring takes its place


def test_a_balancer_reduces_to_the_gravity_that_it_resembles(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, balancers=("a",))
    names = [robot.parameter_names[k] for k in base_columns(robot)]
    assert names == ["a.mx", "a.mz", "a.Iyy", "a.const", "a.cos2", "a.sin2"]


def test_beside_known_gravity_the_whole_balancer_is_identified(tmp_path: Path) -> None:
    robot = pendulum(tmp_path, balancers=("a",), known=("a.mx", "a.mz"))
    names = [robot.parameter_names[k].removeprefix("a.") for k in unknown_columns(robot)]
    assert names == ["Iyy", "const", "cos", "sin", "cos2", "sin2"]


def wide(motion: Motion, model: Robot, friction: float = 0.0) -> Motion:
    """The arm's motion at twice its size, with springs."""
    q, dq, ddq = 2 * motion.q, 2 * motion.dq, 2 * motion.ddq
    tau = model.torque(model.nominal_parameters, q, dq, ddq) + friction * (np.sign(dq) + 0.5 * dq)
    return with_springs(replace(motion, q=q, q_raw=q, dq=dq, ddq=ddq, tau=tau))


@pytest.mark.parametrize("kind", ["stacked", "paper", "physical", "streamed"])
def test_springs_are_identified_with_the_body(
    kind: str, sprung: Robot, make_motion: MakeMotion
) -> None:
    forward, backward = (wide(make_motion(reverse=r), sprung, 3.0) for r in (False, True))
    if kind == "streamed":
        streamed = StreamedProblem(sprung)
        streamed.add(forward)
        body = streamed.body([forward], "log")
    else:
        body = identify_motions(
            [forward],
            sprung,
            method="paper" if kind == "paper" else "stacked",
            reversed_motions=[backward] if kind == "paper" else [],
            physical=kind == "physical",
        )
    truth = wide(make_motion(seconds=7.0), sprung)
    error = body.torque(sprung, truth) - truth.tau
    assert np.abs(error).max() < (1e-3 if kind == "physical" else 1e-6)
    assert len(body.standard_errors) == len(body.base)


def test_harmonics_over_a_small_angle_leave_the_masses_determined(
    arm_model: Robot, sprung: Robot, make_motion: MakeMotion
) -> None:
    """Over 1.5 rad they resemble each other: a ridge of theirs alone keeps them small."""
    motion, truth = make_motion(friction=3.0), with_springs(make_motion(seconds=7.0))
    noise = np.random.default_rng(1).normal(size=motion.tau.shape) * [1.5, 1.5, 0.6]
    noisy = replace(motion, tau=motion.tau + noise)
    bare, body = (
        identify_motions([noisy], arm_model),
        identify_motions([with_springs(noisy)], sprung),
    )
    assert (body.ridge, bare.ridge) == (0.0, 0.0)

    def error(body: RigidBody, model: Robot, torque: np.ndarray) -> float:
        return float(np.sqrt(np.mean((body.torque(model, truth) - torque) ** 2)))

    plain = arm_model.torque(arm_model.nominal_parameters, truth.q, truth.dq, truth.ddq)
    assert error(body, sprung, truth.tau) < 1.2 * error(bare, arm_model, plain)
    assert np.abs(body.parameters[sprung.inertial :]).max() < 100.0


def test_a_body_without_springs_is_for_another_robot(
    arm_model: Robot, sprung: Robot, make_motion: MakeMotion, tmp_path: Path
) -> None:
    motion = with_springs(make_motion())
    body = identify_motions([motion], sprung)
    body.write(tmp_path / "body.json")
    again = RigidBody.read(tmp_path / "body.json")
    np.testing.assert_array_equal(again.parameters_for(sprung), body.parameters)
    with pytest.raises(RobotError, match="same robot file"):
        again.parameters_for(arm_model)


def test_beside_a_balancer_weight_tells_no_torque_constant(tmp_path: Path) -> None:
    plain, balanced = pendulum(tmp_path), pendulum(tmp_path, balancers=("a",))
    t = np.arange(4000) / 200.0
    q, dq, ddq = (np.sin(t + s)[:, None] for s in (0.0, np.pi / 2, np.pi))
    tau = plain.torque(plain.nominal_parameters, q, dq, ddq) + np.sign(dq)
    motion = Motion(name="log", t=t, q=q, q_raw=q, dq=dq, ddq=ddq, tau=tau)
    found = [torque_constants([motion], r, (1.0,), mass_error=0.02)[0] for r in (plain, balanced)]
    assert [one.determined for one in found] == [True, False]


@pytest.mark.parametrize(
    ("kind", "more", "message"),
    [
        (
            "revolute",
            {"springs": ("b",)},
            "key 'springs' of robot 'pendulum' contains",
        ),
        (
            "revolute",
            {"balancers": ("b",)},
            "key 'balancers' of robot .* contains",
        ),
        (
            "prismatic",
            {"balancers": ("a",)},
            "key 'balancers' of .* contains",
        ),
        ("revolute", {"springs": ("a",), "known": ("a.k",)}, "key 'known' .* contains 'a.k'"),
    ],
)
def test_joints_without_springs_are_named(
    kind: str, more: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(RobotError, match=message):
        unknown_columns(pendulum(tmp_path, kind, **more))


def test_springs_of_locked_joints_are_left_out(sprung: Robot) -> None:
    robot = remove_joints(sprung.description, {"j2": 0.3})
    assert (robot.springs, robot.balancers) == (("j1",), ())


def test_masses_are_known_beside_springs(make_motion: MakeMotion, sprung: Robot) -> None:
    """Springs are identified before the checks; masses identified too would hide the scale."""
    motion = with_springs(make_motion(friction=0.8))
    found = []
    for scale in (1.0, 1.0 / 12.0):
        log = Log(name="log", t=motion.t, q=motion.q, dq=motion.dq, tau=scale * motion.tau)
        findings = examine([log], sprung.description, sprung).findings
        found.append([f.joints for f in findings if f.check == "torque-scale"])
    assert found == [[], [("j3",)]]  # the scale of others may be that of their springs


def test_a_balancer_is_no_wrong_scale(tmp_path: Path) -> None:
    """A balancer takes four fifths of the weight."""
    plain, balanced = pendulum(tmp_path), pendulum(tmp_path, balancers=("a",))
    t = np.arange(4000) / 200.0
    q, dq, ddq = (np.sin(t + s)[:, None] for s in (0.0, np.pi / 2, np.pi))
    tau = plain.torque(plain.nominal_parameters, q, dq, ddq) + 0.5 * np.sign(dq)
    tau -= 0.8 * plain.torque(plain.nominal_parameters, q, 0 * q, 0 * q)
    log = Log(name="log", t=t, q=q, dq=dq, tau=tau)
    checks = [
        {f.check for f in examine([log], robot.description, robot).findings}
        for robot in (plain, balanced)
    ]
    assert ["torque-scale" in found for found in checks] == [True, False]
