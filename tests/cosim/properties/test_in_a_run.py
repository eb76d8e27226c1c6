"""Physics checks as part of `hesr run`, and on every law of the registry."""

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
import pytest
from registry_models import SAMPLES
from small_study import Run

from hesr.extras.properties.battery import Subject, run_battery
from hesr.extras.properties.scale import INERTIA, compute_standing_inertia
from hesr_model.audit.properties import EXPECTATIONS, read_properties, write_properties
from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

pytestmark = pytest.mark.ci


@pytest.mark.parametrize(
    "names", [SAMPLES, pytest.param((), marks=pytest.mark.nightly("laws"))], ids=["some", "all"]
)
def test_every_law_of_the_registry_is_checked(
    names: tuple[str, ...], tmp_path: Path, registry_models: dict[str, FrictionModel]
) -> None:
    models = {law: registry_models[law] for law in names or registry_models}
    subjects = [Subject(name=law, model=model, inertia=(0.5,)) for law, model in models.items()]
    found = dict(zip(models, run_battery(subjects), strict=True))
    for law, of_law in found.items():
        findings = of_law.joints[0].findings
        assert list(findings) == list(EXPECTATIONS)
        for key, finding in findings.items():
            assert finding.verdict in ("pass", "fail", "not applicable"), (law, key)
            assert finding.verdict == "pass" or finding.reason, (law, key)
    write_properties(tmp_path / "found.json", found)
    assert read_properties(tmp_path / "found.json") == found


def test_a_run_writes_findings_to_its_folder_and_the_fmus(
    study_run_for_programs: Run,
) -> None:
    results = study_run_for_programs.results
    assert "testing the laws: " in study_run_for_programs.answer.err
    found = read_properties(results / "properties.json")
    assert list(found) == [*select_laws("baseline"), "stribeck", "parfam_h"]
    assert [j.inertia for j in found["stribeck"].joints] == list(INERTIA["uf850"])
    with zipfile.ZipFile(results / "fmus" / "stribeck.fmu") as archive:
        assert 'id="property-hold"' in archive.read("documentation/index.html").decode()


def body_of(model: Robot, robot: str) -> RigidBody:
    """The identification result for the model's own parameters."""
    n = model.n
    return RigidBody(
        robot=robot,
        joints=model.description.joints,
        names=model.parameter_names,
        parameters=model.nominal_parameters,
        base=(0,),
        standard_errors=np.zeros(1),
        condition=1.0,
        ridge=0.0,
        friction=np.zeros((n, 3)),
        rmse=np.zeros(n),
        rows=1,
        logs=(),
        method="stacked",
        weighting="ols",
    )


def test_other_robots_use_the_inertia_of_their_identified_mass_matrix(
    registry_models: dict[str, FrictionModel],
) -> None:
    model = Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))
    law = registry_models["stribeck"]
    places = (0.2, -0.6, -1.4)
    trained = tuple(replace(law.trained[0], q=(q - 0.1, q + 0.1)) for q in places)
    three = replace(law, joints=("a", "b", "c"), laws=law.laws * 3, trained=trained)
    found = compute_standing_inertia(model, body_of(model, "other"), three)
    own = model._pin_model  # without the rotors, which are separate parameters
    matrix = pinocchio.crba(own, own.createData(), np.array(places))
    assert found == pytest.approx(np.diag(matrix) + model.rotor_nominal, rel=1e-9)
    assert compute_standing_inertia(model, body_of(model, "uf850"), three) == INERTIA["uf850"]
    unphysical = replace(body_of(model, "other"), parameters=-model.nominal_parameters)
    assert compute_standing_inertia(model, unphysical, three) is None
