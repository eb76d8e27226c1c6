"""Currents without a sign: their kind, and the size of torques that follows from it.

The motor's current is its torque over a constant, and its torque is the servo's less back-EMF:

    |current| = offset + |error|^(exponent - 1) |slope error + damping dq|

with exponent 1. The current of the supply is that of the motor times the duty, which the error
sets: exponent 2. Readings with other exponents are not used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cosim.servo.record import ServoRecord
from hesr_model.support.arrays import Array, Integers

CurrentKind = Literal["motor current", "supply current", "neither"]

_EXPONENTS = np.linspace(0.0, 4.0, 81)  # that are tried
_NEAR = 0.3  # greatest distance of an exponent from 1 and from 2
_LEAST_ROWS = 20
_LEAST_EXPLAINED = 0.5  # share of the variance
_REPEATS = 10  # of the signs of torques
_SMALL = 1e-3  # smallest error over the largest, whose power is finite


@dataclass(frozen=True, kw_only=True)
class CurrentReading:
    """What the current without a sign of a joint is.

    Attributes
    ----------
    kind : of the current.
    exponent : of the servo's error; NaN if the error does not explain the current.
    slope : current of the motor over the servo's error [A/rad; A/m], 0 for other kinds.
    slope_error : standard error of the slope.
    """

    kind: CurrentKind
    exponent: float
    slope: float = 0.0
    slope_error: float = 0.0

    @property
    def sentence(self) -> str:
        """Kind of the current, in words."""
        if self.kind == "neither":
            return "the current is neither that of the motor nor of the supply, and is not used"
        exponent = f"exponent {self.exponent:.2g} of the servo's error"
        if self.kind == "supply current":
            return f"the current is that of the supply ({exponent}); it does not fix the scale"
        return f"the current is that of the motor ({exponent})"


def read_current(
    records: Sequence[ServoRecord], servo_errors: Sequence[Array], blocks: Integers
) -> CurrentReading | None:
    """Return the kind of a joint's current; None if it was not logged.

    Parameters
    ----------
    records : of the joint.
    servo_errors : (N,) torque of the servo over its gain [rad; m] along each record.
    blocks : (N,) number of the block of time of each row of all records.
    """
    sizes = [record.current_size for record in records if record.current_size is not None]
    if len(sizes) < len(records):
        return None
    size = np.concatenate(sizes)
    error = np.concatenate(servo_errors)
    dq = np.concatenate([record.dq for record in records])
    exponent = find_exponent(error, dq, size)
    if abs(exponent - 2.0) < _NEAR:
        return CurrentReading(kind="supply current", exponent=exponent)
    if not abs(exponent - 1.0) < _NEAR:
        return CurrentReading(kind="neither", exponent=exponent)
    slope, slope_error = _fit_motor_current(error, dq, size, blocks)
    return CurrentReading(
        kind="motor current", exponent=exponent, slope=slope, slope_error=slope_error
    )


def find_exponent(error: Array, dq: Array, size: Array) -> float:
    """Return the exponent of the servo's error in a current; NaN if it explains little of it.

    Parameters
    ----------
    error : (N,) torque of the servo over its gain [rad; m].
    dq : (N,) speed [rad/s; m/s].
    size : (N,) current without a sign [A].
    """
    variance = float(np.var(size))
    if len(size) < _LEAST_ROWS or variance == 0.0:
        return np.nan
    costs = []
    for exponent in _EXPONENTS:
        columns, values = _fit_current(error, dq, size, float(exponent))
        costs.append(float(np.mean((size - columns @ values) ** 2)))
    best = int(np.argmin(costs))
    if costs[best] < (1.0 - _LEAST_EXPLAINED) * variance:
        return float(_EXPONENTS[best])
    return np.nan


def _fit_current(error: Array, dq: Array, size: Array, exponent: float) -> tuple[Array, Array]:
    """Return the columns (N, 3) and slope, damping and offset (3,) of a current.

    The signs of torques follow from the last solution.
    """
    largest = max(float(np.max(np.abs(error))), 1e-300)
    weight = np.maximum(np.abs(error) / largest, _SMALL) ** (exponent - 1.0)
    sign = np.sign(error)
    for _ in range(_REPEATS):
        columns = np.column_stack([weight * sign * error, weight * sign * dq, np.ones_like(error)])
        values = np.linalg.lstsq(columns, size)[0]
        found = np.sign(values[0] * error + values[1] * dq)
        if np.array_equal(found, sign):
            break
        sign = found
    return columns, np.asarray(values, dtype=float)


def _fit_motor_current(
    error: Array, dq: Array, size: Array, blocks: Integers
) -> tuple[float, float]:
    """Return the slope of the motor's current over the servo's error, and its standard error.

    Whole blocks of time count as independent.
    """
    columns, values = _fit_current(error, dq, size, 1.0)
    residual = size - columns @ values
    inverse = np.linalg.pinv(columns.T @ columns)
    moments = np.array(
        [columns[blocks == block].T @ residual[blocks == block] for block in np.unique(blocks)]
    )
    covariance = inverse @ (moments.T @ moments) @ inverse
    return float(values[0]), float(np.sqrt(covariance[0, 0]))
