"""ParFam-S: structures, search and passivity."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.audit.certificate import certify
from hesr_model.errors import ArtifactError
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import (
    JointRows,
    NormalEquations,
    divide_into_blocks,
    has_significant_gain,
    signed_least_squares,
)
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.stops import form
from hesr_model.laws.stops.estimator import ParFamS
from hesr_model.laws.stops.form import BOUNDS, Structure
from hesr_model.laws.stops.search import (
    AGEING_TIMES,
    build_dictionary,
    find_largest_age,
    search,
    select_ageing_times,
    weights,
)
from hesr_model.rigid_body.friction_record import FrictionRecord

RIPPLE = 200
"""Frequencies of the ripple [1/rad]: two turns of a motor at 100, one fewer than at 101."""


def record(log: str, seed: int, *, ripple: float = 0.0) -> FrictionRecord:
    """Stops, the widest scaled by the load, degressive viscous friction and ripple."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(3000)
    phases = rng.uniform(0.0, 2.0 * np.pi, 4)
    dq = np.sin(np.outer(t, [0.6, 1.1, 1.9, 2.6]) + phases) @ [0.3, 0.3, 0.25, 0.15]
    q = np.cumsum(dq) * 0.01
    load = 15.0 * np.sin(q) + 5.0
    x, stuck = np.zeros(2), []
    bounds = np.stack([np.ones_like(q), np.abs(load) / 20.0], axis=1)
    for v, s in zip(dq, bounds, strict=True):
        x = np.clip(x + v * 0.01 / np.array([1e-4, 1e-3]), -s, s)
        stuck.append([3.0, 4.0] @ x)
    tau = np.array(stuck) + 20.0 * dq / (1.0 + np.abs(dq) / 0.1) + 0.2
    tau += ripple * np.cos(RIPPLE * (q - 0.003 * dq)) + 0.1 * rng.normal(size=len(t))
    return FrictionRecord(
        log=log, joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=101.0
    )


@pytest.fixture(scope="module")
def plain() -> list[FrictionRecord]:
    return [record("one", 0), record("two", 1)]


@pytest.fixture(scope="module")
def rippled() -> list[FrictionRecord]:
    return [record("one", 0, ripple=0.5), record("two", 1, ripple=0.5)]


@pytest.fixture(scope="module")
def law(rippled: list[FrictionRecord]) -> FrictionLaw:
    return fit_joint("parfam_s", rippled, seed=0)


def error(law: FrictionLaw, data: FrictionRecord) -> float:
    found = predict(law, t=data.t, dq=data.dq, q=data.q, tau_load=data.tau_load)
    return rmse(found[300:] - data.tau[300:])


# --- fit --------------------------------------------------------------------------------------


def test_true_terms_are_found(law: FrictionLaw) -> None:
    assert error(law, record("three", 2, ripple=0.5)) < 0.12
    assert law.structure["ripple"] == [RIPPLE]
    assert law.values["lag"] == pytest.approx(0.003, abs=2e-4)
    assert any(bound == "load" for bound, _ in law.structure["stops"])


def test_ripple_has_to_pay(plain: list[FrictionRecord]) -> None:
    found = fit_joint("parfam_s", plain, seed=0)
    assert found.structure["ripple"] == []
    assert error(found, record("three", 2)) < 0.12


def test_forces_and_viscous_friction_are_not_negative(law: FrictionLaw) -> None:
    structure = Structure.from_json(law.structure)
    assert all(law.values[name] >= 0.0 for name in structure.forces)


def test_load_dependent_friction_needs_more_than_velocity(plain: list[FrictionRecord]) -> None:
    alone, loaded = (fit_joint(name, plain, seed=0) for name in ("parfam_s_v", "parfam_s_load"))
    assert error(alone, record("three", 2)) > 3.0 * error(loaded, record("three", 2))
    assert [u.name for u in alone.form.inputs] == ["dq"]


@pytest.mark.parametrize("load", [False, True])
def test_the_search_is_no_worse_than_the_dictionary(
    plain: list[FrictionRecord], load: bool
) -> None:
    baseline = build_dictionary(JointRows.from_records(plain, coefficients=20), load=load)
    found = search(baseline, load=load)
    # Both may find the same forces, in another order of sums.
    assert found.cost <= baseline.cost * (1.0 + 1e-12)
    assert ("load" in found.bounds) == load


def test_rows_with_an_unknown_start_are_left_out(plain: list[FrictionRecord]) -> None:
    held = [replace(r, tau=np.where(np.arange(len(r.tau)) < 2, 50.0, r.tau)) for r in plain]
    assert fit_joint("parfam_s", held, seed=0).values == fit_joint("parfam_s", plain, seed=0).values


# --- signed least squares ---------------------------------------------------------------------


def test_signed_least_squares_equals_scipy() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=(200, 6))
    y = a @ [1.0, -2.0, 0.5, -0.1, -3.0, 2.0]
    found = signed_least_squares(a.T @ a, a.T @ y, 2)
    assert np.all(found[:4] >= 0.0)
    gradient = a.T @ (a @ found - y)
    assert np.all(gradient[:4] >= -1e-4)
    np.testing.assert_allclose(gradient[:4] * found[:4], 0.0, atol=1e-4)
    np.testing.assert_allclose(gradient[4:], 0.0, atol=1e-4)


def test_left_out_errors_match_fits_without_the_fold() -> None:
    rng = np.random.default_rng(1)
    a, y = rng.normal(size=(90, 3)), rng.normal(size=90)
    folds = [np.arange(90) // 30 == k for k in range(3)]
    found = NormalEquations.from_columns(a, y, folds, np.ones(90), free=3).cross_validate()
    for fold in folds:
        x = np.linalg.lstsq(a[~fold], y[~fold])[0]
        np.testing.assert_allclose(found[fold], a[fold] @ x - y[fold], atol=1e-7)


def test_a_gain_must_exceed_its_error() -> None:
    blocks = divide_into_blocks(np.full(800, 0.1), np.arange(800) == 0)
    assert len(np.unique(blocks)) == 10
    before = np.ones(800)
    assert has_significant_gain(before, 0.9 * before, blocks)
    assert not has_significant_gain(before, np.where(blocks == 0, 0.0, 1.0), blocks)
    assert not has_significant_gain(before, before, blocks)


# --- passivity of ripple ----------------------------------------------------------------------


def test_the_mean_distance_matches_numerical_integration() -> None:
    for lag, window in ((0.0, 0.01), (0.003, 0.01), (0.02, 0.01), (0.004, 0.0)):
        steps = np.linspace(0.0, window, 101)[1:] if window else [1e-9]
        means = [np.abs(lag - h * (np.arange(2000) + 0.5) / 2000).mean() for h in steps]
        assert form.distance(lag, window) == pytest.approx(max(lag, *means), rel=1e-3)


def test_viscous_friction_bounds_the_ripple() -> None:
    """The constrained fit is the best of all that meet the constraint."""
    rng = np.random.default_rng(2)
    v = rng.uniform(-1.0, 1.0, 3000)
    phase = 200 * rng.uniform(0.0, 1.0, 3000)
    a = np.stack([v, np.cos(phase), np.sin(phase)], axis=1)
    y = 1.0 * v + 2.0 * np.cos(phase) + 1.0 * np.sin(phase)
    gram, moment = a.T @ a, a.T @ y
    viscous, waves = (
        np.ones((len(form.SPEEDS), 1)),
        form.compute_required_viscosity([200], 0.01, 0.0),
    )
    free = signed_least_squares(gram, moment, 2)
    found = form.constrain_coefficients(gram, moment, free, viscous, waves, free=2)
    size = float(np.hypot(found[1], found[2]))
    margin = found[0] - waves[:, 0] * size
    assert margin.min() == pytest.approx(0.0, abs=1e-6)
    assert found[1] / found[2] == pytest.approx(2.0, rel=0.05)

    def cost(x: np.ndarray) -> float:
        return float(np.sum((a @ x - y) ** 2))

    for scale in (0.99, 1.01):  # along the constraint
        assert cost(found) < cost(found * scale)
    # An inactive constraint changes nothing.
    eased = form.constrain_coefficients(gram, moment, free, 1e3 * viscous, waves, free=2)
    np.testing.assert_array_equal(eased, free)


@pytest.mark.parametrize("dt", [1e-4, 0.01, 0.3])
def test_no_step_generates_energy(law: FrictionLaw, dt: float) -> None:
    """tau dq >= dS in every step, also with a jumping load; tau without its offset."""
    rng = np.random.default_rng(3)
    n = 4000
    v = rng.normal(size=n) * np.exp(rng.uniform(-9.0, 2.0, n))
    t, q = dt * np.arange(n), np.cumsum(v * dt)
    load = 30.0 * rng.normal(size=n)
    tau = predict(law, t=t, dq=v, q=q, tau_load=load) - law.values["tau_0"]
    # The least possible remaining energy is subtracted from that stored in stops and ripple.
    structure = Structure.from_json(law.structure)
    w = np.geomspace(3e-5, 1e-2, 9)
    bound = max(1.0, float(np.abs(load).max()) / law.values["load_scale"])
    stored = sum(
        law.values[name] * w[node] * bound**2 / 2.0
        for name, (_, node) in zip(structure.forces, structure.stops, strict=False)
    )
    stored += 2.0 * sum(
        np.hypot(law.values[f"ripple{k}_cos"], law.values[f"ripple{k}_sin"]) / k
        for k in structure.ripple
    )
    assert np.cumsum(tau[1:] * v[1:] * dt).min() > -stored


# --- structures -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("structure", "said"),
    [
        ({"stops": [["2", 0]]}, "stop ['2', 0] is unknown"),
        ({"stops": [["1", 27]]}, "a number from 0 to 26."),
        ({"viscous": ["z"]}, "viscous term 'z' is unknown"),
        ({"ripple": [0]}, "is invalid for ParFam-S"),
        ({"order": 1}, "is invalid for ParFam-S"),
    ],
)
def test_other_structures_are_refused(structure: dict[str, object], said: str) -> None:
    with pytest.raises(ArtifactError) as caught:
        ParFamS.form(structure)
    assert said in str(caught.value)


def test_no_bound_is_negative() -> None:
    limited = Structure(stops=tuple((kind, 0) for kind in BOUNDS), limited=True).form().stops
    for bound in (*BOUNDS.values(), *(stop.bound for stop in limited)):
        for load in (-3.0, 0.0, 2.0):
            for most in (-1.0, 0.2, 0.9):
                at = {"tau_load": load, "load_scale": 2.0, "p": 0.3, "P": most}
                assert bound.subs({s: at[s.name] for s in bound.free_symbols}) >= 0


def test_the_load_of_bounds_stays_within_its_trained_range() -> None:
    trained = [record("one", 0), record("two", 1)]
    law = fit_joint("parfam_s_load", trained, seed=0)
    largest = max(float(np.abs(r.tau_load).max()) for r in trained)
    assert (law.structure["limited"], law.values["load_scale"]) == (True, largest)
    assert certify(law, TrainedRange.from_records(trained)).verdict == "proven"
    free = {k: v for k, v in law.structure.items() if k != "limited"}  # as in older files
    older = replace(law, structure=free, form=ParFamS.form(free))
    for r in trained:
        np.testing.assert_array_equal(predict(law, **r.motion), predict(older, **r.motion))
    new = record("three", 2)
    heavy, heaviest = (replace(new, tau_load=np.full_like(new.t, f * largest)) for f in (1.5, 3.0))
    np.testing.assert_array_equal(predict(law, **heavy.motion), predict(law, **heaviest.motion))
    assert (
        np.abs(predict(older, **heaviest.motion)).max()
        > 1.5 * np.abs(predict(law, **heaviest.motion)).max()
    )


def broken_away() -> FrictionRecord:
    """A rest that is longer than any in training, then motion."""
    return replace(record("rest", 5), dq=np.where(np.arange(3000) < 2900, 0.0, 0.5))


def test_rows_with_an_unknown_age_are_left_out(plain: list[FrictionRecord]) -> None:
    samples = JointRows.from_records(plain, coefficients=1)
    since = np.concatenate([r.t - r.t[0] for r in plain])
    without, counted = weights(samples), weights(samples, 0.4)
    np.testing.assert_array_equal(counted, without * (since > 1.205))
    assert without[since < 1.2].any()
    short = replace(plain[0], dq=0.0 * plain[0].dq, q=0.0 * plain[0].q)  # it never moves
    assert weights(JointRows.from_records([*plain, short], coefficients=1), 0.4)[-2000:].all()


def test_ageing_times_fit_into_the_left_out_parts(plain: list[FrictionRecord]) -> None:
    def tried(duration: float) -> tuple[float, ...]:
        rows = plain[0].rows(slice(round(duration / 0.01)))
        return select_ageing_times(JointRows.from_records([rows], coefficients=1))

    assert tried(2.0) == ()
    assert tried(8.0) == (0.05, 0.1)
    assert tried(30.0) == AGEING_TIMES


def test_the_age_stays_within_its_trained_range() -> None:
    trained = [record("one", 0), record("two", 1)]
    samples = JointRows.from_records(trained, coefficients=20)
    age = 1.0 - np.exp(-0.05 / 0.4)
    best = build_dictionary(samples, load=False).replace_age(0.2, 0.4)
    assert best.numbers["P"] == find_largest_age(samples, best.weights, 0.2, 0.4)
    form = ParFamS.form({"stops": [["age", 4]]})
    values = {"F_age_5": 2.0, "tau_0": 0.0, "v_s": 0.2, "T": 0.4, "P": age}
    law = FrictionLaw(name="parfam_s", structure={"stops": [["age", 4]]}, form=form, values=values)
    assert np.abs(predict(law, **broken_away().motion)).max() == pytest.approx(2.0 * age)
