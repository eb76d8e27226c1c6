"""Laws reduced to the numbers that simulators have, and what the reduction costs."""

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from joint_data import along, law, path

import hesr
from hesr.extras.reduction.creep import DEFAULT_SOLREF, SOLREF, simulate_creep
from hesr.extras.reduction.formats import compose_isaaclab, compose_mjcf, compose_urdf
from hesr.extras.reduction.projection import ReducedJoint, project, reduce_model
from hesr_model.errors import ExportError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
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
    assert joint.price.law_rmse < 0.5 * joint.price.rmse
    assert joint.frictionloss != pytest.approx(10.0, rel=0.01)  # not the law's own coefficient


def test_a_weight_by_speed_keeps_the_energy_where_damping_is_at_its_bound() -> None:
    dq = np.linspace(-1.0, 1.0, 400)
    tau = np.sign(dq) * (5.0 - 2.0 * np.abs(dq))  # falls with speed
    energies = {}
    for weight in ("rows", "power"):
        frictionloss, damping = project(dq, tau, weight)
        assert damping == 0.0
        energies[weight] = frictionloss * np.sum(np.abs(dq)) / (tau @ dq)
    assert energies["power"] == pytest.approx(1.0, rel=1e-9)
    assert abs(energies["rows"] - 1.0) > 0.05


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
    assert f"{joint.name}: {speeds[0]:.2g} rad/s" in compose_mjcf(JOINTS, COMMENTS)


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
