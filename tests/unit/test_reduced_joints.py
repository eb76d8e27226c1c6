"""Laws reduced to the numbers that simulators have, and what the reduction costs."""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from joint_data import along, law, path

import hesr
from cosim.servo.record import ServoRecord
from hesr.extras.reduction.formats import (
    ISAACLAB,
    MJCF_JOINT,
    NEWTON,
    SDF_DYNAMICS,
    URDF_DYNAMICS,
    compose_isaaclab,
    compose_mjcf,
    compose_newton,
    compose_sdf,
    compose_urdf,
)
from hesr.extras.reduction.projection import ReducedJoint, project, reduce_model
from hesr.extras.reduction.soft_friction import (
    DEFAULT_SOLREF,
    SOLREF,
    follow_commands,
    simulate_creep,
)
from hesr_model.errors import ExportError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.servo import JointServo
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.files import models_folder

PLAIN = law("coulomb_viscous", {}, F_c=3.0, sigma_2=2.0, tau_0=0.0)
LUGRE = law(
    "lugre", {}, sigma_0=2000.0, sigma_1=30.0, sigma_2=4.0, F_c=10.0, F_s=14.0, v_s=0.1, tau_0=0.0
)


def model_of(one: FrictionLaw) -> FrictionModel:
    return FrictionModel(
        law=one.name, robot="bench", joints=("j1",), laws=(one,), sample_time=0.008
    )


def reduced(true: FrictionLaw, noise: float = 0.0, **options: Any) -> ReducedJoint:
    training = [[along(true, path(k), noise=noise, seed=k)] for k in range(2)]
    tests = [[along(true, path(7), noise=noise, seed=7)]]
    [joint] = reduce_model(model_of(true), training, tests, None, [0.5], **options)
    return joint


@pytest.mark.parametrize("weight", ["rows", "power"])
def test_coulomb_and_viscous_friction_is_kept(weight: Any) -> None:
    joint = reduced(PLAIN, weight=weight)
    assert joint.frictionloss == pytest.approx(3.0, rel=1e-9)
    assert joint.damping == pytest.approx(2.0, rel=1e-9)
    assert joint.price.rmse == pytest.approx(0.0, abs=1e-9)
    assert joint.price.energy == pytest.approx(1.0, rel=1e-9)


def test_numbers_of_a_law_are_the_nearest_ones_of_the_log() -> None:
    joint = reduced(LUGRE, noise=0.3)
    record = along(LUGRE, path(7), noise=0.3, seed=7)
    moving = np.abs(record.dq) > joint.price.speeds[0] * (1.0 - 1e-12)
    columns = np.stack([np.sign(record.dq), record.dq], axis=1)[moving]
    best, *_ = np.linalg.lstsq(columns, record.tau[moving], rcond=None)
    best_error = np.sqrt(np.mean((columns @ best - record.tau[moving]) ** 2))
    assert joint.price.rmse <= 1.03 * best_error
    # The noise of the log is the law's error. It does not depend on the torques of the numbers.
    assert joint.price.law_rmse == pytest.approx(0.3, rel=0.05)
    assert joint.price.law_rmse < 0.5 * joint.price.rmse
    numbers = joint.frictionloss * columns[:, 0] + joint.damping * columns[:, 1]
    lost = np.var(numbers - record.tau[moving]) - joint.price.law_rmse**2
    assert joint.price.lost_variance == pytest.approx(lost / np.var(record.tau[moving]), abs=1e-3)
    assert joint.frictionloss != pytest.approx(10.0, rel=0.01)  # not the law's own coefficient


def test_numbers_keep_the_energy_where_damping_is_at_its_bound() -> None:
    dq = np.linspace(-1.0, 1.0, 400)
    tau = np.sign(dq) * (5.0 - 2.0 * np.abs(dq))  # falls with speed
    for weight in ("rows", "power"):
        frictionloss, damping = project(dq, tau, weight)
        assert damping == 0.0
        assert frictionloss * np.sum(np.abs(dq)) == pytest.approx(tau @ dq, rel=1e-9)


def test_a_weight_by_speed_prefers_fast_rows() -> None:
    dq = np.linspace(-1.0, 1.0, 400)
    tau = np.sign(dq) * (1.0 + np.exp(-10.0 * np.abs(dq))) + 2.0 * dq
    fast = np.abs(dq) > 0.7
    errors = {}
    for weight in ("rows", "power"):
        frictionloss, damping = project(dq, tau, weight)
        numbers = frictionloss * np.sign(dq) + damping * dq
        assert numbers @ dq == pytest.approx(tau @ dq, rel=1e-9)
        errors[weight] = np.sqrt(np.mean((numbers - tau)[fast] ** 2))
    assert errors["power"] < 0.9 * errors["rows"]


def test_the_price_spreads_over_logs() -> None:
    """A day with twice the noise costs more; one log, also in parts, has no spread."""
    calm = along(PLAIN, path(7), noise=0.1, seed=7)
    noisy = replace(along(PLAIN, path(8), noise=0.2, seed=8), log="noisy")
    training = [[along(PLAIN, path(0))]]
    [joint] = reduce_model(model_of(PLAIN), training, [[calm], [noisy]], None, [0.5])
    assert joint.price.spread == pytest.approx((0.1, 0.2), rel=0.1)
    [parts] = reduce_model(model_of(PLAIN), training, [[calm], [calm]], None, [0.5])
    assert parts.price.spread is None


def test_a_joint_that_stands_still_is_named() -> None:
    record = along(PLAIN, path(0))
    still = replace(record, q=np.full_like(record.q, 0.3), dq=np.zeros_like(record.dq))
    with pytest.raises(ExportError, match="joint 'j1': it stands still in run"):
        reduce_model(model_of(PLAIN), [[record]], [[still]], None, [0.5])


def test_a_law_without_friction_is_refused() -> None:
    pushing = replace(PLAIN, values={"F_c": -3.0, "sigma_2": -2.0, "tau_0": 0.0})
    with pytest.raises(ExportError, match="does not oppose motion"):
        reduce_model(model_of(pushing), [[along(PLAIN, path(0))]], None, None, [0.5])


JOINTS = [
    replace(reduced(LUGRE), name="shoulder", armature=0.25),
    replace(reduced(PLAIN), name="lift", sliding=True),
]
COMMENTS = ["-- price --"]


def test_mujoco_has_the_numbers() -> None:
    included = compose_mjcf(JOINTS, COMMENTS)
    default = included[included.index("<default>") : included.index("</mujoco>")]
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco>{default}<worldbody><body><joint class='shoulder'/><geom size='.1'/><body>"
        "<joint class='lift' type='slide'/><geom size='.1'/></body></body></worldbody></mujoco>"
    )
    assert model.dof_frictionloss == pytest.approx([one.frictionloss for one in JOINTS], rel=1e-5)
    assert np.ravel(model.dof_damping)[0] == pytest.approx(JOINTS[0].damping, rel=1e-5)
    assert model.dof_armature[0] == pytest.approx(0.25)
    ET.fromstring(included)


def test_mujoco_creeps_less_with_the_written_constant() -> None:
    """Under half of the Coulomb friction, by MuJoCo's own constraint: see `solref` there."""
    joint = JOINTS[0]
    speeds = [simulate_creep(joint, solref=solref) for solref in (SOLREF, DEFAULT_SOLREF)]
    assert 0.0 < speeds[0] < 0.5 * speeds[1]
    assert f"{joint.name}: {speeds[0]:.2g} rad/s" in " ".join(MJCF_JOINT.describe(JOINTS))


def test_a_servo_too_stiff_for_the_step_is_unstable_in_mujoco() -> None:
    t = np.arange(0.0, 1.0, 0.01)
    q = 0.2 * np.sin(5.0 * t)
    zeros = np.zeros_like(t)
    record = ServoRecord(
        log="run",
        joint="j1",
        t=t,
        q_cmd=q,
        dq_cmd=zeros,
        q=q,
        posture=q,
        dq=zeros,
        ddq=zeros,
        inertia=np.full_like(t, 1e-4),
        bias=zeros,
        slope=zeros,
    )
    joint = replace(JOINTS[1], inertia=1e-4, frictionloss=0.01, damping=1e-3)
    stiff = follow_commands(joint, record, JointServo(kp=5e3), 1.0)
    assert np.all(np.isinf(stiff))
    soft = follow_commands(joint, record, JointServo(kp=0.5), 1.0)
    assert np.sqrt(np.mean((soft - q) ** 2)) < 0.1


def test_a_urdf_has_the_numbers() -> None:
    root = ET.fromstring(compose_urdf(JOINTS, COMMENTS))
    found = {
        joint.get("name"): (joint.get("type"), joint.find("dynamics").attrib)
        for joint in root.iter("joint")
    }
    assert [kind for kind, _ in found.values()] == ["revolute", "prismatic"]
    for joint in JOINTS:
        _, numbers = found[joint.name]
        assert float(numbers["friction"]) == pytest.approx(joint.frictionloss, rel=1e-5)
        assert float(numbers["damping"]) == pytest.approx(joint.damping, rel=1e-5)


def test_isaac_lab_has_the_numbers() -> None:
    tree = ast.parse(compose_isaaclab(JOINTS, COMMENTS))
    assignment = tree.body[-1]
    assert isinstance(assignment, ast.Assign)
    call = assignment.value
    assert isinstance(call, ast.Call)
    fields = {keyword.arg: ast.literal_eval(keyword.value) for keyword in call.keywords}
    assert fields["armature"] == {"shoulder": 0.25}
    for joint in JOINTS:
        assert fields["friction"][joint.name] == pytest.approx(joint.frictionloss, rel=1e-5)
        assert fields["viscous_friction"][joint.name] == pytest.approx(joint.damping, rel=1e-5)


def test_an_sdf_has_the_numbers() -> None:
    root = ET.fromstring(compose_sdf(JOINTS, COMMENTS))
    found = {joint.get("name"): joint.find("axis/dynamics") for joint in root.iter("joint")}
    for joint in JOINTS:
        dynamics = found[joint.name]
        assert float(dynamics.findtext("friction")) == pytest.approx(joint.frictionloss, rel=1e-5)
        assert float(dynamics.findtext("damping")) == pytest.approx(joint.damping, rel=1e-5)


SERVO = JointServo(kp=20.0, kd=1.5, torque_limit=3.0, latency=0.011, command_filter=0.05)


def test_newton_has_the_numbers() -> None:
    """The module runs on a builder's lists: two joints behind a free one of six."""
    namespace: dict[str, Any] = {}
    served = [replace(JOINTS[0], servo=SERVO), JOINTS[1]]
    exec(compose_newton(served, COMMENTS), namespace)
    names = ("friction", "damping", "armature", "target_ke", "target_kd", "effort_limit")
    lists = {f"joint_{name}": [0.0] * 8 for name in names}
    builder = SimpleNamespace(
        joint_label=["base", "arm/shoulder", "lift"], joint_qd_start=[0, 6, 7], **lists
    )
    namespace["set_numbers"](builder)
    assert builder.joint_friction[6:] == pytest.approx(
        [joint.frictionloss for joint in JOINTS], rel=1e-5
    )
    assert builder.joint_damping[6:] == pytest.approx([joint.damping for joint in JOINTS], rel=1e-5)
    assert builder.joint_armature == [0.0] * 6 + [0.25, 0.0]
    assert builder.joint_target_ke == [0.0] * 6 + [20.0, 0.0]
    assert builder.joint_effort_limit[6] == 3.0
    builder.joint_label[0] = "other/lift"
    with pytest.raises(ValueError, match="2 joints have the name 'lift'"):
        namespace["set_numbers"](builder)


def test_a_fitted_servo_is_written() -> None:
    joint = replace(JOINTS[0], servo=SERVO)
    root = ET.fromstring(compose_mjcf([joint], COMMENTS))
    assert root.find("actuator/position").attrib == {
        "joint": "shoulder",
        "kp": "20",
        "kv": "1.5",
        "forcelimited": "true",
        "forcerange": "-3 3",
        "timeconst": "0.05",
    }
    code = compose_isaaclab([joint], COMMENTS)
    for part in ("stiffness={", "damping={", "effort_limit_sim={"):
        assert part in code


def test_each_format_says_what_it_lacks() -> None:
    joints = [replace(JOINTS[0], servo=SERVO), JOINTS[1]]
    for text_format, part in (
        (URDF_DYNAMICS, "has no armature"),
        (SDF_DYNAMICS, "has no servo"),
        (ISAACLAB, "was not run here"),
        (NEWTON, "Newton 1.3 and newer"),
    ):
        assert part in " ".join(text_format.describe(joints))
    assert "lift" in next(NEWTON.describe(joints))  # its armature is not separated


@pytest.mark.ci
def test_the_price_is_that_of_the_written_file(tmp_path: Path) -> None:
    """Of a law of the measured UR10: recomputed from the numbers in the file, and the best ones."""
    folder = models_folder() / "ur10"
    log = hesr.Log.read(folder / "ur10_excitation.csv", robot=folder / "robot.toml")
    robot = hesr.Robot(folder / "robot.toml")
    body = hesr.identify(log, robot=robot)
    model = hesr.fit(log, law="stribeck", robot=robot, rigid_body=body)
    output = hesr.export(
        model,
        tmp_path / "ur10.urdf",
        format="urdf-dynamics",
        log=[log],
        robot=robot,
        rigid_body=body,
    )
    with pytest.raises(ExportError, match=r"ur10\.txt: a URDF ends"):
        hesr.export(model, tmp_path / "ur10.txt", format="urdf-dynamics", log=log, robot=robot)
    text = Path(output).read_text(encoding="utf-8")
    numbers = [one.attrib for one in ET.fromstring(text).iter("dynamics")]
    records = model.records(log, rigid_body=body)
    tau_law = model.predict(records)
    for j, record in enumerate(records):
        line = next(line for line in text.splitlines() if f"{record.joint}: " in line)
        law_rmse, rest = line.split(": ")[1].split(" and ")
        shown_rmse = float(rest.split()[0])
        moving = np.abs(record.dq) > find_resting_speed([record])
        columns = np.stack([np.sign(record.dq), record.dq], axis=1)[moving]
        own = np.array([float(numbers[j]["friction"]), float(numbers[j]["damping"])])
        tau = record.tau[moving]
        assert np.sqrt(np.mean((columns @ own - tau) ** 2)) == pytest.approx(shown_rmse, rel=1e-3)
        error = tau_law[moving, j] - tau
        assert np.sqrt(np.mean(error**2)) == pytest.approx(float(law_rmse), rel=1e-3)
        best, *_ = np.linalg.lstsq(columns, tau, rcond=None)
        assert shown_rmse <= 1.03 * np.sqrt(np.mean((columns @ best - tau) ** 2))
        energy = (columns @ own) @ record.dq[moving] / (tau_law[moving, j] @ record.dq[moving])
        assert energy == pytest.approx(1.0, abs=0.01)
