"""Stops, ripple and networks: intermediate steps of their fits."""

from dataclasses import replace

import numpy as np
import pytest
from unchanged import Unchanged

from hesr.extras.laws import mlp
from hesr.extras.laws.mlp import train_path as trained_along
from hesr_model.fitting.joint_rows import (
    JointRows,
    NormalEquations,
    divide_into_blocks,
    has_significant_gain,
    non_negative_least_squares,
    signed_least_squares,
)
from hesr_model.fitting.separable import left_out_cost
from hesr_model.laws import rbfnn
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.rbfnn import NetworkInputs, find_candidates
from hesr_model.laws.stops import estimator, form
from hesr_model.laws.stops import search as terms
from hesr_model.laws.stops.estimator import ParFamS
from hesr_model.laws.stops.form import Structure, evaluate_viscous
from hesr_model.laws.stops.search import build_dictionary, search
from hesr_model.rigid_body.friction_record import FrictionRecord

WHOLE = Structure(
    stops=(("1", 0), ("p", 1), ("load", 2), ("root", 3), ("plus", 4), ("minus", 5)),
    viscous=("1", "v", "a", "b", "c"), ripple=(101, 203), window=0.01,
)  # fmt: skip
NUMBERS = {
    "v_s": 0.1,
    "T": 0.2,
    "load_scale": 20.0,
    "lag": 0.003,
    "v_a": 0.05,
    "v_b": 0.2,
    "v_c": 0.6,
}


def rippled(record: FrictionRecord) -> FrictionRecord:
    turned = record.q - 0.003 * record.dq
    return replace(
        record, tau=record.tau + 1.5 * np.cos(101.0 * turned) + 0.8 * np.sin(203.0 * turned)
    )


@pytest.fixture(scope="module")
def samples(records: list[FrictionRecord]) -> JointRows:
    return JointRows.from_records([rippled(r) for r in records], coefficients=20)


# --- stops ------------------------------------------------------------------------------------


def test_columns_of_all_terms(samples: JointRows, unchanged: Unchanged) -> None:
    columns = terms.columns(WHOLE, NUMBERS, samples)
    moved = samples.q * np.where(samples.log_index == 0, 0.01, 1.0)
    unchanged(
        {
            "columns": columns[5::61].T.tolist(),
            "fixed": terms.derive_scales(samples),
            "weights": terms.weights(samples).sum(),
            "of little motion": terms.weights(replace(samples, q=moved)).sum(),
            "viscous": evaluate_viscous(WHOLE, NUMBERS, np.geomspace(1e-3, 10.0, 7)),
        }
    )  # fmt: skip


def test_unloaded_joints_have_a_scale(samples: JointRows) -> None:
    found = terms.derive_scales(replace(samples, tau_load=np.zeros_like(samples.tau)))
    assert found["load_scale"] == 1.0


@pytest.mark.parametrize("load", [False, True])
def test_the_search_of_stops(load: bool, samples: JointRows, unchanged: Unchanged) -> None:
    baseline = build_dictionary(samples, load=load)
    best = search(baseline, load=load)
    structure, columns = best.select_active()
    found = {"baseline": baseline.cost, "best": best.cost, "numbers": best.numbers}
    found |= {
        "stops": [node for _, node in structure.stops],
        "viscous": [sum(map(ord, kind)) for kind in structure.viscous],
        "solved": best.normal.solve(),
        "columns": columns.sum(axis=0),
    }
    unchanged(found, rtol=1e-3, atol=1e-6)


def test_ripple_with_columns(samples: JointRows, unchanged: Unchanged) -> None:
    base = np.stack([np.sign(samples.dq), samples.dq, np.ones_like(samples.dq)], axis=1)
    weights = terms.weights(samples)
    problem = estimator._Problem(base=base, rows=samples, weights=weights)
    chosen = estimator.select_waves(base, samples, weights, 101.0)
    two = estimator.Waves(frequencies=(101, 203), lag=0.002)
    first = estimator._add_best_wave(problem, estimator.Waves(frequencies=(), lag=0.0), 101.0)
    second = estimator._add_best_wave(
        problem, estimator.Waves(frequencies=(101,), lag=0.002), 101.0
    )
    unchanged(
        {
            "chosen": chosen, "first": first, "second": second,
            "phase": problem.align_phase(two, reach=0.004),
            "near": problem.align_phase(replace(two, lag=0.0), reach=0.001),
            "left": problem.cross_validate(two), "residual": problem.residual(two),
            "waves": estimator.waves((101, 203), 0.003, samples)[::97].tolist(),
        },
        rtol=1e-4, atol=1e-6,
    )  # fmt: skip


def test_ripple_candidates() -> None:
    assert list(estimator.ORDERS) == list(range(1, 17))
    np.testing.assert_allclose(estimator.LAGS, np.linspace(0.0, 0.012, 25), atol=1e-12)
    assert (estimator.NEAR_MULTIPLE, estimator.MAX_FREQUENCIES, estimator.MIN_GAIN) == (3, 6, 0.002)


def test_bounded_ripple(unchanged: Unchanged) -> None:
    rng = np.random.default_rng(2)
    v = rng.uniform(-1.0, 1.0, 400)
    phase = 200.0 * rng.uniform(0.0, 1.0, 400)
    a = np.stack(
        [
            np.sign(v),
            v,
            v * np.abs(v),
            np.ones(400),
            np.cos(phase),
            np.sin(phase),
            np.cos(2.0 * phase),
            np.sin(2.0 * phase),
        ],
        axis=1,
    )
    y = a @ [1.0, 0.8, 0.1, 0.2, 2.0, 1.0, 0.3, -0.2] + 0.05 * rng.normal(size=400)
    gram, moment = a.T @ a, a.T @ y
    x = signed_least_squares(gram, moment, 5)
    speeds = form.SPEEDS
    viscous = np.stack([np.ones_like(speeds), speeds], axis=1)
    need = form.compute_required_viscosity([200, 400], 0.006, 0.002)
    unchanged(
        {
            "free": x, "need": need[::10].T.tolist(),
            "found": form.constrain_coefficients(gram, moment, x, viscous, need, free=5),
            "distances": [form.distance(lag, window) for lag in (-0.001, 0.0, 0.001, 0.01, 0.02)
                          for window in (0.0, 0.01, 0.02)],
        },
        rtol=1e-4,
    )  # fmt: skip


# --- least squares ----------------------------------------------------------------------------


def test_least_squares_with_signs(samples: JointRows, unchanged: Unchanged) -> None:
    rng = np.random.default_rng(3)
    a = rng.normal(size=(len(samples.tau), 6)) * np.geomspace(1e-3, 1e3, 6)
    y = a @ [3.0, -2.0, 0.5, -1.0, 1.0, -1.0]
    y = y / y.std() + 0.3 * rng.normal(size=len(y))
    weights = terms.weights(samples)
    normal = NormalEquations.from_columns(a, y, samples.folds, weights, free=2)
    left = normal.cross_validate()
    blocks = divide_into_blocks(samples.dt, samples.begins)
    unchanged(
        {
            "solved": normal.solve() * np.geomspace(1e-3, 1e3, 6), "left out": left,
            "one by one": non_negative_least_squares(a, y, non_negative=4),
            "of folds": left_out_cost(a, y, samples.folds),
            "blocks": blocks, "short": divide_into_blocks(samples.dt, samples.begins, 0.5),
            "few": divide_into_blocks(samples.dt, samples.begins, min_blocks=3),
        },
        rtol=1e-5,
    )  # fmt: skip


def test_a_gain_must_exceed_one_standard_error() -> None:
    blocks = np.repeat(np.arange(4), 2)
    before = np.ones(8)
    gains = np.array([3.0, -1.0, 3.0, -1.0])  # mean 1, standard error of their sum 2 s
    error = 2.0 * gains.std(ddof=1)
    for size, wanted in ((1.001, True), (0.999, False)):
        more = gains - gains.mean() + size * error / 4.0
        after = np.sqrt(before**2 + 10.0 - np.repeat(more, 2) / 2.0)
        assert has_significant_gain(np.sqrt(before**2 + 10.0), after, blocks) == wanted
    assert not has_significant_gain(before, 0.0 * before, np.zeros(8, int))


# --- networks ---------------------------------------------------------------------------------


def test_trained_networks(exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    inputs = NetworkInputs.from_features(exact, Cell(alpha=12.0, beta=25.0, cost=0.0))
    y = (exact.rows.tau - exact.rows.tau.mean()) / exact.rows.tau.std()
    start = np.random.default_rng(0).normal(size=(4, 3))
    networks = trained_along(inputs.z[::3], y[::3], start, (1e-2, 1e-3, 1e-4))
    best = find_candidates(exact, 3)
    unchanged(
        {
            "mean": inputs.mean, "spread": inputs.spread, "z": inputs.z,
            "networks": networks,
            "cells": [[i.cell.alpha, i.cell.beta, i.cell.cost] for i in best],
            "law": mlp.MlpH()._build_network_law(inputs, networks[0], 2.0, 3.0).values,
        },
        rtol=1e-4, atol=1e-7,
    )  # fmt: skip


def test_steps_of_training(exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    inputs = NetworkInputs.from_features(exact, Cell(alpha=12.0, beta=25.0, cost=0.0))
    y = (exact.rows.tau - 1.0) / 8.0
    start = np.random.default_rng(0).normal(size=(4, 3))
    left = mlp.cross_validate(inputs.z[::4], y[::4], [f[::4] for f in exact.rows.folds], [start])
    unchanged({"left out": left, "decays": mlp.DECAYS, "rows": mlp.SEARCHED_ROWS}, rtol=1e-3)


def test_weights_of_gaussians(exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    inputs = NetworkInputs.from_features(exact, Cell(alpha=12.0, beta=25.0, cost=0.0))
    centres, spacing = rbfnn.cluster_centres(inputs.z, 5, np.random.default_rng(0))
    columns = rbfnn.gaussians(inputs.z, centres, 1.5 * spacing)
    bias, weights = rbfnn.ridge_weights(columns, exact.rows.tau, (1e-6, 1e-3, 1e-1))
    left = rbfnn.cross_validate(inputs.z, exact.rows, 4, np.random.default_rng(1))
    of = rbfnn.RbfnnH()._law(inputs, centres, 1.5 * spacing, float(bias[1]), weights[:, 1])
    unchanged(
        {
            "centres": centres, "spacing": spacing, "columns": columns, "bias": bias,
            "weights": weights, "left out": left, "law": of.values,
            "factors": rbfnn.WIDTH_FACTORS, "ridges": rbfnn.RIDGES,
        },
        rtol=1e-4,
    )  # fmt: skip


def test_a_law_with_one_lag(records: list[FrictionRecord], unchanged: Unchanged) -> None:
    more = [rippled(record) for record in records]
    found = ParFamS().fit(more, np.random.default_rng(0))
    bare = ParFamS(skeleton_only=True).fit(more, np.random.default_rng(0))
    unchanged({"found": found.values, "bare": bare.values, "start": found.start}, rtol=1e-3)
