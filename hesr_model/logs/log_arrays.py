"""Checks of arrays from which a log is made: the rules of readers, by name of the parameter."""

from math import degrees, pi, radians
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.support.arrays import Array

MAX_NUMBER = 1e20  # in any unit; nanoseconds since 1970 are 2e18
SIGNALS = ("q", "dq", "tau", "load", "temperature", "q_link", "q_cmd", "dq_cmd", "current_size")
_LONGEST_PERIOD = 1.0  # [s] between rows; friction cannot be seen in slower logs
_MIN_CORRELATION = 0.9  # of a velocity and the slope of its position
_RATIO_MARGIN = 0.1  # relative
_MIN_ROWS = 20  # rows from which units are compared
_UNIT_RATIOS = {
    degrees(1.0): ("q", "is in degrees, but 'dq' in rad/s; give rad"),
    radians(1.0): ("dq", "is in degrees per second, but 'q' in rad; give rad/s"),
    pi / 30.0: ("dq", "is in revolutions per minute, but 'q' in rad; give rad/s"),
    1e-3: ("t", "is in milliseconds, but 'dq' per second; give s"),
}  # of the slope of `q` over `t` to `dq`, if one of the three is in another unit


def read_log_arrays(where: str, arrays: dict[str, Any]) -> dict[str, Array]:
    """Return time (N,) and signals (N, n) as floating-point arrays; None is left out.

    Lists and integers are converted. A signal of one joint may be (N,).

    Raises LogError, whose key is the parameter.
    """
    given = {name: values for name, values in arrays.items() if values is not None}
    t = _to_numbers(where, "t", given.pop("t"))
    if t.ndim != 1:
        raise _refuse(
            where, "t", f"has the shape {t.shape}; expected (N,), one time per row", "shape"
        )
    if len(t) < 2:
        raise _refuse(where, "t", f"has {len(t)} rows; at least 2 are needed", "rows")
    checked = {"t": t}
    joint_count = 0
    for name, values in given.items():
        signal = _to_rows(where, name, _to_numbers(where, name, values), len(t))
        joint_count = joint_count or signal.shape[1]
        if signal.shape[1] != joint_count:
            reason = f"has {signal.shape[1]} joints (columns), but 'q' has {joint_count}"
            raise _refuse(where, name, reason, "joints")
        checked[name] = signal
    for name, values in checked.items():
        _require_finite(where, name, values)
    _require_increase(where, t)
    _require_units(where, checked)
    return checked


def _to_numbers(where: str, name: str, values: Any) -> Array:
    """Return an array of floating-point numbers."""
    try:
        numbers = np.asarray(values)
        if numbers.dtype.kind not in "biufO":  # not complex, text or dates
            raise TypeError
        return np.array(numbers, dtype=float)
    except (TypeError, ValueError):  # ragged, or not numbers
        reason = "must hold real numbers, in rows of equal length"
        raise _refuse(where, name, reason, "numbers") from None


def _to_rows(where: str, name: str, values: Array, row_count: int) -> Array:
    """Return a signal as (N, n)."""
    if values.ndim == 1 and len(values) == row_count:
        return values[:, None]
    if values.ndim == 2 and len(values) == row_count and values.shape[1]:
        return values
    remedy = ""
    if values.ndim == 2 and values.shape[1] == row_count:
        remedy = "; transpose it"
    reason = (
        f"has the shape {values.shape}; expected ({row_count}, n), a row for each time of 't' and "
        f"a column for each joint{remedy}"
    )
    raise _refuse(where, name, reason, "shape")


def _require_finite(where: str, name: str, values: Array) -> None:
    is_wrong = ~(np.abs(values) <= MAX_NUMBER)
    if not np.any(is_wrong):
        return
    row, *column = np.argwhere(is_wrong)[0]
    joint = f", joint {column[0] + 1}" if column else ""
    value = float(values[(row, *column)])
    reason = (
        f"is {value:g} in row {row}{joint} (rows from 0); expected finite numbers up to "
        f"{MAX_NUMBER:g}"
    )
    raise _refuse(where, name, reason, "finite")


def _require_increase(where: str, t: Array) -> None:
    is_back = np.diff(t) <= 0.0
    if np.any(is_back):
        row = int(np.argmax(is_back)) + 1
        reason = f"must increase, but t[{row}] is {t[row]:.10g} s after {t[row - 1]:.10g} s"
        raise _refuse(where, "t", reason, "increase")
    period = float(np.median(np.diff(t)))
    if period > _LONGEST_PERIOD:
        reason = (
            f"has rows {period:.4g} s apart; give seconds, and at least "
            f"{1.0 / _LONGEST_PERIOD:g} row per second"
        )
        raise _refuse(where, "t", reason, "unit")


def _require_units(where: str, signals: dict[str, Array]) -> None:
    """Raise LogError if position and velocity of all moving joints differ by a factor of units."""
    dq = signals.get("dq")
    if dq is None or len(dq) < _MIN_ROWS:
        return
    slope = np.gradient(signals["q"], signals["t"], axis=0)
    ratios = []
    for joint_slope, joint_dq in zip(slope.T, dq.T, strict=True):
        sizes = float(np.linalg.norm(joint_slope)), float(np.linalg.norm(joint_dq))
        product = float(joint_slope @ joint_dq)
        if min(sizes) > 0.0 and product > _MIN_CORRELATION * sizes[0] * sizes[1]:
            ratios.append(product / sizes[1] ** 2)
    for factor, (name, reason) in _UNIT_RATIOS.items():
        if ratios and np.allclose(ratios, factor, rtol=_RATIO_MARGIN, atol=0.0):
            raise _refuse(where, name, reason, "unit")


def _refuse(where: str, name: str, reason: str, rule: str) -> LogError:
    return LogError(f"{where}: '{name}' {reason}.", code=f"log.array.{rule}", where=where, key=name)
