"""Fits of slow joints are those of fast ones, in another unit of length."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy

from hesr_model.errors import ArtifactError
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import registry
from hesr_model.fitting.fit import fit, fit_joint
from hesr_model.fitting.motion_scale import (
    find_length_power,
    find_motion_scale,
    fit_in_own_units,
    scale_motion,
    unscale_law,
)
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ, MOVING
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record
from hesr_model.laws.stribeck import F_C
from hesr_model.rigid_body.friction_record import FrictionRecord

SCALE = 2.0**10


def build_record(*, is_prismatic: bool = False, gear_ratio: float | None = None) -> FrictionRecord:
    """Return friction that builds up over a part of the stroke, from a start in motion."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 20.0, 0.01)
    phase = 2.0 * np.pi * 0.5 * t + 1.0
    q = 0.25 * (1.0 - np.cos(phase)) / np.pi
    dq = 0.25 * np.sin(phase)
    tau = np.ones_like(t)
    for k in range(1, len(t)):
        step = q[k] - q[k - 1]
        tau[k] = tau[k - 1] + 50.0 * (step - abs(step) * tau[k - 1] / 2.0)
    return FrictionRecord(
        log="log",
        joint="axis",
        t=t,
        dq=dq,
        q=q,
        tau_load=np.cos(t),
        tau=tau + 0.05 * rng.standard_normal(len(t)),
        sliding=is_prismatic,
        gear_ratio=gear_ratio,
    )


def test_joints_of_usual_speed_and_joints_at_rest_keep_their_units() -> None:
    record = build_record()
    assert find_motion_scale([record]) == 1.0
    assert find_motion_scale([scale_motion(record, 39.0)]) == 1.0
    assert find_motion_scale([scale_motion(record, 40.0 * SCALE)]) == 1.0 / SCALE
    assert find_motion_scale([scale_motion(record, 1.0 / SCALE)]) == SCALE
    noise = 1e-5 * np.random.default_rng(0).standard_normal(len(record.t))
    assert find_motion_scale([replace(record, q=noise, dq=np.gradient(noise, 0.01))]) == 1.0


@pytest.mark.parametrize("is_prismatic", [False, True])
@pytest.mark.parametrize("law_name", ["stribeck", "lugre", "dahl"])
def test_a_small_stroke_gives_the_same_law(law_name: str, is_prismatic: bool) -> None:
    record = build_record(is_prismatic=is_prismatic)
    small_record = scale_motion(record, 1.0 / SCALE)
    law = fit_joint(law_name, [record], seed=0)
    small_law = fit_joint(law_name, [small_record], seed=0)
    np.testing.assert_allclose(
        predict_record(small_law, small_record), predict_record(law, record), atol=1e-9
    )
    for quantity in law.form.coefficients:
        factor = SCALE ** -find_length_power(quantity.unit)
        expected = factor * law.values[quantity.name]
        assert small_law.values[quantity.name] == pytest.approx(expected, rel=1e-6, abs=1e-9)
        if quantity.name in law.standard_errors:
            expected = factor * law.standard_errors[quantity.name]
            assert small_law.standard_errors[quantity.name] == pytest.approx(expected, rel=1e-4)


def build_typical_law(law_name: str) -> FrictionLaw:
    """Return a law of the typical form with coefficients that all matter."""
    law_class = registry()[law_name]
    form = law_class.form(law_class.typical)
    rng = np.random.default_rng(0)
    values = {quantity.name: float(rng.uniform(0.5, 1.0)) for quantity in form.coefficients}
    return FrictionLaw(name=law_name, structure=law_class.typical, form=form, values=values)


@pytest.mark.parametrize(
    "law_name",
    [
        name
        for name, law_class in registry().items()
        if law_class.form(law_class.typical).coefficients
        and not law_class.form(law_class.typical).stops
    ],
)
def test_the_law_of_a_scaled_motion_gives_the_torque_of_the_motion(law_name: str) -> None:
    """Units of coefficients, states and starts say how they change with the unit of length."""
    record = build_record(gear_ratio=100.0)
    law = build_typical_law(law_name)
    torque = predict_record(law, record)
    assert np.ptp(torque) > 0.0 or law_name == "constant"
    small_torque = predict_record(unscale_law(law, SCALE), scale_motion(record, 1.0 / SCALE))
    np.testing.assert_allclose(small_torque, torque, rtol=1e-9, atol=1e-9)


class FixedLength(OneForm):
    """A law that bends at a given speed, as one of another package may."""

    name = "fixed_length"
    expressions = LawForm(
        coefficients=(F_C,), output=F_C.symbol * sympy.tanh(DQ / sympy.Float(1e-4))
    )

    def space(self) -> SearchSpace:
        """Solve for the force."""
        return SearchSpace(bounds=(), linear=("F_c",), non_negative=1)


def test_a_form_with_a_length_of_its_own_is_fitted_in_true_units(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(
        fit_in_own_units.__globals__, "estimator", lambda name: {"fixed_length": FixedLength}[name]
    )
    record = scale_motion(build_record(), 1.0 / SCALE)
    record = replace(record, tau=3.0 * np.tanh(record.dq / 1e-4))
    law_estimator = FixedLength()
    rng = np.random.default_rng(0)

    def fit_law(records: Sequence[FrictionRecord]) -> FrictionLaw:
        return law_estimator.fit(records, rng)

    law = fit_in_own_units(law_estimator, [record], fit_law)
    assert law.values["F_c"] == pytest.approx(3.0)


def test_the_speed_of_a_steady_start_is_written_for_slow_joints_only(tmp_path: Path) -> None:
    record = build_record()
    for number, scale in enumerate((1.0, SCALE)):
        model = fit("lugre", [scale_motion(record, 1.0 / scale)])
        path = tmp_path / f"{number}.json"
        model.write(path)
        assert ("steady_speed" in path.read_text(encoding="utf-8")) == (scale != 1.0)
        law = FrictionModel.read(path).laws[0]
        assert law == model.laws[0]
        assert law.form.steady_speed == MOVING / scale


def test_the_speed_of_a_steady_start_is_positive() -> None:
    form = registry()["lugre"].form({})
    for speed in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ArtifactError) as refusal:
            replace(form, steady_speed=speed)
        assert (refusal.value.code, refusal.value.key) == ("law.steady_speed", "steady_speed")


@pytest.mark.parametrize("law_name", ["coulomb_viscous", "lugre"])
def test_the_band_of_a_small_stroke_is_that_of_a_usual_one(law_name: str) -> None:
    """Its rest, its slow motion and its break-away are those of its own speeds."""
    record = build_record()
    small_record = scale_motion(record, 1.0 / SCALE)
    ends = [fit(law_name, [one]).predict_band([one]) for one in (record, small_record)]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-6)
    is_inside = (record.tau >= ends[1][0][:, 0]) & (record.tau <= ends[1][1][:, 0])
    assert 0.93 <= np.mean(is_inside) <= 0.98


@pytest.mark.parametrize(
    ("unit", "power"), [("N.m.s2/rad2", -2), ("1/rad", -1), ("rad/s", 1), ("N.m", 0), ("1", 0)]
)
def test_powers_of_lengths(unit: str, power: int) -> None:
    assert find_length_power(unit) == power
