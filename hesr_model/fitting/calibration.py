"""Width of a law's band, by errors on left-out logs and by its covariance.

The estimate without log k, or a block of time of a single log, is one Gauss-Newton step away, so
the errors outside the training data are

    e_k + J_k (H - H_k)^-1 J_k' e_k,    H = sum over logs H_k = J_k' J_k

Their variance is that of the coefficients, extrapolated by `band.shapes`, plus noise, found by
maximum likelihood of normal errors with non-negative shares and scaled to contain 95 % of them.
Where errors on rows are known that the rigid body was not identified from either, they decide the
scale (`recalibrate_band`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.friction.band import LEVEL, REST, Band, find_rest_speed, shapes
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.inference.covariance import blocks_of_time
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.arrays import Array

SLOW_SPEEDS = (0.01, 0.02, 0.04, 0.08, 0.16)  # [rad/s] candidates of v_slow, of usual joints
MIN_RESTS = 10  # minimum for the width at rest
_MIN_REST_DURATION = 0.5  # [s] minimum duration of a rest
_TAIL_LEVELS = (0.8, 0.9, 0.98)  # quantiles that determine the tail, in addition to 95 %
_TAIL_RANGE = (0.4, 1.2)  # of the exponent
_DIFFERENCE_STEP = 1e-6  # relative
_MIN_COEFFICIENT_SIZE = 1e-3  # [its unit] for the step of a small coefficient
_MIN_RELATIVE_VARIANCE = 1e-10  # relative variance of directions that were not free
_SHARE_ROUNDS = 100
_MAX_SHARE_ROWS = 4000  # rows for the shares; quantiles use all
_TINY_VARIANCE = 1e-30
_MIN_LEFT_OUT_ROWS = 100  # for a quantile of 95 %
_SIZE_NAMES = ("floor", "slow", "rest", "fast", "load")  # in the order of `shapes`
_REST_COLUMN = _SIZE_NAMES.index("rest")


def calibrate_band(
    law: FrictionLaw, joint_records: Sequence[FrictionRecord]
) -> tuple[FrictionLaw, float | None]:
    """Return the law with its band, and its left-out RMSE [N.m]; itself and None if not finite."""
    errors, predicted_variance = _cross_validate_band(law, joint_records)
    if not np.all(np.isfinite(errors) & np.isfinite(predicted_variance)):
        return law, None
    dq = np.concatenate([record.dq for record in joint_records])
    tau_load = np.concatenate([record.tau_load for record in joint_records])
    resting_speed = find_resting_speed(joint_records)
    rest_count = sum(_count_rests(record, resting_speed) for record in joint_records)
    has_rests = rest_count >= MIN_RESTS
    share_rows = slice(None, None, -(-len(errors) // _MAX_SHARE_ROWS))
    squares = errors[share_rows] ** 2
    rest_speed = find_rest_speed(law.form.steady_speed)
    slow_speeds = [speed * (rest_speed / REST) for speed in SLOW_SPEEDS]
    slow_speed = slow_speeds[0]
    shares = np.zeros(len(_SIZE_NAMES))
    lowest_loss = np.inf
    for speed in slow_speeds:
        columns = np.stack(shapes(dq[share_rows], tau_load[share_rows], speed, rest_speed), axis=1)
        if not has_rests:
            columns[:, _REST_COLUMN] = 0.0
        candidate_shares, loss = _fit_total_shares(columns, squares, predicted_variance[share_rows])
        if loss < lowest_loss:
            slow_speed = speed
            shares = candidate_shares
            lowest_loss = loss
    variance = np.stack(shapes(dq, tau_load, slow_speed, rest_speed), axis=1) @ shares
    standardised = np.abs(errors) / np.sqrt(variance + _TINY_VARIANCE)
    level_quantile = float(np.quantile(standardised, LEVEL))
    floor, slow, rest_width, fast, load_share = map(float, level_quantile * np.sqrt(shares))
    band = Band(
        floor=floor,
        slow=slow,
        slow_speed=slow_speed,
        rest=rest_width,
        fast=fast,
        load=load_share,
        tail=_fit_tail(standardised, level_quantile),
        envelope=0.0 if has_rests else 1.0,
    )
    return replace(law, band=band), float(np.sqrt(np.mean(errors**2)))


def _fit_total_shares(
    columns: Array, squares: Array, predicted_variance: Array
) -> tuple[Array, float]:
    """Return shares of shapes (N, B) in the variance of errors, and their loss.

    First the shapes follow the variance of the coefficients, (N,), then they add what squared
    errors, (N,), exceed it by. The loss is the mean of twice the negative logarithm of the
    likelihood of normal errors, without its constant.
    """
    coefficient_shares = fit_variance_shares(columns, predicted_variance, np.zeros_like(squares))
    noise_shares = fit_variance_shares(columns, squares, columns @ coefficient_shares)
    shares = coefficient_shares + noise_shares
    variance = columns @ shares + _TINY_VARIANCE
    return shares, float(np.mean(np.log(variance) + squares / variance))


def recalibrate_band(
    band: Band, dq: Array, tau_load: Array, errors: Array, *, rest_speed: float = REST
) -> Band:
    """Return the band, widened or narrowed to contain 95 % of errors on left-out rows in motion.

    Errors of fits know the rigid body's own rows; on others, the body is wrong as well, by more
    than its covariance says.

    Parameters
    ----------
    band : band of a joint, from the errors of its fit.
    dq, tau_load, errors : (N,) [rad/s], [N.m], [N.m] of rows that neither body nor law was
        fitted to.
    rest_speed : v_rest of the law [rad/s, m/s].
    """
    is_moving = np.abs(dq) >= rest_speed  # the band at rest is another one
    if np.count_nonzero(is_moving) < _MIN_LEFT_OUT_ROWS or not np.all(np.isfinite(errors)):
        return band
    sizes = np.array([getattr(band, name) for name in _SIZE_NAMES])
    columns = np.stack(
        shapes(dq[is_moving], tau_load[is_moving], band.slow_speed, rest_speed), axis=1
    )
    half_widths = np.sqrt(columns @ sizes**2 + _TINY_VARIANCE)
    standardised = np.abs(errors[is_moving]) / half_widths
    factor = float(np.quantile(standardised, LEVEL))
    changes = dict(zip(_SIZE_NAMES, map(float, factor * sizes), strict=True))
    return replace(band, tail=_fit_tail(standardised, factor), **changes)


def _cross_validate_band(
    law: FrictionLaw, joint_records: Sequence[FrictionRecord]
) -> tuple[Array, Array]:
    """Return the (N,) errors of fits without the row's log, and their predicted variance."""
    tau = np.concatenate([record.tau for record in joint_records])
    errors = tau - _predict_records(law, joint_records)
    if law.covariance is None:
        return errors, np.zeros_like(errors)
    jacobian = _compute_sensitivities(law, joint_records)
    labels = blocks_of_time(log_of_rows(joint_records))
    rows_by_log = [labels == k for k in range(int(labels[-1]) + 1)]
    hessians = np.array([jacobian[rows].T @ jacobian[rows] for rows in rows_by_log])
    left_out_errors = errors.copy()
    for k, rows in enumerate(rows_by_log):
        log_jacobian = jacobian[rows]
        # A sum, as a difference from the total is round-off where only this log moves.
        other_hessian = np.delete(hessians, k, axis=0).sum(axis=0)
        inverse = np.linalg.pinv(other_hessian, hermitian=True, rcond=_MIN_RELATIVE_VARIANCE)
        left_out_errors[rows] += log_jacobian @ (inverse @ (log_jacobian.T @ errors[rows]))
    return left_out_errors, np.sum(jacobian**2, axis=1)


def _compute_sensitivities(law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> Array:
    """Return the changes of torque (N, r) [N.m] by one standard deviation of independent errors."""
    covariance = law.covariance
    assert covariance is not None
    deviations = np.sqrt(np.maximum(np.diag(covariance.matrix), _TINY_VARIANCE))
    eigenvalues, directions = np.linalg.eigh(covariance.matrix / np.outer(deviations, deviations))
    is_free = eigenvalues > _MIN_RELATIVE_VARIANCE * max(float(eigenvalues[-1]), _TINY_VARIANCE)
    directions = deviations[:, None] * directions[:, is_free] * np.sqrt(eigenvalues[is_free])
    columns = []
    for name in covariance.names:
        coefficient = law.values[name]
        step = _DIFFERENCE_STEP * max(abs(coefficient), _MIN_COEFFICIENT_SIZE)
        if coefficient:  # laws divide by some; none may become zero
            step = min(step, 0.5 * abs(coefficient))
        higher_law = replace(law, values={**law.values, name: coefficient + step})
        lower_law = replace(law, values={**law.values, name: coefficient - step})
        after = _predict_records(higher_law, joint_records)
        before = _predict_records(lower_law, joint_records)
        columns.append((after - before) / (2.0 * step))
    return np.asarray(np.stack(columns, axis=1) @ directions)


def _predict_records(law: FrictionLaw, joint_records: Sequence[FrictionRecord]) -> Array:
    return np.concatenate([predict_record(law, record) for record in joint_records])


def fit_variance_shares(columns: Array, squares: Array, known_variance: Array) -> Array:
    """Return non-negative shares (B,) of shapes (N, B) in variance beyond `known_variance` (N,)."""
    mean = columns.mean(axis=0)
    # Start from equal parts of the mean square; the steps keep shares positive.
    equal_parts = squares.mean() / (columns.shape[1] * np.maximum(mean, _TINY_VARIANCE))
    shares = np.where(mean > 0.0, equal_parts, 0.0)
    if not squares.any():
        return np.asarray(shares)
    for _ in range(_SHARE_ROUNDS):
        variance = columns @ shares + known_variance + _TINY_VARIANCE
        gain = columns.T @ (squares / variance**2)
        cost = columns.T @ (1.0 / variance)
        shares = shares * np.sqrt(gain / np.maximum(cost, _TINY_VARIANCE))
    return np.asarray(shares)


def _count_rests(record: FrictionRecord, resting_speed: float) -> int:
    is_slow = np.concatenate([[False], np.abs(record.dq) < resting_speed, [False]])
    begins = np.flatnonzero(is_slow[1:] & ~is_slow[:-1])
    ends = np.flatnonzero(~is_slow[1:] & is_slow[:-1])
    return int(np.count_nonzero(record.t[ends - 1] - record.t[begins] >= _MIN_REST_DURATION))


def _fit_tail(standardised: Array, level_quantile: float) -> float:
    quantiles = np.quantile(standardised, _TAIL_LEVELS)
    if not (level_quantile > 0.0 and quantiles[0] > 0.0):
        return 0.65
    x = np.log(np.log1p(-np.array(_TAIL_LEVELS)) / np.log1p(-LEVEL))
    y = np.log(quantiles / level_quantile)
    return float(np.clip(x @ y / (x @ x), *_TAIL_RANGE))
