"""Width of a law's band, by errors on left-out logs and by its covariance.

The estimate without log k, or a block of time of a single log, is one Gauss-Newton step away, so
the errors outside the training data are

    e_k + J_k (H - H_k)^-1 J_k' e_k,    H = sum over logs H_k = J_k' J_k

Their variance is that of the coefficients, extrapolated by `band.shapes`, plus noise, found by
maximum likelihood of normal errors with non-negative shares and scaled to contain 95 % of them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.friction.band import LEVEL, Band, shapes
from hesr_model.friction.inputs import MOVING
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.inference.covariance import blocks_of_time
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

SLOW_SPEEDS = (0.01, 0.02, 0.04, 0.08, 0.16)  # [rad/s] candidates of v_slow
RESTS = 10  # minimum for the width at rest
_LONG = 0.5  # [s] minimum duration below `MOVING`
_LEVELS = (0.8, 0.9, 0.98)  # quantiles that determine the tail, in addition to 95 %
_TAIL = (0.4, 1.2)  # of the exponent
_STEP = 1e-6
_RANK = 1e-10  # relative variance of directions that were not free
_ROUNDS = 100
_ENOUGH = 4000  # rows for the shares; quantiles use all
_NONE = 1e-30


def calibrate_band(
    law: FrictionLaw, records: Sequence[FrictionRecord]
) -> tuple[FrictionLaw, float | None]:
    """Return the law with its band, and its left-out RMSE [N.m]; itself and None if not finite."""
    errors, certain = _cross_validate_band(law, records)
    if not np.all(np.isfinite(errors) & np.isfinite(certain)):
        return law, None
    dq, load = (
        np.concatenate([getattr(record, name) for record in records]) for name in ("dq", "tau_load")
    )
    seen = sum(_rests(record) for record in records) >= RESTS
    some = slice(None, None, -(-len(errors) // _ENOUGH))
    squares = errors[some] ** 2
    best = (np.inf, SLOW_SPEEDS[0], np.zeros(5))
    for speed in SLOW_SPEEDS:
        columns = np.stack(shapes(dq[some], load[some], speed), axis=1)
        if not seen:
            columns[:, 2] = 0.0
        known = variance_shares(columns, certain[some], np.zeros_like(squares))
        found = known + variance_shares(columns, squares, columns @ known)
        variance = columns @ found + _NONE
        loss = float(np.mean(np.log(variance) + squares / variance))
        if loss < best[0]:
            best = (loss, speed, found)
    _, speed, found = best
    variance = np.stack(shapes(dq, load, speed), axis=1) @ found
    standard = np.abs(errors) / np.sqrt(variance + _NONE)
    at_level = float(np.quantile(standard, LEVEL))
    floor, slow, rest, fast, share = map(float, at_level * np.sqrt(found))
    band = Band(
        floor=floor,
        slow=slow,
        slow_speed=speed,
        rest=rest,
        fast=fast,
        load=share,
        tail=_tail(standard, at_level),
        envelope=0.0 if seen else 1.0,
    )
    return replace(law, band=band), float(np.sqrt(np.mean(errors**2)))


def _cross_validate_band(
    law: FrictionLaw, records: Sequence[FrictionRecord]
) -> tuple[Array, Array]:
    """Return the (N,) errors of fits without the row's log, and their predicted variance."""
    errors = np.concatenate([record.tau for record in records]) - _predicted(law, records)
    if law.covariance is None:
        return errors, np.zeros_like(errors)
    jacobian = _sensitivities(law, records)
    labels = blocks_of_time(log_of_rows(records))
    hessian = jacobian.T @ jacobian
    found = errors.copy()
    for k in range(int(labels[-1]) + 1):
        rows = labels == k
        own = jacobian[rows]
        rest = np.linalg.pinv(hessian - own.T @ own, hermitian=True, rcond=_RANK)
        found[rows] += own @ (rest @ (own.T @ errors[rows]))
    return found, np.sum(jacobian**2, axis=1)


def _sensitivities(law: FrictionLaw, records: Sequence[FrictionRecord]) -> Array:
    """Return the changes of torque (N, r) [N.m] by one standard deviation of independent errors."""
    covariance = law.covariance
    assert covariance is not None
    deviations = np.sqrt(np.maximum(np.diag(covariance.matrix), _NONE))
    sizes, ways = np.linalg.eigh(covariance.matrix / np.outer(deviations, deviations))
    free = sizes > _RANK * max(float(sizes[-1]), _NONE)
    ways = deviations[:, None] * ways[:, free] * np.sqrt(sizes[free])
    columns = []
    for name in covariance.names:
        value = law.values[name]
        step = min(_STEP * max(abs(value), 1e-3), 0.5 * abs(value)) if value else _STEP * 1e-3
        after, before = (
            _predicted(replace(law, values={**law.values, name: moved}), records)
            for moved in (value + step, value - step)
        )
        columns.append((after - before) / (2.0 * step))
    return np.asarray(np.stack(columns, axis=1) @ ways)


def _predicted(law: FrictionLaw, records: Sequence[FrictionRecord]) -> Array:
    return np.concatenate([predict_record(law, record) for record in records])


def variance_shares(columns: Array, squares: Array, known: Array) -> Array:
    """Return the non-negative shares (B,) of shapes (N, B) in the variance beyond `known` (N,)."""
    mean = columns.mean(axis=0)
    found = np.where(mean > 0.0, squares.mean() / (columns.shape[1] * np.maximum(mean, _NONE)), 0.0)
    for _ in range(_ROUNDS if squares.any() else 0):
        variance = columns @ found + known + _NONE
        gain = columns.T @ (squares / variance**2)
        cost = columns.T @ (1.0 / variance)
        found = found * np.sqrt(gain / np.maximum(cost, _NONE))
    return np.asarray(found)


def _rests(record: FrictionRecord) -> int:
    slow = np.concatenate([[False], np.abs(record.dq) < MOVING, [False]])
    begins = np.flatnonzero(slow[1:] & ~slow[:-1])
    ends = np.flatnonzero(~slow[1:] & slow[:-1])
    return int(np.count_nonzero(record.t[ends - 1] - record.t[begins] >= _LONG))


def _tail(standard: Array, at_level: float) -> float:
    sizes = np.quantile(standard, _LEVELS)
    if not (at_level > 0.0 and sizes[0] > 0.0):
        return 0.65
    x = np.log(np.log1p(-np.array(_LEVELS)) / np.log1p(-LEVEL))
    y = np.log(sizes / at_level)
    return float(np.clip(x @ y / (x @ x), *_TAIL))
