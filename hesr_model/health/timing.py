"""Timing checks: torque lag and wrong time-stamp rate.

Friction after a reversal looks like a lag, and unknown rotor inertias look like a wrong rate. So
both tests fit a body with free parameters in addition to friction with memory.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import sympy

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Stop
from hesr_model.findings import Finding, of_joint
from hesr_model.health.evidence import Estimate, Motionwise, rubbing
from hesr_model.inference.covariance import correlation_length
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import onto
from hesr_model.support.arrays import Array, Mask

_WIDTHS = 2.5e-4 * 2.0 ** np.arange(9)  # break-away deflections [rad or m]
_SLOW = 0.5  # share of the peak speed in which friction falls
_LATEST = 0.25
_STEP = 0.005  # searched delays, search step [s]
_SHIFTS = _STEP * np.arange(-round(_LATEST / _STEP), round(_LATEST / _STEP) + 1)  # [s]
_SMOOTH = 0.1
_EVERY = 0.02
_BODY = 5e-3  # averaging window, time between averages, bodies [s]
_MOST = 40_000  # rows of a log, its middle ones
_SYSTEMATIC = 0.04  # error of a joint's lag by memory of other shapes, over what memory explains
_NARROW = 0.01
_LATE = 0.06  # reported: half an interval of a small lag, a larger lag [s]
_SCALES = np.geomspace(1.0 / 16.0, 16.0, 33)  # factors of inertial torque: squared stamp rates
_OFF = 1.4  # reported factor of a wrong time-stamp rate
_MENDED = 0.5  # left by the right rate of most joints' unexplained squares; a wrong zero leaves 0.6
_SURE = 25.0  # twice the log-likelihood ratio: five standard errors
_ERRORS = 3.0  # standard errors of a stated interval
_SHORTEST = 8.0  # duration of a log over the largest delay


@dataclass(frozen=True, kw_only=True, eq=False)
class LagRows:
    """Shifted torques (N, S, n), regressors (N, n, P) at rest and in motion, friction (N, K).

    One filter averages all of them, so that they keep their phases.
    """

    torques: Array
    still: Array
    moving: Array
    rubs: tuple[Array, ...]
    known: Mask  # (N, n) rows whose friction does not depend on what was before the log

    @classmethod
    def of(cls, log: Log, robot: Robot, base: Sequence[int]) -> "LagRows":
        """Evaluate the columns `base` of the regressor, and friction, along a log."""
        from scipy.interpolate import make_interp_spline

        before = max(len(log.t) - _MOST, 0) // 2
        log = replace(log.rows(slice(before, before + _MOST)), dq=None)
        motion = smooth(log, robot.description.log.filter_cutoff)
        logged = robot.description.logged
        times = np.arange(log.t[0] + _LATEST, log.t[-1] - _LATEST, max(_EVERY, log.period))
        some = slice(None, None, max(1, round(_BODY / log.period)))
        q, dq, ddq = (values[some] for values in (motion.q, motion.dq, motion.ddq))
        nothing = np.zeros_like(q)
        still = robot.regressor(q, nothing, nothing)[:, :, list(base)]
        whole = robot.regressor(q, dq, ddq)[:, :, list(base)]
        tau = log.tau
        if logged is not None:
            still, whole, tau = logged.torque(still), logged.torque(whole), logged.torque(tau)
        u = onto(logged, log.q)
        v = onto(logged, motion.dq)
        travelled = np.maximum.accumulate(np.abs(u - u[0]), axis=0)
        mean = _means(log.t, times, log.period)
        of_body = _means(log.t[some], times, log.period)
        even = np.arange(log.t[0], log.t[-1], log.period)
        torque = make_interp_spline(even, _means(log.t, even, log.period) @ tau, k=1)
        return cls(
            torques=torque(times[:, None] + _SHIFTS),
            still=_each(of_body, still),
            moving=_each(of_body, whole - still),
            rubs=tuple(mean @ _rubs(u[:, j], v[:, j]) for j in range(robot.n)),
            known=mean @ (1.0 * (travelled > 2.0 * _WIDTHS[-1])) > 1.0 - 1e-9,
        )


def _each(means: Any, values: Array) -> Array:
    return np.asarray(means @ values.reshape(len(values), -1)).reshape(-1, *values.shape[1:])


def _means(t: Array, times: Array, period: float) -> Any:
    """Return the sparse weights (M, N) of averages around `times` (M,) of values between rows."""
    from scipy.sparse import csr_array

    half = round(max(_SMOOTH, 3.0 * period) / period)
    kernel = np.convolve(np.ones(half), np.ones(half))[:, None] / half**2
    near = np.clip(times[:, None] + period * np.arange(1 - half, half), t[0], t[-1])
    row = np.clip(np.searchsorted(t, near) - 1, 0, len(t) - 2)
    share = (near - t[row]) / (t[row + 1] - t[row])
    weights = np.stack([1.0 - share, share], axis=-1) * kernel
    indices = np.stack([row, row + 1], axis=-1)
    starts = np.arange(len(times) + 1) * 2 * len(kernel)
    return csr_array((weights.ravel(), indices.ravel(), starts), shape=(len(times), len(t)))


def _rubs(u: Array, v: Array) -> Array:
    """Return friction of several shapes (N, K) along a position u (N,)."""
    stops = KernelRun(_stops(), [np.diff(u, prepend=u[0])], np.ones_like(u))
    start = np.full(len(_WIDTHS), np.sign(v[0]))
    held = stops.at(np.zeros(0), start, settled=True)
    # Friction falls with speed.
    slow = np.exp(-np.abs(v) / (_SLOW * np.max(np.abs(v), initial=1e-9)))
    free = np.sign(v), rubbing(v), v, v * np.abs(v), np.ones_like(v)
    return np.column_stack([held, held * slow[:, None], *free])


@cache
def _stops() -> Kernel:
    displacement = sympy.Symbol("displacement", real=True)
    stops = [
        Stop(name=f"stop_{k}", unit="1", velocity=displacement, deflection=width, bound=1)
        for k, width in enumerate(_WIDTHS.tolist())
    ]
    return Kernel(stops, (), (displacement,), [stop.state for stop in stops], once=True)


def check_clocks(
    part: Motionwise, joints: Sequence[int], robot: Robot
) -> tuple[list[Finding], Collection[int]]:
    """Check the rate of the stamps and the lag of torques of `joints`.

    Returns findings, and joints whose torque lags; none for short logs and those slower than the
    averages.
    """
    slow = np.median(np.diff(part.t)) > _SMOOTH
    if slow or np.ptp(part.t) < _SHORTEST * _LATEST or not joints:
        return [], ()
    rows = LagRows.of(part.log, robot, base_columns(robot))
    late = lags(rows, joints)
    remedy = "torques were filtered or come from another clock; shift their columns in time"
    findings = []
    for j, lag in late.items():
        way = "late" if lag.value > 0 else "early"
        sure = 1e3 * _ERRORS * lag.error
        found = (
            f"its torque is about {1e3 * abs(lag.value):.0f} ms {way} relative to the motion "
            f"(+- {sure:.0f} ms)"
        )
        findings.append(of_joint("torque-lag", robot.joints[j], found, remedy, "warning"))
    rate, sure = stamps_rate(rows, joints)
    if sure > _SURE and max(rate, 1.0 / rate) > _OFF:
        findings.append(_wrong_rate(rate))
    return findings, late


def _wrong_rate(rate: float) -> Finding:
    way = f"{rate:.2g} times slower" if rate > 1 else f"{1 / rate:.2g} times faster"
    found = f"compared with gravity, its inertial torques are those of a motion that is {way}"
    remedy = "the time stamps come from a wrong sample rate, or their unit is wrong; see "
    return of_joint("time-scale", "", found, f"{remedy}[log.units] t", "warning")


def lags(rows: LagRows, joints: Sequence[int]) -> dict[int, Estimate]:
    """Return the lags [s] whose intervals exclude 0, by joint.

    Memory of friction absorbs a lag, and friction without it looks like one: the lag of a joint is
    between those of fits with and without it. Friction with memory comes close to the lag of most
    joints together.
    """
    both = {j: delays(rows, j) for j in joints}
    held, plain = ({j: of[k] for j, of in both.items()} for k in range(2))
    wide = [_SYSTEMATIC * abs(plain[j].value - held[j].value) for j in joints]
    late, other = (common_delay(list(lags.values()), wide) for lags in (held, plain))
    early = max(late, other, key=lambda lag: lag.value)
    if _told(late) if late.value > 0.0 else (early.value < 0.0 and _told(early)):
        return dict.fromkeys(joints, late)
    found = {}
    for j in joints:
        middle = 0.5 * (held[j].value + plain[j].value)
        half = 0.5 * abs(held[j].value - plain[j].value)
        error = half / _ERRORS + max(held[j].error, plain[j].error)
        if _LATE + _ERRORS * error < middle < _LATEST - 2.0 * _STEP:
            found[j] = Estimate(value=middle, error=error)
    return found


def _told(lag: Estimate) -> bool:
    """Return whether a lag is surely not 0, and known well or large."""
    half = _ERRORS * lag.error
    return abs(lag.value) > half + (0.0 if half < _NARROW else _LATE)


def common_delay(lags: Sequence[Estimate], systematic: Sequence[float]) -> Estimate:
    """Return the weighted median of lags with `systematic` errors [s] in addition to their own.

    Its standard error includes their spread; it is infinite for fewer than three lags, whose spread
    is unknown.
    """
    both = zip(lags, systematic, strict=True)
    known = [(lag.value, np.hypot(lag.error, own)) for lag, own in both if np.isfinite(lag.error)]
    if len(known) < 3:
        return Estimate(value=0.0, error=np.inf)
    values, errors = np.array(known).T
    order = np.argsort(values)
    values, weights = values[order], errors[order] ** -2.0 / np.sum(errors**-2.0)
    middle = float(np.interp(0.5, np.cumsum(weights) - 0.5 * weights, values))
    spread = weights @ (values - middle) ** 2 / (len(known) - 1)
    return Estimate(value=middle, error=float(np.sqrt(spread + 1.0 / np.sum(errors**-2.0))))


def delays(rows: LagRows, j: int) -> tuple[Estimate, Estimate]:
    """Return the lag of a torque [s] with memory of friction, and with friction of velocity only.

    The error is infinite at an end of the search range.
    """
    count = 2 * len(_WIDTHS) + 2
    known = rows.known[:, j]
    rubs, others = np.split(rows.rubs[j][known], [count], axis=1)
    others = np.hstack([(rows.still + rows.moving)[known, j], others])
    if len(others) <= others.shape[1] + count:
        return (Estimate(value=0.0, error=np.inf),) * 2
    left = _project_out(others, np.hstack([rubs, rows.torques[known, :, j]]))
    rubs, torques = np.split(left, [count], axis=1)
    used = others.shape[1]
    return _delay(rubs, torques, used), _delay(rubs[:, -2:], torques, used)


def _delay(rubs: Array, torques: Array, used: int) -> Estimate:
    """Return the lag at which friction (N, K) fits torques (N, S) best, after `used` unknowns."""
    from scipy.optimize import nnls

    # Friction of negative weight would imitate a lag.
    q, corner = np.linalg.qr(rubs)
    fits = np.array([nnls(corner, column, maxiter=1000)[0] for column in (q.T @ torques).T]).T
    left = torques - rubs @ fits
    squares = np.sum(left**2, axis=0)
    k = int(np.argmin(squares))
    if k in (0, len(squares) - 1):
        return Estimate(value=float(_SHIFTS[k]), error=np.inf)
    free = max(len(left) - used - rubs.shape[1], 1)
    independent = free / correlation_length(left[:, k])
    before, at, after = 0.5 * independent * np.log(np.maximum(squares[k - 1 : k + 2], 1e-300))
    bend = max(before - 2.0 * at + after, 1e-12)
    vertex = _SHIFTS[k] + 0.5 * _STEP * (before - after) / bend
    return Estimate(value=float(vertex), error=float(_STEP / np.sqrt(bend)))


def stamps_rate(rows: LagRows, joints: Sequence[int]) -> tuple[float, float]:
    """Return the ratio of a motion's duration to that of its stamps, and its certainty.

    With stamps r times too short, inertial torques are 1 / r^2 times as large. The result is (1, 0)
    at an end of the search range, and if no rate explains the torques of most joints.
    """
    parts = []
    count = rows.still.shape[2]
    for j in joints:
        torque = rows.torques[:, len(_SHIFTS) // 2, [j]]
        left = _project_out(rows.rubs[j], np.hstack([torque, rows.still[:, j], rows.moving[:, j]]))
        body = left[:, 1 : 1 + count] + left[:, 1 + count :]
        parts.append(left / max(float(np.std(_project_out(body, left[:, :1]))), 1e-12))
    table = np.concatenate(parts)
    # The triangular factor suffices.
    corner = np.asarray(np.linalg.qr(table, mode="r"))
    left = np.stack([table[:, 0] - _bodies(table, s) @ _fitted(corner, s) for s in _SCALES], axis=1)
    best = int(np.argmin(np.sum(left**2, axis=0)))
    if best in (0, len(_SCALES) - 1):
        return 1.0, 0.0
    by_joint = left.reshape(len(joints), -1, len(_SCALES))
    squares = np.sum(by_joint**2, axis=1)
    independent = np.array([len(own) / correlation_length(own[:, best]) for own in by_joint])
    now = int(np.argmin(np.abs(np.log(_SCALES))))
    if np.median(squares[:, best] / squares[:, now]) > _MENDED:
        return 1.0, 0.0
    sure = independent @ np.log(squares[:, now] / squares[:, best])
    return float(1.0 / np.sqrt(_SCALES[best])), float(sure)


def _bodies(table: Array, scale: float) -> Array:
    """Return regressors (N, P) from a table of torque, still, moving."""
    still, moving = np.split(table[:, 1:], 2, axis=1)
    return np.asarray(still + scale * moving)


def _fitted(table: Array, scale: float) -> Array:
    columns = _bodies(table, scale)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-150)
    return np.asarray(np.linalg.lstsq(columns / size, table[:, 0], rcond=1e-6)[0] / size)


def _project_out(columns: Array, targets: Array) -> Array:
    """Project `targets` (N, K) onto the orthogonal complement of `columns` (N, P)."""
    size = np.linalg.norm(columns, axis=0)
    used = columns[:, size > 1e-9 * size.max(initial=0.0)]
    u, s, _ = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)
    u = u[:, s > 1e-6 * s.max(initial=0.0)]
    return np.asarray(targets - u @ (u.T @ targets))
