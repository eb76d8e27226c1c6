"""Clocks: torques that are late against the motion, and stamps that run faster or slower.

Friction lets go late after a reversal, and so looks delayed where a robot moves slowly; rotors are
of unknown inertia, and so no measure of time. What neither can imitate is a rigid body: its gravity
and inertia come when the joints are there, and are of the same masses, times lengths that the model
knows. Both tests are therefore of a body of any parameters, beside friction with a memory.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import sympy

from hesr_model.equations.kernel import Kernel
from hesr_model.equations.memory import Stop
from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise, rubbing
from hesr_model.inference.correlation import correlation_length
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.robots.robot import RobotDescription, RobotModel
from hesr_model.robots.transmission import onto
from hesr_model.support.arrays import Array

_ROWS = 700
"""Of a log, that are looked at."""
_WIDTHS = np.array([5e-4, 2e-3, 8e-3, 3.2e-2])
"""[rad or m] Of stops, by which friction remembers."""
_LATEST, _STEP, _LATE = 0.25, 0.01, 0.06
"""[s] Delays of the torque that are tried, their step, and those that are told."""
_SMOOTH = 0.05
"""[s] Over which a torque is averaged before it is moved."""
_EARLY, _ALONE = 0.1, 0.1
"""[s] By which most torques must come too early, or that of one joint too late, to be told: on
measured logs friction alone looks early by .05 s on most joints, and late by .06 s on one.
"""
_SCALES = np.geomspace(1.0 / 16.0, 16.0, 33)
"""Of the inertial torque, beside gravity: the square of the rate of the stamps."""
_OFF = 1.4
"""Factor by which stamps must be wrong to be told."""
_SURE = 25.0
"""Twice the logarithm of a ratio of likelihoods: five standard errors."""
_SHORTEST = 8.0
"""Times the latest delay that a log must last."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LagRows:
    """Rows of a part of a log, and what may explain the torques there, as these were logged.

    Attributes
    ----------
    t : (N,) [s].
    still, moving : (N, n, P) torque of the body's parameters at rest, and what the motion adds.
    rubs : of each joint (N, K): friction with memory, and an offset.
    """

    t: Array
    still: Array
    moving: Array
    rubs: tuple[Array, ...]

    @classmethod
    def of(cls, part: Motionwise, model: RobotModel, base: Sequence[int]) -> "LagRows":
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
    """Friction of many shapes (N, K) along a position u (N,) [rad; m] with velocity v."""
    stops = _stops().over([np.diff(u, prepend=u[0])], np.ones_like(u))
    start = np.full(len(_WIDTHS), np.sign(v[0]))
    held = stops.at(np.zeros(0), start, settled=True)
    return np.column_stack([held, rubbing(v), v, v * np.abs(v), np.ones_like(v)])


@cache
def _stops() -> Kernel:
    """Return Prandtl stops of several break-away deflections, moved by displacements."""
    displacement = sympy.Symbol("displacement", real=True)
    stops = [
        Stop(name=f"stop_{k}", unit="1", velocity=displacement, deflection=width, bound=1)
        for k, width in enumerate(_WIDTHS.tolist())
    ]
    return Kernel(stops, (), (displacement,), [stop.state for stop in stops], once=True)


def check_clocks(
    part: Motionwise, logged: Motionwise, joints: Sequence[int], model: RobotModel
) -> Iterator[Finding]:
    """Check the stamps of a part of a log, and when the torques of some joints come.

    Parameters
    ----------
    part, logged : the part, and the same with velocities and torques as they were logged.
    joints : those whose torque holds a signal.
    """
    if np.ptp(part.t) < _SHORTEST * _LATEST or not joints:
        return
    rows, logs = LagRows.of(part, model, base_columns(model)), (part.log.name,)
    found = {j: delay(rows, j, part.t, logged.tau[:, j]) for j in joints}
    lags = {j: lag for j, (lag, sure) in found.items() if sure > _SURE}
    most = float(np.median(list(lags.values()))) if len(lags) > 1 else 0.0
    for j, lag in lags.items():
        together = (most >= _LATE <= lag) or (most <= -_EARLY >= lag)
        # One joint that is best explained at the end of the search is of another motion, not late.
        if not together and not _ALONE <= lag < _LATEST - 0.5 * _STEP:
            continue
        yield Finding(
            check="torque-lag", severity="warning", logs=logs,
            joints=(model.description.joints[j],),
            found=f"its torque is about {abs(lag) * 1e3:.0f} ms {'late' if lag > 0 else 'early'} "
            "against the motion",
            remedy="torques were filtered or come from another clock; move their columns in time",
        )  # fmt: skip
    rate, sure = stamps_rate(rows, joints, part.t, logged.tau)
    if sure > _SURE and max(rate, 1.0 / rate) > _OFF:
        yield _wrong_rate(rate, model.description, logs)


def _wrong_rate(rate: float, robot: RobotDescription, logs: tuple[str, ...]) -> Finding:
    unit = float(robot.log.units.factors("t", 1)[0]) * rate
    way = f"{rate:.2g} times slower" if rate > 1 else f"{1 / rate:.2g} times faster"
    return Finding(
        check="time-scale", severity="warning", logs=logs,
        found=f"beside gravity its inertial torques are those of a motion that is {way}",
        remedy="the stamps were made from a wrong sample rate, or their unit is wrong; set "
        f"[log.units] t to about {unit:.2g}",
    )  # fmt: skip


def delay(rows: LagRows, j: int, t: Array, tau: Array) -> tuple[float, float]:
    """Return by how much a joint's torque is late [s], and how sure that is.

    Parameters
    ----------
    t, tau : (N,) [s], (N,) [N.m], of all rows.

    Returns
    -------
    tuple
        The delay, and twice the logarithm of its likelihood over that of none.
    """
    from scipy.ndimage import uniform_filter1d  # slow to import

    inner = (rows.t >= t[0] + _LATEST) & (rows.t <= t[-1] - _LATEST)
    shifts = np.arange(-_LATEST, _LATEST + 0.5 * _STEP, _STEP)
    # Interpolation smooths between rows, not at them: no shift may have less noise than another.
    even = uniform_filter1d(tau, max(1, round(_SMOOTH / float(np.median(np.diff(t))))))
    moved = np.stack([np.interp(rows.t[inner] + shift, t, even) for shift in shifts], axis=1)
    left = _project_out(
        np.hstack([rows.still[inner, j] + rows.moving[inner, j], rows.rubs[j][inner]]), moved
    )
    squares = np.sum(left**2, axis=0)
    k, now = int(np.argmin(squares)), int(np.argmin(np.abs(shifts)))
    independent = len(left) / correlation_length(left[:, k])
    return float(shifts[k]), float(independent * np.log(squares[now] / squares[k]))


def stamps_rate(rows: LagRows, joints: Sequence[int], t: Array, tau: Array) -> tuple[float, float]:
    """Return how many times longer than by its stamps a motion lasted, and how sure that is.

    A motion that lasted r times as long has 1 / r^2 times the inertial torques. Where inertia is so
    small that the search ends at one of its ends, nothing is said; see `delay` for the rest.
    """
    parts = []
    count = rows.still.shape[2]
    for j in joints:
        torque = np.interp(rows.t, t, tau[:, j])[:, None]
        left = _project_out(rows.rubs[j], np.hstack([torque, rows.still[:, j], rows.moving[:, j]]))
        body = left[:, 1 : 1 + count] + left[:, 1 + count :]
        parts.append(left / max(float(np.std(_project_out(body, left[:, :1]))), 1e-12))
    table = np.concatenate(parts)
    # What least squares ask of a table is in its triangle, which is small.
    corner = np.asarray(np.linalg.qr(table, mode="r"))
    left = np.stack([table[:, 0] - _bodies(table, s) @ _fitted(corner, s) for s in _SCALES], axis=1)
    best = int(np.argmin(np.sum(left**2, axis=0)))
    if best in (0, len(_SCALES) - 1):
        return 1.0, 0.0
    by_joint = left.reshape(len(joints), -1, len(_SCALES))
    squares = np.sum(by_joint**2, axis=1)
    independent = np.array(
        [len(rows_of) / correlation_length(rows_of[:, best]) for rows_of in by_joint]
    )
    now = int(np.argmin(np.abs(np.log(_SCALES))))
    sure = independent @ np.log(squares[:, now] / squares[:, best])
    return float(1.0 / np.sqrt(_SCALES[best])), float(sure)


def _bodies(table: Array, scale: float) -> Array:
    """Return columns (N, P) of a body from a table (N, 1 + 2 P) of torque, still, moving."""
    still, moving = np.split(table[:, 1:], 2, axis=1)
    return np.asarray(still + scale * moving)


def _fitted(table: Array, scale: float) -> Array:
    columns = _bodies(table, scale)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-150)
    return np.asarray(np.linalg.lstsq(columns / size, table[:, 0], rcond=1e-6)[0] / size)


def _project_out(columns: Array, targets: Array) -> Array:
    """Return what of `targets` (N, K) is beside the space of `columns` (N, P)."""
    size = np.linalg.norm(columns, axis=0)
    used = columns[:, size > 1e-9 * size.max(initial=0.0)]
    if not used.shape[1]:
        return targets
    u, s, _ = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)
    u = u[:, s > 1e-6 * s[0]]
    return np.asarray(targets - u @ (u.T @ targets))
