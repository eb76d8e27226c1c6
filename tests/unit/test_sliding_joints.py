"""Sliding joints: their units in a model, in its file and from a fit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from joint_data import HX_PAPER, along, law, path
from joint_data import Path as Way

from hesr_model.errors import ArtifactError, LogError
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit, fit_joint
from hesr_model.friction.law import coefficient_lines
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.laws.stops.form import DEFLECTIONS
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import require_reversals
from hesr_model.units import unit_of_joint, unit_of_joints

AXIS_TRUTHS = {
    "bristles": law("lugre", {}, F_c=20.0, F_s=26.0, v_s=0.003, sigma_0=2.5e6, sigma_1=0.0,
                    sigma_2=200.0, tau_0=0.0),
    "stops": law("dahl", {}, **{f"kappa_{k}": 1.0 / w for k, w in enumerate(
        (2e-6, 8e-6, 3e-5, 1e-4, 3e-4), 1)}, **{f"F_{k}": 4.0 for k in range(1, 6)},
        sigma_2=200.0, tau_0=0.0),
    "exact Coulomb": law("stribeck", {}, F_c=20.0, F_s=20.0, v_s=0.003, sigma_2=200.0, tau_0=0.0),
}  # fmt: skip
"""Friction of a sliding axis [N], with deflections of micrometres."""

TRUTH = law("parfam_hx", HX_PAPER, c_0=0.4, c_dq=5.0, c_h=9.0, c_dh=0.02, alpha=10.0, beta=50.0)
TURNS = along(TRUTH, path(0), log="run")
SLIDES = replace(TURNS, joint="lift", sliding=True)


@pytest.fixture(scope="module")
def model() -> FrictionModel:
    """A revolute and a sliding joint."""
    return fit("lugre", [TURNS, SLIDES])


@pytest.mark.parametrize(
    ("turning", "sliding"),
    [
        ("N.m", "N"),
        ("rad", "m"),
        ("rad/s", "m/s"),
        ("rad/s2", "m/s2"),
        ("N.m.s", "N.s"),
        ("N.m/rad", "N/m"),
        ("N.m.s/rad", "N.s/m"),
        ("N.m/s", "N/s"),
        ("1/rad", "1/m"),
        ("1/rad2", "1/m2"),
        ("s/rad", "s/m"),
        ("1/(N.m)", "1/N"),
        ("rad/(s.N.m)", "m/(s.N)"),
        ("kN.m/rad", "kN/m"),
        ("mrad", "mm"),
        ("µrad", "µm"),
        ("kg.m2", "kg"),
        ("1", "1"),
        ("1/s", "1/s"),
        ("J", "J"),
        ("%", "%"),
        ("", ""),
        ("rad2/s", "m2/s"),
        ("N.m2", "N.m2"),
    ],
)
def test_units_of_a_sliding_joint(turning: str, sliding: str) -> None:
    assert unit_of_joint(turning, is_prismatic=True) == sliding
    assert unit_of_joint(sliding, is_prismatic=True) == sliding
    assert unit_of_joint(turning, is_prismatic=False) == turning


def test_other_texts_are_refused_as_units() -> None:
    with pytest.raises(ValueError, match=r"'3 N\.m' is not a unit"):
        unit_of_joint("3 N.m", is_prismatic=True)


def test_units_of_several_joints() -> None:
    assert unit_of_joints("N.m", ()) == unit_of_joints("N.m", (False, False)) == "N.m"
    assert unit_of_joints("N.m", (True, True)) == "N"
    assert unit_of_joints("N.m", (False, True)) == "N.m (N where it slides)"
    assert unit_of_joints("J", (False, True)) == "J"


def test_every_law_uses_linear_units_on_a_sliding_joint() -> None:
    for name, entry in registry().items():
        try:
            form = entry.form({})
        except (ArtifactError, KeyError):
            continue  # a family, which needs a structure
        units = [c.unit for c in form.sliding.coefficients]
        units += [r.unit for r in form.sliding.relaxations]
        assert not [u for u in units if "rad" in u or "N.m" in u], name
        assert not [c for c in form.sliding.coefficients if "torque" in c.description], name
        assert form.sliding.sliding == form.sliding
        assert form.sliding.output == form.output


def test_a_fit_records_sliding_joints(model: FrictionModel) -> None:
    assert model.sliding == (False, True)
    turns, slides = model.laws
    # The bounds of the search differ.
    assert slides.values == pytest.approx(turns.values, rel=1e-5)
    units = {
        c.name: (c.unit, s.unit)
        for c, s in zip(turns.form.coefficients, slides.form.coefficients, strict=True)
    }
    assert units["sigma_0"] == ("N.m/rad", "N/m")
    assert units["sigma_2"] == ("N.m.s/rad", "N.s/m")
    assert units["v_s"] == ("rad/s", "m/s")
    assert [r.unit for one in model.laws for r in one.form.relaxations] == ["rad", "m"]
    assert any(line.endswith(" N/m") for line in coefficient_lines(slides))
    assert not any("rad" in line or "N.m" in line for line in coefficient_lines(slides))


def test_the_prediction_does_not_depend_on_units(model: FrictionModel) -> None:
    same = replace(model, laws=(model.laws[0],) * 2)
    predicted = same.predict([TURNS, SLIDES])
    assert (predicted[:, 0] == predicted[:, 1]).all()


def test_a_file_lists_sliding_joints_only(model: FrictionModel, tmp_path: Path) -> None:
    file = tmp_path / "law.json"
    model.write(file)
    turns, slides = json.loads(file.read_text())["joints"]
    assert "sliding" not in turns
    assert slides["sliding"] is True
    assert slides["coefficients"]["sigma_0"]["unit"] == "N/m"
    assert FrictionModel.read(file) == model


def test_joints_are_revolute_by_default(model: FrictionModel) -> None:
    plain = FrictionModel(
        law="lugre", robot="bench", joints=("j1",), laws=model.laws[:1], sample_time=0.01
    )
    assert (plain.sliding, plain.slides) == ((), (False,))
    two = replace(plain, joints=("j1", "j2"), laws=plain.laws * 2, sliding=(False, False))
    assert (two.sliding, two.slides) == ((), (False, False))


def test_wrong_fields_are_refused(model: FrictionModel, tmp_path: Path) -> None:
    file = tmp_path / "law.json"
    model.write(file)
    data = json.loads(file.read_text())
    data["joints"][1]["sliding"] = "yes"
    file.write_text(json.dumps(data))
    with pytest.raises(
        ArtifactError, match=r"key 'joints\.1\.sliding': Input should be a valid boolean"
    ):
        FrictionModel.read(file)
    del data["joints"][1]["sliding"]
    file.write_text(json.dumps(data))
    with pytest.raises(ArtifactError, match=r"has the unit '.+', expected '.*N\.m.*'"):
        FrictionModel.read(file)


def test_one_entry_per_joint_is_needed(model: FrictionModel) -> None:
    with pytest.raises(ArtifactError, match="1 flags of prismatic joints for 2 joints"):
        replace(model, sliding=(True,))


def test_a_missing_reversal_is_reported_in_units_of_the_joint() -> None:
    one_way = replace(SLIDES, dq=abs(SLIDES.dq) + 1.0)
    with pytest.raises(LogError, match=r"speeds of more than 0\.02 m/s"):
        require_reversals([one_way])


def axis(truth: str, seed: int, *, sliding: bool = True) -> FrictionRecord:
    """Friction along four harmonics of up to 240 mm/s, no slow joint, at 500 Hz."""
    rng, t = np.random.default_rng(seed), 0.002 * np.arange(4000)
    rates = 2.0 * np.pi * np.array([0.3, 0.53, 0.9, 1.7])
    weights, angle = np.array([0.096, 0.072, 0.048, 0.024]), np.outer(t, rates)
    angle = angle + rng.uniform(0.0, 2.0 * np.pi, 4)
    way = Way(t=t, dq=np.sin(angle) @ weights, q=-np.cos(angle) @ (weights / rates), load=0.0 * t)
    own = along(AXIS_TRUTHS[truth], way, noise=0.5, seed=seed, log=str(seed))
    return replace(own, sliding=sliding)


@pytest.mark.parametrize("name", ["lugre", "parfam_s_v"])
@pytest.mark.parametrize("truth", AXIS_TRUTHS)
def test_deflections_of_a_sliding_joint_are_finer(truth: str, name: str) -> None:
    """On an unseen motion, against the grid and the bounds of rotating joints."""
    new, errors = axis(truth, 9), {}
    true = predict(AXIS_TRUTHS[truth], **new.motion)
    for sliding in (False, True):
        found = fit_joint(name, [axis(truth, k, sliding=sliding) for k in range(2)], seed=0)
        errors[sliding] = rmse(predict(found, **new.motion) - true)
    if (truth, name) == ("stops", "lugre"):  # its best deflection is within the usual bounds
        assert errors[True] <= 1.001 * errors[False]
    else:
        assert errors[True] <= 0.5 * errors[False]


def test_the_scale_of_a_sliding_joint_is_that_of_its_friction() -> None:
    """A wide truth keeps the usual grid; a rotating joint has no other one."""
    wide = law("dahl", {}, **{f"kappa_{k}": 1.0 / w for k, w in enumerate(
        (1e-4, 4e-4, 1e-3, 3e-3, 9e-3), 1)}, **{f"F_{k}": 4.0 for k in range(1, 6)},
        sigma_2=200.0, tau_0=0.0)  # fmt: skip
    logs = [
        replace(along(wide, path(k, peak=0.1), noise=0.05, seed=k, log=str(k)), sliding=True)
        for k in range(2)
    ]
    found = fit_joint("parfam_s_v", logs, seed=0)
    assert max(node for _, node in found.structure["stops"]) < len(DEFLECTIONS)
    turning = fit_joint(
        "parfam_s_v", [axis("bristles", k, sliding=False) for k in range(2)], seed=0
    )
    assert max(node for _, node in turning.structure["stops"]) < len(DEFLECTIONS)
