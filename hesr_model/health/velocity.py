"""Velocity checks against the derivative of the position: units, signs, columns, lag."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.findings import Finding, Severity, of_joint
from hesr_model.health.evidence import Motionwise
from hesr_model.inference.covariance import standard_errors
from hesr_model.logs.log_format import LogUnits, column_names
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.units import OTHERS, TURNING, backwards

_ALIKE = 0.9  # correlation of a velocity with its position
_SURE = 5.0  # significance threshold in standard errors
_WRONG = 0.1
_ODD = 0.03  # scale errors that are an error and a warning
_SAME = 0.04  # tolerance for the factor of a unit
_LATE = 0.02  # reporting threshold for the lag [s]
_LATEST = 0.3  # largest lag searched [s]
_TURNS = 4.0 * np.pi  # largest travel of an arm's joint [rad]
_DERIVE = 'set [log.columns] dq = "" to derive it from the position'


@dataclass(frozen=True, kw_only=True)
class Match:
    """Regression of a joint's differentiated position on its velocity; lag in [s]."""

    slope: float
    error: float
    correlation: float
    lag: float


def match(v: Array, dq: Array, period: float) -> Match:
    """Compare a derivative `v` with `dq` (N,), `period` [s] apart."""
    correlation = _correlation(v, dq)
    slope = float(np.std(v)) / max(float(np.std(dq)), 1e-300) * (-1.0 if correlation < 0 else 1.0)
    error = float(standard_errors(dq[:, None], v - slope * dq)[0]) if np.any(dq) else np.inf
    return Match(slope=slope, error=error, correlation=correlation, lag=_lag(v, dq, period))


def _correlation(a: Array, b: Array) -> float:
    return 0.0 if np.std(a) < 1e-12 or np.std(b) < 1e-12 else float(np.corrcoef(a, b)[0, 1])


def _lag(v: Array, dq: Array, period: float) -> float:
    """Return the lag of dq [s], at the peak of the cross-correlation."""
    most = min(int(_LATEST / period), len(v) // 4)
    if most < 1 or np.std(v) < 1e-12 or np.std(dq) < 1e-12:
        return 0.0
    inner = v[most:-most]
    shifts = np.arange(-most, most + 1)
    found = [abs(_correlation(inner, dq[most + k : len(dq) - most + k])) for k in shifts]
    return float(shifts[int(np.argmax(found))] * period)


def check_velocity(
    motion: Motionwise, description: RobotDescription, without: Collection[str] = ()
) -> Iterator[Finding]:
    """Check velocities, but for resting joints and those in `without`."""
    if motion.dq is None:
        return
    dq = motion.dq
    joints = np.array(
        [j for j in np.flatnonzero(motion.moves) if description.joints[j] not in without]
    )
    matches = {int(j): match(motion.v[:, j], dq[:, j], motion.period) for j in joints}
    places = _places(motion, joints)
    derived = {"log.columns.dq": ""}
    for j, found in matches.items():
        name = description.joints[j]
        if np.ptp(dq[:, j]) < 1e-9:
            what = "its position moves while its velocity never changes"
            remedy = f"the velocity is not logged; {_DERIVE}"
            yield of_joint("velocity-constant", name, what, remedy, changes=derived)
        elif abs(found.correlation) < _ALIKE:
            yield _unlike(description, j, found, places)
        else:
            yield from _scale(description, j, matches, motion)
            if abs(found.lag) > max(_LATE, 2.0 * motion.period):
                way = "late" if found.lag > 0 else "early"
                what = (
                    f"its velocity is {abs(found.lag) * 1e3:.0f} ms {way} relative to its position"
                )
                remedy = f"it was filtered or comes from another clock; {_DERIVE}"
                yield of_joint("velocity-lag", name, what, remedy, "warning", changes=derived)


def _places(motion: Motionwise, joints: Integers) -> dict[int, int]:
    from scipy.optimize import linear_sum_assignment

    assert motion.dq is not None
    table = np.array(
        [[abs(_correlation(motion.v[:, j], motion.dq[:, k])) for k in joints] for j in joints]
    )
    if not table.size:
        return {}
    rows, columns = linear_sum_assignment(-table)
    return {
        int(joints[j]): int(joints[k])
        for j, k in zip(rows, columns, strict=True)
        if table[j, k] > _ALIKE
    }


def _unlike(description: RobotDescription, j: int, found: Match, places: dict[int, int]) -> Finding:
    name = description.joints[j]
    other = places.get(j, j)
    what = f"its velocity does not follow its position (correlation {found.correlation:.2f})"
    if other != j:
        columns = column_names(description.log.columns.dq, description.joints)
        order = [columns[places.get(k, k)] for k in range(len(columns))]
        listed = ", ".join(f'"{column}"' for column in order)
        place = f"its velocity is in the column of joint '{description.joints[other]}'; set "
        remedy = f"{place}[log.columns] dq = [{listed}]"
        changes = {"log.columns.dq": tuple(order)}
        return of_joint("velocity-columns", name, what, remedy, changes=changes)
    late = f", and is {found.lag * 1e3:.0f} ms late" if abs(found.lag) > _LATE else ""
    remedy = f"the column contains another signal or a filtered one; {_DERIVE}"
    return of_joint("velocity-match", name, what + late, remedy, changes={"log.columns.dq": ""})


def _scale(
    description: RobotDescription, j: int, matches: dict[int, Match], motion: Motionwise
) -> Iterator[Finding]:
    found = matches[j]
    name = description.joints[j]
    if found.slope < 0:
        declared = enumerate(description.log.units.each("dq", len(description.joints)))
        against = {k for k, other in matches.items() if other.correlation < -_ALIKE}
        units = [backwards(unit) if k in against else unit for k, unit in declared]
        what = f"its position falls where its velocity is positive (slope {found.slope:.2f})"
        remedy = (
            f"velocity or position counts backwards; set [log.units] dq = {listed(units)}, "
            "or q accordingly"
        )
        yield of_joint("velocity-sign", name, what, remedy, changes={"log.units.dq": tuple(units)})
    ratio = abs(found.slope)
    if not abs(ratio - 1.0) > _SURE * found.error or abs(np.log(ratio)) < _ODD:
        return
    cause, changes = _cause(description, j, matches, motion)
    shown = f"{ratio:.3g} times faster" if ratio > 1 else f"{1 / ratio:.3g} times slower"
    kind: Severity = "error" if abs(np.log(ratio)) > _WRONG else "warning"
    what = f"q changes {shown} than dq"
    yield of_joint("velocity-scale", name, what, cause, kind, changes=changes)


def _cause(
    description: RobotDescription, j: int, matches: dict[int, Match], motion: Motionwise
) -> tuple[str, dict[str, object]]:
    ratio = abs(matches[j].slope)
    all_alike = len(matches) > 1 and all(
        abs(np.log(abs(other.slope) / ratio)) < _SAME for other in matches.values()
    )
    units = description.log.units
    n = len(description.joints)
    far = np.max(np.ptp(motion.q, axis=0)) > _TURNS
    for quantity in ("q", "dq") if far else ("dq", "q"):
        # q' = q f scales the derivative of the position by f, dq' = dq f the logged velocity.
        wanted = 1.0 / ratio if quantity == "q" else ratio
        for unit in _alternatives(units, quantity, j, n, wanted):
            told = f"{quantity} is in {unit}; set [log.units] {quantity} = '{unit}'"
            if all_alike or len(matches) == 1:
                return told, {f"log.units.{quantity}": unit}
            each = list(units.each(quantity, n))
            each[j] = unit
            told = f"{quantity} is in {unit}; set [log.units] {quantity} = {listed(each)}"
            return told, {f"log.units.{quantity}": tuple(each)}
    gear = description.gear_ratio[j] if description.gear_ratio else 1.0
    for quantity, geared in (("dq", ratio * gear), ("q", ratio / gear)) if gear != 1.0 else ():
        if abs(np.log(geared)) < _SAME:
            each = [*units.each(quantity, n)]
            each[j] = float(f"{units.factors(quantity, n)[j] / gear:.6g}")
            told = f"{quantity} belongs to the motor; set [log.units] {quantity} = {listed(each)}"
            return told, {f"log.units.{quantity}": tuple(each)}
    if all_alike:
        ratio = float(np.median([abs(other.slope) for other in matches.values()]))
        for unit, factor in OTHERS["t"].items():
            if abs(np.log(ratio * units.factors("t", 1)[0] / factor)) < _SAME:
                return f"time is in {unit}; set [log.units] t = '{unit}'", {"log.units.t": unit}
        return (
            f"all joints agree: time stamps run {1 / ratio:.2g} times as fast as time (wrong "
            "sample rate), or the unit of dq is wrong",
            {"log.units.t": float(units.factors("t", 1)[0]) * ratio},
        )
    return "units, a gear ratio or the signal itself are wrong; see [log.units]", {}


def _alternatives(units: LogUnits, quantity: str, j: int, n: int, wanted: float) -> Iterator[str]:
    declared = float(units.factors(quantity, n)[j])
    for unit, factor in TURNING[quantity].items():
        if abs(np.log(abs(factor / declared) / wanted)) < _SAME:
            yield f"-{unit}" if declared < 0 else unit


def listed(units: Sequence[str | float]) -> str:
    """Return one unit, or one per joint, as in a robot file."""
    if len(set(units)) == 1:
        return repr(units[0])
    return f"[{', '.join(repr(unit) for unit in units)}]"
