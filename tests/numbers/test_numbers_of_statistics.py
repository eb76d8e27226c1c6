"""Covariances, comparisons, deviations, scores and noise of random data."""

import numpy as np
from joint_data import along, law, path
from unchanged import Unchanged

from hesr.extras.fleet.deviation import deviations, trend
from hesr.extras.leaderboard.board_file import rmse_ratio_interval
from hesr_model.friction.records import score, score_band
from hesr_model.inference.comparison import holm
from hesr_model.inference.covariance import (
    blocks_of_time,
    correlation_length,
    covariance,
    left_out,
    pooled,
    standard_errors,
)
from hesr_model.logs.noise import standard_normal, words
from hesr_model.logs.signals import moving, near_reversals, reversals

RNG = np.random.default_rng(5)
JACOBIAN = RNG.normal(size=(600, 3)) * [1.0, 0.1, 5.0]
RESIDUAL = np.convolve(RNG.normal(size=620), np.ones(21) / 5.0, "valid")


def test_covariances(unchanged: Unchanged) -> None:
    hessian = JACOBIAN.T @ JACOBIAN
    rows = JACOBIAN * left_out(JACOBIAN, RESIDUAL, hessian)[:, None]
    found = {}
    logs = np.arange(600) * 4 // 600
    for name, labels in {"blocks": blocks_of_time(np.zeros(600, int)), "logs": logs}.items():
        count = int(labels.max()) + 1
        shares = [JACOBIAN[labels == k].T @ JACOBIAN[labels == k] for k in range(count)]
        known = np.diag([1.0, 2.0, 3.0])
        found[name] = [
            covariance(("a", "b", "c"), rows, shares, labels),
            covariance(("a", "b", "c"), rows, shares, labels, known=known, carried=JACOBIAN[:2].T),
        ]
    both = [found["blocks"][0], found["logs"][0]]
    unchanged(
        {
            "covariance": found,
            "pooled": pooled(both),
            "errors": standard_errors(JACOBIAN, RESIDUAL),
            "length": correlation_length(RESIDUAL),
        }
    )


def test_comparisons(unchanged: Unchanged) -> None:
    unchanged(
        {
            "holm": holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.5}),
            "deviations": deviations([1.0, 1.1, 0.9, 1.05, 2.0], [0.1, None, 0.1, 0.2, 0.3]),
            "signed": deviations([-1.0, 1.1, 0.9, 1.05, 2.0], [None] * 5),
            "trend": trend([0.0, 1.0, 2.5, 4.0, 7.0], [1.0, 1.2, 1.1, 1.4, 1.9]),
        }
    )


def test_scores(unchanged: Unchanged) -> None:
    truth = law("stribeck", {}, F_c=8.0, F_s=11.0, v_s=0.1, sigma_2=4.0, tau_0=0.5)
    records = [along(truth, path(k, seconds=6.0), noise=0.4, seed=k) for k in range(2)]
    predicted = [0.95 * r.tau + 0.2 * np.sin(3.0 * r.t) for r in records]
    bands = [(p - 0.8, p + 0.7) for p in predicted]
    unchanged(
        {
            "score": score(records, predicted),
            "band": score_band(records, predicted, bands),
            "ratio": rmse_ratio_interval(
                [p - r.tau for p, r in zip(predicted, records, strict=True)],
                [0.3 * r.tau for r in records],
                block=50,
                rng=np.random.default_rng(1),
            ),
            "moving": [np.flatnonzero(moving(r.dq)) for r in records],
            "reversals": [reversals(r.dq) for r in records],
            "near": [np.flatnonzero(near_reversals(r.t, r.dq)) for r in records],
        }
    )


def test_noise(unchanged: Unchanged) -> None:
    counters = np.arange(24)
    upper = (words(7, 3, counters) >> np.uint64(12)).astype(float)
    unchanged({"words": upper, "normal": standard_normal(7, [[1], [2]], counters)}, rtol=1e-12)
