"""Velocity checks against the derivative of the position: units, signs, columns, lag."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.findings import Finding, Severity, build_joint_finding
from hesr_model.health.evidence import SmoothPart
from hesr_model.inference.covariance import standard_errors
from hesr_model.logs.log_format import LogUnits, column_names
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.units import COMMON_UNITS, REVOLUTE_UNITS, reverse_unit

_MIN_CORRELATION = 0.9  # correlation of a velocity with its position
_MIN_SIGNIFICANCE = 5.0  # significance threshold in standard errors
_MIN_SCALE_ERROR = 0.1
_MIN_SCALE_WARNING = 0.03  # scale errors that are an error and a warning
_FACTOR_TOLERANCE = 0.04  # tolerance for the factor of a unit
_MIN_REPORTED_LAG = 0.02  # reporting threshold for the lag [s]
_MAX_LAG = 0.3  # largest lag searched [s]
_MAX_ARM_TRAVEL = 4.0 * np.pi  # largest travel of an arm's joint [rad]
_DERIVE_REMEDY = 'set [log.columns] dq = "" to derive it from the position'


@dataclass(frozen=True, kw_only=True)
class VelocityMatch:
    """Regression of a joint's differentiated position on its velocity; lag in [s]."""

    slope: float
    error: float
    correlation: float
    lag: float


def match_velocity(v: Array, dq: Array, period: float) -> VelocityMatch:
    """Compare a derivative `v` with `dq` (N,), `period` [s] apart."""
    correlation = _compute_correlation(v, dq)
    slope = float(np.std(v)) / max(float(np.std(dq)), 1e-300) * (-1.0 if correlation < 0 else 1.0)
    error = float(standard_errors(dq[:, None], v - slope * dq)[0]) if np.any(dq) else np.inf
    return VelocityMatch(
        slope=slope, error=error, correlation=correlation, lag=_find_lag(v, dq, period)
    )


def _compute_correlation(a: Array, b: Array) -> float:
    return 0.0 if np.std(a) < 1e-12 or np.std(b) < 1e-12 else float(np.corrcoef(a, b)[0, 1])


def _find_lag(v: Array, dq: Array, period: float) -> float:
    """Return the lag of dq [s], at the peak of the cross-correlation."""
    max_shift = min(int(_MAX_LAG / period), len(v) // 4)
    if max_shift < 1 or np.std(v) < 1e-12 or np.std(dq) < 1e-12:
        return 0.0
    inner_v = v[max_shift:-max_shift]
    shifts = np.arange(-max_shift, max_shift + 1)
    correlations = [
        abs(_compute_correlation(inner_v, dq[max_shift + k : len(dq) - max_shift + k]))
        for k in shifts
    ]
    return float(shifts[int(np.argmax(correlations))] * period)


def check_velocity(
    part: SmoothPart, description: RobotDescription, excluded_joints: Collection[str] = ()
) -> Iterator[Finding]:
    """Check velocities, but for resting joints and those in `excluded_joints`."""
    if part.dq is None:
        return
    dq = part.dq
    joints = np.array(
        [j for j in np.flatnonzero(part.is_moving) if description.joints[j] not in excluded_joints]
    )
    matches = {int(j): match_velocity(part.v[:, j], dq[:, j], part.period) for j in joints}
    column_of_joint = _match_columns(part, joints)
    changes = {"log.columns.dq": ""}
    for j, fit in matches.items():
        joint = description.joints[j]
        if np.ptp(dq[:, j]) < 1e-9:
            observation = "its position moves while its velocity never changes"
            remedy = f"the velocity is not logged; {_DERIVE_REMEDY}"
            yield build_joint_finding(
                "velocity-constant", joint, observation, remedy, changes=changes
            )
        elif abs(fit.correlation) < _MIN_CORRELATION:
            yield _report_mismatch(description, j, fit, column_of_joint)
        else:
            yield from _check_scale(description, j, matches, part)
            if abs(fit.lag) > max(_MIN_REPORTED_LAG, 2.0 * part.period):
                direction = "late" if fit.lag > 0 else "early"
                observation = (
                    f"its velocity is {abs(fit.lag) * 1e3:.0f} ms {direction} relative to its "
                    "position"
                )
                remedy = f"it was filtered or comes from another clock; {_DERIVE_REMEDY}"
                yield build_joint_finding(
                    "velocity-lag", joint, observation, remedy, "warning", changes=changes
                )


def _match_columns(part: SmoothPart, joints: Integers) -> dict[int, int]:
    from scipy.optimize import linear_sum_assignment

    assert part.dq is not None
    correlations = np.array(
        [[abs(_compute_correlation(part.v[:, j], part.dq[:, k])) for k in joints] for j in joints]
    )
    if not correlations.size:
        return {}
    rows, columns = linear_sum_assignment(-correlations)
    return {
        int(joints[j]): int(joints[k])
        for j, k in zip(rows, columns, strict=True)
        if correlations[j, k] > _MIN_CORRELATION
    }


def _report_mismatch(
    description: RobotDescription, j: int, fit: VelocityMatch, column_of_joint: dict[int, int]
) -> Finding:
    joint = description.joints[j]
    other_joint = column_of_joint.get(j, j)
    observation = f"its velocity does not follow its position (correlation {fit.correlation:.2f})"
    if other_joint != j:
        columns = column_names(description.log.columns.dq, description.joints)
        ordered_columns = [columns[column_of_joint.get(k, k)] for k in range(len(columns))]
        quoted_columns = ", ".join(f'"{column}"' for column in ordered_columns)
        explanation = (
            f"its velocity is in the column of joint '{description.joints[other_joint]}'; set "
        )
        remedy = f"{explanation}[log.columns] dq = [{quoted_columns}]"
        changes = {"log.columns.dq": tuple(ordered_columns)}
        return build_joint_finding("velocity-columns", joint, observation, remedy, changes=changes)
    lag_remark = f", and is {fit.lag * 1e3:.0f} ms late" if abs(fit.lag) > _MIN_REPORTED_LAG else ""
    remedy = f"the column contains another signal or a filtered one; {_DERIVE_REMEDY}"
    return build_joint_finding(
        "velocity-match", joint, observation + lag_remark, remedy, changes={"log.columns.dq": ""}
    )


def _check_scale(
    description: RobotDescription, j: int, matches: dict[int, VelocityMatch], part: SmoothPart
) -> Iterator[Finding]:
    fit = matches[j]
    joint = description.joints[j]
    if fit.slope < 0:
        declared_units = enumerate(
            description.log.units.expand_per_joint("dq", len(description.joints))
        )
        opposite_joints = {
            k for k, other in matches.items() if other.correlation < -_MIN_CORRELATION
        }
        units = [reverse_unit(unit) if k in opposite_joints else unit for k, unit in declared_units]
        observation = f"its position falls where its velocity is positive (slope {fit.slope:.2f})"
        remedy = (
            f"velocity or position counts backwards; set [log.units] dq = {join_units(units)}, "
            "or q accordingly"
        )
        yield build_joint_finding(
            "velocity-sign", joint, observation, remedy, changes={"log.units.dq": tuple(units)}
        )
    ratio = abs(fit.slope)
    if (
        not abs(ratio - 1.0) > _MIN_SIGNIFICANCE * fit.error
        or abs(np.log(ratio)) < _MIN_SCALE_WARNING
    ):
        return
    cause, changes = _find_cause(description, j, matches, part)
    ratio_text = f"{ratio:.3g} times faster" if ratio > 1 else f"{1 / ratio:.3g} times slower"
    severity: Severity = "error" if abs(np.log(ratio)) > _MIN_SCALE_ERROR else "warning"
    observation = f"q changes {ratio_text} than dq"
    yield build_joint_finding(
        "velocity-scale", joint, observation, cause, severity, changes=changes
    )


def _find_cause(
    description: RobotDescription, j: int, matches: dict[int, VelocityMatch], part: SmoothPart
) -> tuple[str, dict[str, object]]:
    ratio = abs(matches[j].slope)
    are_alike = len(matches) > 1 and all(
        abs(np.log(abs(other.slope) / ratio)) < _FACTOR_TOLERANCE for other in matches.values()
    )
    units = description.log.units
    joint_count = len(description.joints)
    exceeds_turns = np.max(np.ptp(part.q, axis=0)) > _MAX_ARM_TRAVEL
    for quantity in ("q", "dq") if exceeds_turns else ("dq", "q"):
        # q' = q f scales the derivative of the position by f, dq' = dq f the logged velocity.
        needed_factor = 1.0 / ratio if quantity == "q" else ratio
        for unit in _find_units(units, quantity, j, joint_count, needed_factor):
            remedy = f"{quantity} is in {unit}; set [log.units] {quantity} = '{unit}'"
            if are_alike or len(matches) == 1:
                return remedy, {f"log.units.{quantity}": unit}
            joint_units = list(units.expand_per_joint(quantity, joint_count))
            joint_units[j] = unit
            remedy = (
                f"{quantity} is in {unit}; set [log.units] {quantity} = {join_units(joint_units)}"
            )
            return remedy, {f"log.units.{quantity}": tuple(joint_units)}
    gear_ratio = description.gear_ratio[j] if description.gear_ratio else 1.0
    for quantity, remaining_factor in (
        (("dq", ratio * gear_ratio), ("q", ratio / gear_ratio)) if gear_ratio != 1.0 else ()
    ):
        if abs(np.log(remaining_factor)) < _FACTOR_TOLERANCE:
            joint_units = [*units.expand_per_joint(quantity, joint_count)]
            joint_units[j] = float(f"{units.factors(quantity, joint_count)[j] / gear_ratio:.6g}")
            remedy = (
                f"{quantity} belongs to the motor; set [log.units] {quantity} = "
                f"{join_units(joint_units)}"
            )
            return remedy, {f"log.units.{quantity}": tuple(joint_units)}
    if are_alike:
        ratio = float(np.median([abs(other.slope) for other in matches.values()]))
        for unit, factor in COMMON_UNITS["t"].items():
            if abs(np.log(ratio * units.factors("t", 1)[0] / factor)) < _FACTOR_TOLERANCE:
                return f"time is in {unit}; set [log.units] t = '{unit}'", {"log.units.t": unit}
        return (
            f"all joints agree: time stamps run {1 / ratio:.2g} times as fast as time (wrong "
            "sample rate), or the unit of dq is wrong",
            {"log.units.t": float(units.factors("t", 1)[0]) * ratio},
        )
    return "units, a gear ratio or the signal itself are wrong; see [log.units]", {}


def _find_units(
    units: LogUnits, quantity: str, j: int, joint_count: int, needed_factor: float
) -> Iterator[str]:
    declared_factor = float(units.factors(quantity, joint_count)[j])
    for unit, factor in REVOLUTE_UNITS[quantity].items():
        if abs(np.log(abs(factor / declared_factor) / needed_factor)) < _FACTOR_TOLERANCE:
            yield f"-{unit}" if declared_factor < 0 else unit


def join_units(units: Sequence[str | float]) -> str:
    """Return one unit, or one per joint, as in a robot file."""
    if len(set(units)) == 1:
        return repr(units[0])
    return f"[{', '.join(repr(unit) for unit in units)}]"
