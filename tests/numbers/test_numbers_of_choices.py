"""Search spaces: bounds, grids and limits of every law; motor ripple; scores."""

from dataclasses import replace

import numpy as np
import pytest
import sympy
from joint_data import law
from unchanged import Unchanged

from hesr_model.audit import properties
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.program import Jumps
from hesr_model.fitting import calibration, uncertainty
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import estimator, registry
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction import records as metrics
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.inference import comparison
from hesr_model.laws import ripple
from hesr_model.laws.parfam import trial
from hesr_model.laws.stops import search
from hesr_model.rigid_body import identification, observations, payload
from hesr_model.rigid_body.friction_record import FrictionRecord


def test_search_spaces_of_all_laws(unchanged: Unchanged) -> None:
    found = {}
    for name in registry():
        of = estimator(name)()
        if isinstance(of, OneForm):
            space = of.space()
            symbols = sorted({s for _, e in space.values for s in e.free_symbols}, key=str)
            at = {s: 0.3 + 0.1 * k for k, s in enumerate(symbols)}
            found[name] = {
                "bounds": [list(limits) for _, limits in space.bounds],
                "signed": [len(space.linear), space.non_negative],
                "values": [float(e.subs(at)) for _, e in space.values],
                "start": of.start_samples,
            }
    assert len(found) > 10
    unchanged(found)


def test_limits_of_searches() -> None:
    assert (trial.MEMORY_BOUNDS, trial.REST_SPEED) == ((0.05, 2000.0), 1e-3)
    assert (trial.DIVISOR_LIMIT, trial.MIN_UNIT_GAIN, trial._SEARCH_ROWS) == (0.9, 0.05, 3000)
    assert (search.STRIBECK_SHARES, search.AGEING_TIMES) == ((0.05, 0.1, 0.2, 0.4),) * 2
    assert search.MIN_FORCE_SHARE == 2e-3
    assert (calibration.MIN_RESTS, calibration._MIN_REST_DURATION, calibration._MAX_SHARE_ROWS) == (
        10,
        0.5,
        4000,
    )
    assert calibration._TAIL_RANGE == (0.4, 1.2)
    assert calibration.SLOW_SPEEDS == (0.01, 0.02, 0.04, 0.08, 0.16)
    assert (
        uncertainty.MAX_COEFFICIENTS,
        uncertainty._CURVATURE_WIDTH,
        uncertainty._MIN_CHANGE_RATIO,
    ) == (
        64,
        2.0,
        0.25,
    )
    assert (
        comparison.BIN_SECONDS,
        comparison.SECONDS_PER_DEGREE,
        comparison._TIMES_PER_DEGREE,
    ) == (
        0.05,
        8.0,
        3.0,
    )
    assert (comparison.MIN_DEGREES, comparison.CALIBRATION, comparison.POWER) == (4, 5.0, 0.8)
    assert (payload._SEGMENT_DURATION, payload._MIN_SEGMENTS, payload._MIN_MASS_SIGNIFICANCE) == (
        1.0,
        10,
        4.0,
    )
    assert (observations._MAX_SHIFT, observations._MAX_MISMATCH) == (0.5, 0.1)
    assert (identification.MIN_PEAK_SPEED, identification._MIN_ERROR_SHARE) == (0.02, 1e-2)
    assert (ripple.MAX_ORDERS, ripple.MIN_GAIN, ripple.CHANCE_GAIN, ripple._ATTEMPTS) == (
        6,
        0.002,
        18.0,
        3,
    )
    assert list(ripple.ORDERS) == list(range(1, 17))
    lags, smoothings = (sorted(set(times)) for times in zip(*ripple._TIMES, strict=True))
    np.testing.assert_allclose(lags, np.linspace(0.0, 0.012, 25))
    assert smoothings == [0.0, 1e-3, 2e-3, 4e-3, 8e-3]
    assert len(ripple._TIMES) == 125


def test_expectations_of_laws(unchanged: Unchanged) -> None:
    own = {
        name: value
        for name, value in vars(properties).items()
        if name.isupper() and name[0] != "_" and name not in ("FORMAT", "MARKS")
    }
    unchanged(own)


# --- motor ripple -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def samples(records: list[FrictionRecord]) -> JointRows:
    made = JointRows.from_records(records, coefficients=5)
    turn = 101.0 * (made.q - 0.0032 * made.dq)
    small = 1.0 / (1.0 + (2 * 101.0 * 0.0015 * made.dq) ** 2)
    tau = made.tau + 2.0 * np.cos(2.0 * turn) * small + 1.2 * np.sin(5.0 * turn)
    return replace(made, tau=tau)


def test_motor_ripple(samples: JointRows, unchanged: Unchanged) -> None:
    base = np.stack([np.sign(samples.dq), samples.dq, np.ones_like(samples.dq)], axis=1)
    chosen = ripple.select(base, samples, 101.0, samples.folds)
    assert chosen is not None
    two = ripple.Ripple(gear_ratio=101.0, orders=(2, 5))
    times = ripple._TIMES[::9]
    ranked = ripple._rank_orders(samples, samples.tau - 8.0 * np.sign(samples.dq), two, times)
    smoothings, plain, square = ripple._weights(samples, 101.0, 3, times)
    unchanged({
        "orders": chosen[0].orders, "times": chosen[1],
        "columns": two.columns(samples, (0.003, 0.002))[::61].T.tolist(),
        "ranked": [[order, *at] for order, at in ranked[:6]], "count": len(ranked),
        "smoothings": smoothings, "plain": plain, "square": square,
        "bounds": [ripple.LAG_BOUNDS, ripple.SMOOTHING_BOUNDS],
    }, rtol=1e-6)  # fmt: skip


def test_no_ripple_in_coulomb_friction(records: list[FrictionRecord]) -> None:
    rng = np.random.default_rng(0)
    made = JointRows.from_records(records, coefficients=5)
    made = replace(made, tau=np.sign(made.dq) + rng.normal(size=len(made.dq)))
    base = np.stack([np.sign(made.dq), np.ones_like(made.dq)], axis=1)
    assert ripple.select(base, made, 101.0, made.folds) is None


# --- scores -----------------------------------------------------------------------------------


def test_scores(records: list[FrictionRecord], unchanged: Unchanged) -> None:
    rng = np.random.default_rng(1)
    predicted = [0.9 * r.tau + 0.3 * rng.normal(size=len(r.tau)) for r in records]
    bands = [(p - 1.0 - 0.1 * np.abs(p), p + 0.8) for p in predicted]
    still = [replace(r, dq=0.0 * r.dq, tau=0.0 * r.tau + 1.0) for r in records]
    unchanged({
        "score": metrics.score(records, predicted),
        "band": metrics.score_band(records, predicted, bands),
        "rows": metrics.time_band(np.arange(5.0), 1.0, 3.0),
    })  # fmt: skip
    none = metrics.score(still, [np.ones(len(r.t)) for r in records])
    assert (none.r2, none.rmse, none.rmse_moving) == (None, 0.0, None)
    exact = metrics.score_band(still, [r.tau for r in still], [(r.tau, r.tau) for r in still])
    assert (exact.held, exact.held_moving, exact.width) == (1.0, None, None)


# --- termination of a solver ------------------------------------------------------------------


def test_jumps_ignore_signs_of_coefficients() -> None:
    k = Coefficient(name="k", unit="N.m", description="any")
    output = sgn(DQ) * absolute(k.symbol) + sgn(k.symbol - 1) * DQ + 0.1 * absolute(Q) * DQ
    form = LawForm(coefficients=(k,), output=output)
    assert Jumps(form.component).expressions == (DQ,)
    assert set(Jumps(form.component, all_magnitudes=True).expressions) == {DQ, Q}
    assert Jumps(form.component).signs == (sympy.Symbol("s_1", real=True),)
    stops = law(
        "parfam_s_v", {"stops": [["1", 0]], "viscous": ["v"]}, F_1=1.0, sigma_3=2.0, tau_0=0.0
    )
    assert Jumps(stops.form.component).expressions == (DQ,)
