"""Torque ripple: found if present, with its orders, lag and smoothing, and not otherwise."""

import numpy as np
import pytest
from joint_data import GEAR_RATIO, along, error_on, law, path, training, unseen

from hesr_model.errors import ArtifactError
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.laws import ripple
from hesr_model.laws.lugre import LuGreLoad, LuGreLoadRipple
from hesr_model.laws.ripple import Ripple
from hesr_model.support.typed_files import to_json

LAG, SMOOTHING = 4e-3, 2e-3
CORE = {"sigma_0": 3000.0, "sigma_1": 15.0, "sigma_2": 6.0, "F_c": 9.0, "F_s": 12.0, "v_s": 0.1,
        "tau_0": 0.4, "mu": 0.02}  # fmt: skip
AMPLITUDES = {2: (0.5, -0.3), 8: (0.2, 0.4)}
NOISE = 0.2


def rippling(*orders: int) -> FrictionLaw:
    """LuGre+load with ripple of the given orders."""
    waves = {
        f"ripple{k}_{part}": a
        for k in orders
        for part, a in zip(("cos", "sin"), AMPLITUDES[k], strict=True)
    }
    structure = {"ripple": {"gear_ratio": GEAR_RATIO, "orders": list(orders)}}
    return law("lugre_load_ripple", structure, **CORE, **waves, lag=LAG, smoothing=SMOOTHING)


def samples_of(truth: FrictionLaw, noise: float = NOISE) -> JointRows:
    return JointRows.from_records(
        training(truth, noise=noise, gear_ratio=GEAR_RATIO), coefficients=3
    )


def selected(samples: JointRows) -> tuple[Ripple, ripple.Times] | None:
    """Selection for a law whose other coefficients are known."""
    problem = Separable(LuGreLoad.core({}), LuGreLoad().space(), samples)
    point = problem.point({"deflection": 3e-3, "ratio": 12.0 / 9.0, "v_s": 0.1})
    return ripple.select(problem.columns(point), samples, GEAR_RATIO, samples.folds)


# --- selection --------------------------------------------------------------------------------


def test_generating_orders_lag_and_smoothing_are_found() -> None:
    found = selected(samples_of(rippling(2, 8)))
    assert found is not None
    waves, (lag, smoothing) = found
    assert set(waves.orders) == {2, 8}
    assert waves.gear_ratio == GEAR_RATIO
    assert lag == pytest.approx(LAG, abs=0.6e-3)
    assert smoothing == pytest.approx(SMOOTHING, abs=1.1e-3)


@pytest.mark.parametrize("order", [2, 8])
def test_a_single_order_stays_single(order: int) -> None:
    found = selected(samples_of(rippling(order)))
    assert found is not None
    assert found[0].orders == (order,)


@pytest.mark.parametrize("noise_seed", range(4))
def test_noise_is_not_taken_for_ripple(noise_seed: int) -> None:
    truth = law("lugre_load", {}, **CORE)
    records = [
        along(truth, path(10 + k), noise=0.5, seed=20 * noise_seed + k, gear_ratio=GEAR_RATIO)
        for k in range(2)
    ]
    assert selected(JointRows.from_records(records, coefficients=3)) is None


def test_the_number_of_orders_is_limited() -> None:
    samples = samples_of(rippling(2, 8), noise=0.01)
    angle = GEAR_RATIO * (samples.q - LAG * samples.dq)
    tau = samples.tau + sum(0.5 * np.cos(k * angle) for k in range(1, 17))
    found = selected(JointRows(**(vars(samples) | {"tau": tau})))
    assert found is not None
    assert len(found[0].orders) == len(set(found[0].orders)) == ripple.MAX_ORDERS


# --- the law ----------------------------------------------------------------------------------


def test_a_fit_finds_the_amplitudes_and_improves_unseen_motions() -> None:
    truth = rippling(2, 8)
    records = training(truth, noise=NOISE, gear_ratio=GEAR_RATIO)
    fitted = LuGreLoadRipple().fit(records, np.random.default_rng(0))
    assert {2, 8} <= set(fitted.structure["ripple"]["orders"])
    # An order left over from the earlier bristle fit vanishes in the final polish.
    for name, value in fitted.values.items():
        if name.startswith("ripple"):
            assert value == pytest.approx(truth.values.get(name, 0.0), abs=0.05), name
    assert fitted.values["lag"] == pytest.approx(LAG, abs=0.2e-3)
    assert fitted.values["smoothing"] == pytest.approx(SMOOTHING, abs=0.5e-3)
    plain = LuGreLoad().fit(records, np.random.default_rng(0))
    test = unseen(truth)
    assert error_on(fitted, test) < 0.25 * error_on(plain, test)


def test_without_a_gear_ratio_there_is_no_ripple() -> None:
    records = training(rippling(2, 8), noise=NOISE)
    fitted = LuGreLoadRipple().fit(records, np.random.default_rng(0))
    assert "ripple" not in fitted.structure
    assert [u.name for u in fitted.form.inputs] == ["dq", "tau_load"]


def test_the_extended_form_adds_the_columns_to_the_torque() -> None:
    with_ripple, without = rippling(2, 8), law("lugre_load", {}, **CORE)
    way = path(3)
    record = along(without, way)
    samples = JointRows.from_records([record], coefficients=3)
    waves = Ripple(gear_ratio=GEAR_RATIO, orders=(2, 8))
    amplitudes = [with_ripple.values[name] for name in waves.names]
    added = waves.columns(samples, (LAG, SMOOTHING)) @ amplitudes
    torque = predict(with_ripple, t=way.t, dq=way.dq, q=way.q, tau_load=way.load)
    np.testing.assert_allclose(torque, record.tau + added, rtol=0, atol=1e-10)
    assert np.std(added) > 0.1


def test_the_problem_of_the_extended_form_has_the_same_columns() -> None:
    samples = samples_of(rippling(2, 8))
    waves = Ripple(gear_ratio=GEAR_RATIO, orders=(2, 8))
    plain = Separable(LuGreLoad.core({}), LuGreLoad().space(), samples)
    whole = Separable(waves.extend(plain.form), waves.extend_space(plain.space), samples)
    numbers = {"deflection": 3e-3, "ratio": 1.3, "v_s": 0.1, "lag": LAG, "smoothing": SMOOTHING}
    expected = np.hstack(
        [plain.columns(plain.point(numbers)), waves.columns(samples, (LAG, SMOOTHING))]
    )
    found = whole.columns(whole.point(numbers))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    assert whole.space.linear[-4:] == waves.names


def test_smoothing_keeps_slow_ripple_and_removes_fast_ripple() -> None:
    way = path(0)
    samples = JointRows.from_records([along(law("lugre_load", {}, **CORE), way)], coefficients=3)
    waves = Ripple(gear_ratio=GEAR_RATIO, orders=(8,))
    height = np.hypot(*waves.columns(samples, (0.0, SMOOTHING)).T)
    fast = np.abs(way.dq) > 0.5
    slow = np.abs(way.dq) < 0.02
    assert np.all(height[slow] > 0.99)
    assert np.all(height[fast] < 0.65)
    np.testing.assert_allclose(
        height, 1.0 / (1.0 + (8 * GEAR_RATIO * SMOOTHING * way.dq) ** 2), rtol=1e-12
    )


# --- JSON -------------------------------------------------------------------------------------


def test_a_ripple_survives_json() -> None:
    waves = Ripple(gear_ratio=GEAR_RATIO, orders=(8, 2))
    assert Ripple.from_structure(to_json(waves)) == waves


@pytest.mark.parametrize(
    "data",
    [
        {},
        {"gear_ratio": 101.0},
        {"orders": [2]},
        {"gear_ratio": "many", "orders": [2]},
        {"gear_ratio": 101.0, "orders": 2},
        {"gear_ratio": 101.0, "orders": ["two"]},
        {"gear_ratio": None, "orders": [2]},
        [101.0, 2],
        "2",
    ],
)
def test_invalid_ripple_is_refused(data: object) -> None:
    with pytest.raises(ArtifactError, match=r"^ripple .* needs a number 'gear_ratio'"):
        Ripple.from_structure(data)
    with pytest.raises(ArtifactError, match=r"^ripple"):
        LuGreLoadRipple.form({"ripple": data})
