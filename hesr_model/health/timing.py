"""Timing checks: torque lag and wrong time-stamp rate.

Friction after a reversal looks like a lag, and unknown rotor inertias look like a wrong rate. So
both tests fit a body with free parameters in addition to friction with memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import sympy

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Stop
from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise, rubbing
from hesr_model.inference.correlation import correlation_length
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import onto
from hesr_model.support.arrays import Array

_ROWS = 700  # per log
_WIDTHS = np.array([5e-4, 2e-3, 8e-3, 3.2e-2])  # break-away deflections [rad or m]
_LATEST, _STEP, _LATE = 0.25, 0.01, 0.06  # searched delays, search step, reported delay [s]
_SMOOTH = 0.05  # averaging window of a torque [s]
_EARLY, _ALONE = 0.1, 0.1
"""Reporting thresholds [s] for an early median lag and for a single late joint.

On measured logs friction alone looks early by .05 s on most joints, and late by .06 s on one.
"""
_SCALES = np.geomspace(1.0 / 16.0, 16.0, 33)  # factors of inertial torque: squared stamp rates
_OFF = 1.4  # reported factor of a wrong time-stamp rate
_SURE = 25.0  # twice the log-likelihood ratio: five standard errors
_SHORTEST = 8.0  # duration of a log over the largest delay


@dataclass(frozen=True, kw_only=True, eq=False)
class LagRows:
    """Regressors (N, n, P) at rest and in motion, and friction (N, K) by joint."""

    t: Array
    still: Array
    moving: Array
    rubs: tuple[Array, ...]

    @classmethod
    def of(cls, part: Motionwise, model: Robot, base: Sequence[int]) -> "LagRows":
        """Evaluate the columns `base` of the regressor, and friction, along a part of a log."""
        logged = model.description.logged
        u, v = onto(logged, part.q), onto(logged, part.v)
        step = -(-len(part.t) // _ROWS)
        q, dq, ddq = (values[::step] for values in (part.q, part.v, part.a))
        nothing = np.zeros_like(q)
        still = model.regressor(q, nothing, nothing)[:, :, list(base)]
        whole = model.regressor(q, dq, ddq)[:, :, list(base)]
        if logged is not None:
            still, whole = logged.torque(still), logged.torque(whole)
        return cls(
            t=part.t[::step],
            still=still,
            moving=whole - still,
            rubs=tuple(_rubs(u[:, j], v[:, j])[::step] for j in range(model.n)),
        )


def _rubs(u: Array, v: Array) -> Array:
    """Return friction of several shapes (N, K) along a position u (N,)."""
    stops = KernelRun(_stops(), [np.diff(u, prepend=u[0])], np.ones_like(u))
    start = np.full(len(_WIDTHS), np.sign(v[0]))
    held = stops.at(np.zeros(0), start, settled=True)
    return np.column_stack([held, rubbing(v), v, v * np.abs(v), np.ones_like(v)])


@cache
def _stops() -> Kernel:
    displacement = sympy.Symbol("displacement", real=True)
    stops = [
        Stop(name=f"stop_{k}", unit="1", velocity=displacement, deflection=width, bound=1)
        for k, width in enumerate(_WIDTHS.tolist())
    ]
    return Kernel(stops, (), (displacement,), [stop.state for stop in stops], once=True)


def check_clocks(
    part: Motionwise, logged: Motionwise, joints: Sequence[int], model: Robot
) -> tuple[list[Finding], set[int]]:
    """Check the rate of the stamps and the lag of torques of `joints`.

    Returns findings, and joints whose torque may lag.
    """
    if np.ptp(part.t) < _SHORTEST * _LATEST or not joints:
        return [], set()
    rows = LagRows.of(part, model, base_columns(model))
    found = {j: delay(rows, j, part.t, logged.tau[:, j]) for j in joints}
    lags = {j: lag for j, (lag, sure) in found.items() if sure > _SURE}
    most = float(np.median(list(lags.values()))) if len(lags) > 1 else 0.0
    late: dict[int, Finding] = {}
    for j, lag in lags.items():
        together = (most >= _LATE <= lag) or (most <= -_EARLY >= lag)
        # A lag at the end of the range does not match the motion.
        if not together and not _ALONE <= lag < _LATEST - 0.5 * _STEP:
            continue
        late[j] = Finding(
            check="torque-lag",
            severity="warning",
            joints=(model.description.joints[j],),
            found=f"its torque is about {abs(lag) * 1e3:.0f} ms {'late' if lag > 0 else 'early'} "
            "relative to the motion",
            remedy="torques were filtered or come from another clock; shift their columns in time",
        )
    # The memory of friction absorbs a lag or looks like one: fits with and without must agree.
    plain = {j: delay(rows, j, part.t, logged.tau[:, j], memory=False)[0] for j in late}
    findings = [finding for j, finding in late.items() if lags[j] * plain[j] > 0.0]
    rate, sure = stamps_rate(rows, joints, part.t, logged.tau)
    if sure > _SURE and max(rate, 1.0 / rate) > _OFF:
        findings.append(_wrong_rate(rate, model.description))
    return findings, set(late)


def _wrong_rate(rate: float, robot: RobotDescription) -> Finding:
    unit = float(robot.log.units.factors("t", 1)[0]) * rate
    way = f"{rate:.2g} times slower" if rate > 1 else f"{1 / rate:.2g} times faster"
    return Finding(
        check="time-scale",
        severity="warning",
        found=f"compared with gravity, its inertial torques are those of a motion that is {way}",
        remedy="the time stamps come from a wrong sample rate, or their unit is wrong; set "
        f"[log.units] t to about {unit:.2g}",
    )


def delay(
    rows: LagRows, j: int, t: Array, tau: Array, *, memory: bool = True
) -> tuple[float, float]:
    """Return the lag of a torque [s], and twice its log-likelihood ratio.

    Without `memory`, friction depends on the velocity only.
    """
    from scipy.ndimage import uniform_filter1d

    inner = (rows.t >= t[0] + _LATEST) & (rows.t <= t[-1] - _LATEST)
    shifts = np.arange(-_LATEST, _LATEST + 0.5 * _STEP, _STEP)
    # Average first: then the noise of all shifts is equal.
    even = uniform_filter1d(tau, max(1, round(_SMOOTH / float(np.median(np.diff(t))))))
    moved = np.stack([np.interp(rows.t[inner] + shift, t, even) for shift in shifts], axis=1)
    rubs = rows.rubs[j][inner, 0 if memory else len(_WIDTHS) :]
    basis = _basis(np.hstack([rows.still[inner, j] + rows.moving[inner, j], rubs]))
    left = moved - basis @ (basis.T @ moved)
    squares = np.sum(left**2, axis=0)
    k, now = int(np.argmin(squares)), int(np.argmin(np.abs(shifts)))
    free = max(len(left) - basis.shape[1], 0)
    independent = free / correlation_length(left[:, k])
    return float(shifts[k]), float(independent * np.log(squares[now] / squares[k]))


def stamps_rate(rows: LagRows, joints: Sequence[int], t: Array, tau: Array) -> tuple[float, float]:
    """Return the ratio of a motion's duration to that of its stamps, and its certainty.

    With stamps r times too short, inertial torques are 1 / r^2 times as large. The result is (1, 0)
    at an end of the search range.
    """
    parts = []
    count = rows.still.shape[2]
    for j in joints:
        torque = np.interp(rows.t, t, tau[:, j])[:, None]
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
    u = _basis(columns)
    return np.asarray(targets - u @ (u.T @ targets))


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis (N, rank) of `columns` (N, P)."""
    size = np.linalg.norm(columns, axis=0)
    used = columns[:, size > 1e-9 * size.max(initial=0.0)]
    if not used.shape[1]:
        return used
    u, s, _ = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)
    return np.asarray(u[:, s > 1e-6 * s[0]])
