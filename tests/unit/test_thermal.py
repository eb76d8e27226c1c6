"""Temperature in friction: identification from logs, storage in a model, and adaptation."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from adaptive_models import NOISE, SPEED, lugre, model, motion, stops, truth

from hesr.extras.adaptive.component import TUNING, adaptive_component
from hesr.extras.adaptive.monitor import Follower
from hesr.extras.thermal import thermal_fit
from hesr.extras.thermal.thermal_fit import Factored, ThermalFit, fit_thermal
from hesr_model.audit.certificate import find_min_viscous_scale, find_storage_factors
from hesr_model.equations.stepping import Steps
from hesr_model.errors import ArtifactError, FitError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse
from hesr_model.friction.thermal import COULOMB_RANGE, VISCOUS_RANGE, Thermal
from hesr_model.friction.thermal_law import thermal_component
from hesr_model.friction.trained_range import TrainedRange, find_excess
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.transmission import Coupling

TRUE = Thermal(
    coulomb=0.004, viscous=0.02, reference=30.0, resistance=0.3, time_constant=400.0, ambient=22.0
)
WHITE = 0.5
"""Standard deviation [N.m] of white noise at 50 Hz."""
LAWS = [pytest.param(lugre, id="LuGre"), pytest.param(stops, id="ParFam-S")]


def log(
    law: FrictionLaw, seconds: float, seed: int, thermal: Thermal = TRUE, *, start: float = 0.0
) -> FrictionRecord:
    """A log whose friction heats the joint, from `start` [K] above ambient."""
    t, dq, q, load = motion(seconds, seed, step=0.02)
    power = np.abs(18.0 * dq)
    for _ in range(2):
        temperature = thermal.ambient + thermal.rise(power, np.diff(t, prepend=t[0]), start)
        level, viscosity = thermal.factors(temperature)
        record = truth(
            law,
            t,
            dq,
            q,
            load,
            seed=seed,
            level=lambda _, own=level: own,
            viscosity=lambda _, own=viscosity: own,
            correlation=0.001,
            noise=WHITE,
        )
        clean = Factored(law).compute_torque(record, level, viscosity)
        power = np.abs(clean * dq)
    return replace(record, log=f"log {seed}", temperature=temperature)


@pytest.fixture(scope="module")
def logs() -> list[list[FrictionRecord]]:
    return [[log(stops(), 150.0, 1)], [log(stops(), 150.0, 2, start=32.0)]]


@pytest.fixture(scope="module")
def fitted(logs: list[list[FrictionRecord]]) -> tuple[FrictionModel, ThermalFit]:
    known, [found] = fit_thermal(replace(model(stops()), law="parfam_s"), logs)
    return known, found


@pytest.mark.parametrize("law", LAWS)
def test_held_factors_equal_the_stepped_equations(law) -> None:
    t, dq, q, load = motion(10.0, 4)
    level, viscosity = 1.0 + 0.2 * np.sin(t), 1.0 - 0.3 * np.cos(t)
    record = truth(
        law(), t, dq, q, load, noise=0.0, level=lambda _: level, viscosity=lambda _: viscosity
    )
    torque = Factored(law()).compute_torque(record, level, viscosity)
    # The first row begins in a different steady state.
    late = t > 1.0
    np.testing.assert_allclose(torque[late], record.tau[late], atol=1e-9)
    one = np.ones_like(t)
    torque = Factored(law()).compute_torque(record, one, one)
    np.testing.assert_allclose(torque, predict_record(law(), record), rtol=1e-12, atol=1e-12)


def test_measured_temperature_determines_both_coefficients(fitted) -> None:
    known, found = fitted
    [thermal] = known.thermal
    assert thermal == found.thermal
    assert thermal.coulomb == pytest.approx(TRUE.coulomb, rel=0.05)
    assert thermal.viscous == pytest.approx(TRUE.viscous, rel=0.05)
    assert abs(thermal.coulomb - TRUE.coulomb) < 3.0 * found.coulomb_error
    assert abs(thermal.viscous - TRUE.viscous) < 3.0 * found.viscous_error
    assert thermal.resistance == pytest.approx(TRUE.resistance, rel=0.05)
    assert thermal.time_constant == pytest.approx(TRUE.time_constant, rel=0.05)
    assert thermal.ambient == pytest.approx(TRUE.ambient, abs=1.0)
    assert thermal.measured
    assert found.rmse < 0.7 * found.rmse_fixed


def test_the_dependence_is_told_in_percent(fitted, logs, monkeypatch) -> None:
    known, found = fitted
    # Already fitted by the fixture, which takes seconds.
    monkeypatch.setattr(thermal_fit, "fit_thermal", lambda *_: (known, (found,)))
    warm, [told] = thermal_fit.add_temperature(known, logs)
    assert warm is known
    sentence = re.fullmatch(
        r"axis: Coulomb friction falls by (\S+) ± (\S+) % per K, viscous by (\S+) ± (\S+) %; time "
        r"constant (\S+) s; error (\S+) -> (\S+)",
        told.replace(f"{found.joint}:", "axis:"),
    )
    assert sentence
    expected = (
        *(100.0 * found.thermal.coulomb, 200.0 * found.coulomb_error),
        *(100.0 * found.thermal.viscous, 200.0 * found.viscous_error),
        *(found.thermal.time_constant, found.rmse_fixed, found.rmse),
    )
    assert [float(number) for number in sentence.groups()] == pytest.approx(expected, rel=0.4)
    coulomb, _, viscous, _, *rest = map(float, sentence.groups())
    assert (coulomb, viscous) == pytest.approx((expected[0], expected[2]), rel=0.05)
    assert rest == pytest.approx(expected[4:], rel=0.005)


def test_long_logs_determine_heating_alone() -> None:
    long = [[replace(log(lugre(), 900.0, 5), temperature=None)]]
    known, [found] = fit_thermal(model(lugre()), long)
    [thermal] = known.thermal
    assert not thermal.measured
    assert thermal.time_constant == pytest.approx(TRUE.time_constant, rel=0.2)
    # Only the product of b and R is determined; c_0 at ambient absorbs the rest.
    assert thermal.resistance * thermal.viscous == pytest.approx(
        TRUE.resistance * TRUE.viscous, rel=0.15
    )
    assert found.rmse < 0.8 * found.rmse_fixed


def test_a_thermal_law_predicts_a_warm_day(fitted) -> None:
    """Without adaptation: the thermometer suffices, or else the frictional heat."""
    known, _ = fitted
    day = log(stops(), 60.0, 7, start=30.0)
    errors = {}
    for name, own, record in (
        ("fixed", replace(known, thermal=()), day),
        ("thermometer", known, day),
        ("cold", replace(known, thermal=()), replace(log(stops(), 60.0, 7), temperature=None)),
        ("heat", known, replace(log(stops(), 60.0, 7), temperature=None)),
    ):
        [one] = Follower(own).follow([record], adapt=False)
        np.testing.assert_allclose(own.predict([record])[:, 0], one.outputs["tau"], atol=1e-9)
        errors[name] = rmse(one.outputs["tau"] - record.tau)
    assert errors["thermometer"] < 1.02 * WHITE < 0.5 * errors["fixed"]
    # The ambient temperature follows from the cooling between short logs.
    assert errors["heat"] < 1.15 * WHITE < 0.7 * errors["cold"]


def test_a_thermal_model_survives_its_file(fitted, tmp_path: Path) -> None:
    known, _ = fitted
    path = tmp_path / "law.json"
    known.write(path)
    assert FrictionModel.read(path).thermal == known.thermal
    replace(known, thermal=()).write(path)
    assert FrictionModel.read(path).thermal == ()
    assert "thermal" not in path.read_text(encoding="utf-8")


def test_factors_stay_within_their_limits() -> None:
    level, viscosity = TRUE.factors(np.array([-1e6, TRUE.reference, 1e6]))
    np.testing.assert_allclose(level, [1.0 + COULOMB_RANGE, 1.0, 1.0 - COULOMB_RANGE])
    np.testing.assert_allclose(viscosity, np.exp([VISCOUS_RANGE, 0.0, -VISCOUS_RANGE]))


def test_the_temperature_of_factors_stays_within_its_trained_range(fitted, logs) -> None:
    known, found = fitted
    [thermal] = known.thermal
    seen = np.concatenate([of_joint[0].temperature for of_joint in logs])
    assert (
        (thermal.coldest, thermal.warmest)
        == (seen.min(), seen.max())
        == (found.thermal.coldest, found.thermal.warmest)
    )
    day = log(stops(), 20.0, 7, start=30.0)
    for beyond, limit in (
        (thermal.warmest + 20.0, thermal.warmest),
        (thermal.coldest - 20.0, thermal.coldest),
    ):
        torques = [
            known.predict([replace(day, temperature=np.full_like(day.t, temperature))])
            for temperature in (beyond, limit)
        ]
        np.testing.assert_array_equal(*torques)
        assert thermal.factors(np.array([beyond])) == thermal.factors(np.array([limit]))
    # Without a range, as in files of earlier versions, nothing is limited.
    data = known.to_json()
    for limit in ("coldest", "warmest"):
        del data["joints"][0]["thermal"][limit]
    older = FrictionModel.from_json(data, Path("older.json"))
    warm = replace(day, temperature=np.full_like(day.t, thermal.warmest + 20.0))
    assert np.abs(older.predict([warm]) - known.predict([warm])).max() > 0.1


def test_temperatures_beyond_training_are_reported(fitted) -> None:
    [thermal], trained = fitted[0].thermal, TrainedRange.from_records([log(stops(), 20.0, 1)])
    hot = replace(log(stops(), 20.0, 7), temperature=np.full(1000, thermal.warmest + 2.0))
    assert "temperature" not in find_excess(trained, [hot])
    excess = find_excess(trained, [hot], thermal)["temperature"]
    assert (excess.rows, excess.above) == (1.0, pytest.approx(2.0))


@pytest.mark.parametrize("ripple", [(), (200,)])
@pytest.mark.parametrize("adapts", [True, False])
def test_no_thermometer_reading_generates_energy(ripple: tuple[int, ...], adapts: bool) -> None:
    law = stops(ripple=ripple)
    least = find_min_viscous_scale(law)
    own = (
        adaptive_component(law, TUNING, noise=NOISE, speed=SPEED, min_viscosity=least, thermal=TRUE)
        if adapts
        else thermal_component(law, TRUE)
    )
    names = ["tau", "offset", "level", "viscosity"] if adapts else ["tau"]
    values = law.values | {p.name: p.start for p in own.parameters if hasattr(p, "start")}
    values |= {scale.name: 1.0 for scale in own.shared}
    steps = Steps(own, names)
    run = steps.run(values, (0.0, *law.start), [q.name for q in own.inputs])
    factors = find_storage_factors(law)
    k = np.array([factors.get(m.name, 0.0) for m in own.memory])
    rng = np.random.default_rng(2)
    run.begin(*(0.0,) * len(own.inputs))
    offset, stored, given = 0.0, float(k @ np.square(run.states)), 0.0
    ripples = law.values.get("ripple200_cos", 0.0), law.values.get("ripple200_sin", 0.0)
    for _ in range(3000):
        dq, q, load = rng.normal(size=3) * (10.0 ** rng.uniform(-4, 1), 3.0, 30.0)
        dt, warm = 10.0 ** rng.uniform(-6, 1), rng.normal() * 10.0 ** rng.uniform(0, 5)
        adapt = float(rng.random() < 0.9)
        measured = 14.0 * np.sign(dq) + rng.normal() + load
        seen = run.step(dt, dq, q, load, *((measured, load, adapt) if adapts else ()), warm)
        after = float(k @ np.square(run.states))
        torque = seen[0] - offset - law.values["tau_0"]
        given = torque * dq * dt - (after - stored)
        # Ripple may contribute at most its amplitude for one step.
        most = float(np.hypot(*ripples)) * abs(dq) * dt if ripple else 0.0
        assert given >= -1e-9 * max(1.0, abs(torque * dq * dt)) - most
        offset, stored = seen[1] if adapts else 0.0, after
        assert np.all(np.isfinite(seen))


def test_logs_without_thermal_information_are_refused(logs) -> None:
    [first], [second] = logs
    with pytest.raises(FitError, match="temperatures are missing, but other logs"):
        fit_thermal(model(stops()), [[first], [replace(second, temperature=None)]])
    even = replace(first, temperature=np.full_like(first.t, 30.0))
    with pytest.raises(FitError, match="temperature varies by 0 K over"):
        fit_thermal(model(stops()), [[even]])
    short = replace(first, temperature=None)
    with pytest.raises(FitError, match="longest log takes 150 s"):
        fit_thermal(model(stops()), [[short]])
    cold = [
        [replace(log(lugre(), 310.0, 5, replace(TRUE, coulomb=0.0, viscous=0.0)), temperature=None)]
    ]
    with pytest.raises(FitError, match="change as the joint warms up"):
        fit_thermal(model(lugre()), cold)
    coupled = replace(model(stops()), coupling=Coupling(((2.0,),)))
    with pytest.raises(ArtifactError, match="thermal model does not support coupled"):
        replace(coupled, thermal=(TRUE,))
    with pytest.raises(FitError, match="thermal model does not support coupled"):
        fit_thermal(coupled, logs)
    with pytest.raises(ArtifactError, match=r"thermal model: 'time_constant' is 0\.0; expected a"):
        replace(TRUE, time_constant=0.0)
    with pytest.raises(ArtifactError, match="2 thermal models for 1 joints"):
        replace(model(stops()), thermal=(TRUE, TRUE))
