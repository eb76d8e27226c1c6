"""Velocity checks against the derivative of the position: units, signs, columns, lag."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hesr_model.findings import Severity
from hesr_model.health.evidence import SmoothPart
from hesr_model.health.positions import is_plausible_period
from hesr_model.health.referee import (
    CURE_GAIN,
    Estimate,
    Hypothesis,
    LeftOutRows,
    Race,
    Statistic,
)
from hesr_model.inference.covariance import correlation_length
from hesr_model.logs.log_format import LogUnits, column_names
from hesr_model.logs.robot_log import SHORTEST_PART, Log
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, Integers
from hesr_model.units import (
    COMMON_UNITS,
    PRISMATIC_UNITS,
    REVOLUTE_UNITS,
    find_si_factor,
    reverse_unit,
)

_MIN_CORRELATION = 0.9  # of a velocity with its position
_MAX_SCALE_ERROR = 0.1  # of a velocity, above which it is an error
_MAX_SCALE_WARNING = 0.03
_FACTOR_TOLERANCE = 0.04  # tolerance for the factor of a unit
_MIN_LAG_TO_SETTLING = 0.3  # lag of a velocity over the time that the low pass needs to settle
_MIN_LAG_TO_PERIOD = 2.0
_MAX_LAG = 0.3  # largest lag searched [s]
_MAX_ARM_TRAVEL = 4.0 * np.pi  # largest travel of an arm's joint [rad]
_MAX_RATE_FACTOR = 5.0  # of a wrong sample rate; beyond, a gear is as likely
_RATIO_ERRORS = 3.0  # standard errors within which a ratio is that of a unit or a gear
_MIN_RATIO_TOLERANCE = 5e-4  # of a ratio whose error is unknown to be smaller: clocks drift by less
_MAX_CHANCE = 0.1  # probability that a ratio is close to a whole number in some unit
_BLOCKS = 20  # of time, left out in turn
_UNKNOWN_CAUSE = "units, a gear ratio or the signal itself are wrong; see [log.units]"
_DERIVE_REMEDY = "derive it from the position"
_TELLING_MOTION = "motion that reverses, at several speeds"


@dataclass(frozen=True, kw_only=True)
class VelocityMatch:
    """Regression of a joint's differentiated position on its velocity.

    Attributes
    ----------
    slope, error : change of the position over that of the velocity, and its standard error.
    correlation : between both, without the white noise of either.
    mismatch : share of the squared derivative that the velocity does not explain.
    lag, lag_error : of the velocity [s]; the error is infinite if no lag can be told.
    """

    slope: float
    error: float
    correlation: float
    mismatch: Estimate
    lag: float
    lag_error: float


def match_velocity(
    v: Array, dq: Array, period: float, noise: tuple[float, float] = (0.0, 0.0)
) -> VelocityMatch:
    """Compare a derivative `v` with `dq` (N,), `period` [s] apart, whose `noise` is known.

    At a constant speed deviations from the mean are noise, and only a slope through the origin
    tells; a velocity with an offset has the slope of its deviations. Whichever is more certain is
    the slope, and the better explanation the correlation.
    """
    slope_about_mean, correlation_about_mean = _compare_moments(
        v - np.mean(v), dq - np.mean(dq), noise
    )
    slope_through_origin, correlation_through_origin = _compare_moments(v, dq, noise)
    slope = min(slope_about_mean, slope_through_origin, key=lambda estimate: estimate.error)
    correlation = max(
        correlation_about_mean,
        correlation_through_origin,
        key=lambda estimate: abs(estimate.value),
    )
    mismatch_error = np.inf
    if np.isfinite(correlation.error):
        mismatch_error = 2.0 * abs(correlation.value) * correlation.error
    mismatch = Estimate(value=1.0 - correlation.value**2, error=mismatch_error)
    lag = _find_lag(v, dq, period)
    sign = -1.0 if correlation.value < 0.0 else 1.0
    return VelocityMatch(
        slope=sign * slope.value,
        error=slope.error,
        correlation=correlation.value,
        mismatch=mismatch,
        lag=lag.value,
        lag_error=lag.error,
    )


def _compare_moments(v: Array, dq: Array, noise: tuple[float, float]) -> tuple[Estimate, Estimate]:
    """Return the ratio of the sizes of two signals (N,), and their correlation.

    Their errors are those of the jackknife over blocks of time. White noise of either signal is
    taken out of its square.
    """
    count = min(_BLOCKS, len(v))
    edges = np.linspace(0, len(v), count + 1).astype(int)[:-1]
    moments = np.column_stack(
        [
            np.add.reduceat(v**2 - noise[0] ** 2, edges),
            np.add.reduceat(dq**2 - noise[1] ** 2, edges),
            np.add.reduceat(v * dq, edges),
        ]
    )
    total = moments.sum(axis=0)
    v_squares, dq_squares, products = np.vstack([total, total - moments]).T
    if np.min(v_squares) <= 0.0 or np.min(dq_squares) <= 0.0:
        # Nothing but noise: no ratio can be told.
        return Estimate(value=1.0, error=np.inf), Estimate(value=0.0, error=np.inf)
    ratios = np.sqrt(v_squares / dq_squares)
    correlations = np.clip(products / np.sqrt(v_squares * dq_squares), -1.0, 1.0)
    return _estimate_by_jackknife(ratios), _estimate_by_jackknife(correlations)


def _estimate_by_jackknife(values: Array) -> Estimate:
    """Return the first value, of all blocks, with the error from those without one block each."""
    estimates = values[1:]
    count = len(estimates)
    scatter = float(np.sum((estimates - estimates.mean()) ** 2))
    return Estimate(value=float(values[0]), error=float(np.sqrt(scatter * (count - 1) / count)))


def _compute_correlation(a: Array, b: Array) -> float:
    # Without scatter there is none, nor with a deviation of NaN.
    if not (np.std(a) > 0.0 and np.std(b) > 0.0):
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _find_lag(v: Array, dq: Array, period: float) -> Estimate:
    """Return the lag of dq [s], at the peak of the cross-correlation.

    Its error follows from the curvature of the likelihood there; at a constant speed it is flat.
    """
    max_shift = min(int(_MAX_LAG / period), len(v) // 4)
    unknown_lag = Estimate(value=0.0, error=np.inf)
    if max_shift < 1 or not (np.std(v) > 0.0 and np.std(dq) > 0.0):
        return unknown_lag
    inner_v = v[max_shift:-max_shift]
    shifts = np.arange(-max_shift, max_shift + 1)
    correlations = np.zeros(len(shifts))
    for k, shift in enumerate(shifts):
        shifted_dq = dq[max_shift + shift : len(dq) - max_shift + shift]
        correlations[k] = abs(_compute_correlation(inner_v, shifted_dq))
    best = int(np.argmax(correlations))
    lag = float(shifts[best] * period)
    if best in (0, len(shifts) - 1):
        return Estimate(value=lag, error=np.inf)
    best_shift = int(shifts[best])
    best_dq = dq[max_shift + best_shift : len(dq) - max_shift + best_shift]
    deviations = best_dq - np.mean(best_dq)
    squares = float(deviations @ deviations)
    slope = 0.0
    if squares > 0.0:
        slope = float(deviations @ inner_v) / squares
    residual = inner_v - np.mean(inner_v) - slope * deviations
    independent_rows = len(residual) / correlation_length(residual)
    unexplained = np.maximum(1.0 - correlations[best - 1 : best + 2] ** 2, 1e-12)
    before, at, after = 0.5 * independent_rows * np.log(unexplained)
    curvature = before - 2.0 * at + after
    if not curvature > 0.0:
        return Estimate(value=lag, error=np.inf)
    # A peak of noise is as sharp as one of motion, but hardly likelier than no lag.
    unexplained_at_once = max(1.0 - correlations[max_shift] ** 2, 1e-12)
    likelihood_gain = max(0.5 * independent_rows * np.log(unexplained_at_once) - at, 0.0)
    certainty = float(np.sqrt(2.0 * likelihood_gain))
    error = max(period / np.sqrt(curvature), abs(lag) / max(certainty, 1e-300))
    return Estimate(value=lag, error=float(error))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Velocities:
    """Velocities of a part beside the derivatives of its positions.

    Attributes
    ----------
    part : with all of its rows.
    description : of the robot.
    slides : (n,) whether each joint is prismatic.
    v, dq : (N, n) derivatives and logged velocities of the measured rows [rad/s, m/s].
    matches : of the joints that are judged, by index.
    """

    part: SmoothPart
    description: RobotDescription
    slides: Sequence[bool]
    v: Array
    dq: Array
    matches: Mapping[int, VelocityMatch]

    @cached_property
    def left_out(self) -> LeftOutRows:
        """Folds of the measured rows."""
        return LeftOutRows.split([self.part.log.name], [self.part.t[self.part.is_measured]])

    @cached_property
    def column_of_joint(self) -> dict[int, int]:
        """Column that follows the motion of each judged joint, if any; each serves one joint."""
        return _match_columns(self.v, self.dq, np.array(list(self.matches), dtype=int))


def check_velocity(
    part: SmoothPart,
    description: RobotDescription,
    excluded_joints: Collection[str] = (),
    coarse_joints: Collection[str] = (),
    slides: Sequence[bool] = (),
) -> Iterator[Hypothesis]:
    """Doubt velocities, but for resting joints.

    Parameters
    ----------
    part : rows of a log.
    description : of the robot.
    excluded_joints : joints that are not judged.
    coarse_joints : joints whose positions are too coarse to contradict a velocity.
    slides : (n,) whether each joint is prismatic; by default none is.
    """
    if part.dq is None:
        return
    slides = slides or (False,) * len(description.joints)
    rows = part.is_measured
    v = part.v[rows]
    dq = part.dq[rows]
    v_noise, dq_noise = part.estimate_speed_noise()
    matches: dict[int, VelocityMatch] = {}
    for j, joint in enumerate(description.joints):
        if part.is_moving[j] and joint not in excluded_joints:
            noise = float(v_noise[j]), float(dq_noise[j])
            matches[j] = match_velocity(v[:, j], dq[:, j], part.period, noise)
    velocities = _Velocities(
        part=part, description=description, slides=slides, v=v, dq=dq, matches=matches
    )
    for j, match in matches.items():
        joint = description.joints[j]
        mismatch = Statistic(
            name="the share of its motion that its velocity does not explain",
            estimate=match.mismatch,
            high=1.0 - _MIN_CORRELATION**2,
            errors=1.0,
        )
        if mismatch.outcome == "lost":
            yield from _doubt_sign(velocities, j)
            yield from _doubt_scale(velocities, j)
            yield from _doubt_lag(velocities, j)
        elif np.ptp(dq[:, j]) <= 1e-9 * np.max(np.abs(v[:, j])):
            yield Hypothesis(
                check="velocity-constant",
                joint=joint,
                observation="its position moves while its velocity never changes",
                remedy=f"the velocity is not logged; {_DERIVE_REMEDY}",
                changes={"log.columns.dq": ""},
            )
        else:
            hypothesis = _doubt_column(velocities, j, mismatch)
            if joint in coarse_joints:
                # The derivative of a coarse position may contradict a good velocity.
                hypothesis = replace(hypothesis, contradictions=("its position is coarse",))
            yield hypothesis


def _match_columns(v: Array, dq: Array, joints: Integers) -> dict[int, int]:
    """Return the column that follows the motion of each joint, if any; each serves one joint."""
    from scipy.optimize import linear_sum_assignment

    if not len(joints):
        return {}
    correlations = np.zeros((len(joints), len(joints)))
    for row, j in enumerate(joints):
        for column, k in enumerate(joints):
            correlations[row, column] = abs(_compute_correlation(v[:, j], dq[:, k]))
    rows, columns = linear_sum_assignment(-correlations)
    return {
        int(joints[row]): int(joints[column])
        for row, column in zip(rows, columns, strict=True)
        if correlations[row, column] > _MIN_CORRELATION
    }


def _doubt_column(velocities: _Velocities, j: int, mismatch: Statistic) -> Hypothesis:
    """Doubt that a column holds the velocity of a joint; another joint's column may."""
    description = velocities.description
    match = velocities.matches[j]
    joint = description.joints[j]
    column_of_joint = velocities.column_of_joint
    other_joint = column_of_joint.get(j, j)
    observation = f"its velocity does not follow its position (correlation {match.correlation:.2f})"
    if other_joint != j:
        columns = column_names(description.log.columns.dq, description.joints)
        ordered_columns = [columns[column_of_joint.get(k, k)] for k in range(len(columns))]
        race = Race(
            rival="its own column",
            rival_squares=_predict_squares(velocities, j, column=j),
            squares=_predict_squares(velocities, j, column=other_joint),
            min_gain=CURE_GAIN,
        )
        return Hypothesis(
            check="velocity-columns",
            joint=joint,
            observation=observation,
            remedy=f"its velocity is in the column of joint '{description.joints[other_joint]}'",
            trials=(mismatch, race),
            record=_TELLING_MOTION,
            changes={"log.columns.dq": tuple(ordered_columns)},
        )
    if abs(match.lag) > _MIN_LAG_TO_PERIOD * match.lag_error:
        observation += f", and is {match.lag * 1e3:.0f} ms late"
    return Hypothesis(
        check="velocity-match",
        joint=joint,
        observation=observation,
        remedy=f"the column contains another signal or a filtered one; {_DERIVE_REMEDY}",
        trials=(mismatch,),
        record=_TELLING_MOTION,
        changes={"log.columns.dq": ""},
    )


def _predict_squares(velocities: _Velocities, j: int, column: int) -> Array:
    """Return squared errors (N,) of a joint's derivative by a column of velocity, on folds."""
    dq = velocities.dq[:, [column]]
    return np.asarray(velocities.left_out.predict(dq, velocities.v[:, j]) ** 2)


def _doubt_lag(velocities: _Velocities, j: int) -> Iterator[Hypothesis]:
    """Doubt that a velocity is as early as its position."""
    part = velocities.part
    match = velocities.matches[j]
    resolution = max(_MIN_LAG_TO_SETTLING * part.settling, _MIN_LAG_TO_PERIOD * part.period)
    if abs(match.lag) <= resolution:
        return
    v = velocities.v[:, j]
    dq = velocities.dq[:, j]
    shift = round(match.lag / part.period)
    shifted_dq = np.roll(dq, -shift)
    # Rows that the shift takes from the other end are no data.
    is_inside = np.ones(len(v), dtype=bool)
    if shift > 0:
        is_inside[-shift:] = False
    else:
        is_inside[:-shift] = False
    # One slope and offset for both: a shifted window may hold more motion, which fits by itself.
    offset = float(np.mean(v - match.slope * dq))
    rival_errors = v - match.slope * dq - offset
    errors = v - match.slope * shifted_dq - offset
    relative_lag = Estimate(value=abs(match.lag) / resolution, error=match.lag_error / resolution)
    direction = "late" if match.lag > 0 else "early"
    yield Hypothesis(
        check="velocity-lag",
        joint=velocities.description.joints[j],
        observation=f"its velocity is {abs(match.lag) * 1e3:.0f} ms {direction} relative to its "
        "position",
        remedy=f"it was filtered or comes from another clock; {_DERIVE_REMEDY}",
        severity="warning",
        trials=(
            Statistic(
                name="its lag over the shortest that can be told",
                estimate=relative_lag,
                high=1.0,
            ),
            Race(
                rival="no lag",
                rival_squares=rival_errors[is_inside] ** 2,
                squares=errors[is_inside] ** 2,
            ),
        ),
        record=_TELLING_MOTION,
        changes={"log.columns.dq": ""},
    )


def _doubt_sign(velocities: _Velocities, j: int) -> Iterator[Hypothesis]:
    """Doubt that a velocity and its position count in the same direction."""
    description = velocities.description
    matches = velocities.matches
    match = matches[j]
    if match.slope > 0.0:
        return
    units = list(description.log.units.expand_per_joint("dq", len(description.joints)))
    for k, other_match in matches.items():
        if other_match.correlation < -_MIN_CORRELATION:
            units[k] = reverse_unit(units[k])
    scale = abs(match.slope)
    v = velocities.v[:, j]
    dq = velocities.dq[:, j]
    yield Hypothesis(
        check="velocity-sign",
        joint=description.joints[j],
        observation=f"its position falls where its velocity is positive (slope {match.slope:.2f})",
        remedy="velocity or position counts backwards",
        trials=(
            Race(
                rival="its sign as it is",
                rival_squares=(v - scale * dq) ** 2,
                squares=(v + scale * dq) ** 2,
                min_gain=CURE_GAIN,
            ),
        ),
        record=_TELLING_MOTION,
        changes={"log.units.dq": tuple(units)},
    )


def _doubt_scale(velocities: _Velocities, j: int) -> Iterator[Hypothesis]:
    """Doubt that a velocity and its position have the units that the file states."""
    match = velocities.matches[j]
    ratio = abs(match.slope)
    if abs(np.log(ratio)) < _MAX_SCALE_WARNING:
        return
    cause, changes = _find_cause(velocities, j)
    ratio_text = f"{ratio:.3g} times faster"
    if ratio <= 1:
        ratio_text = f"{1 / ratio:.3g} times slower"
    severity: Severity = "warning"
    if abs(np.log(ratio)) > _MAX_SCALE_ERROR:
        severity = "error"
    sign = float(np.sign(match.slope))
    v = velocities.v[:, j]
    dq = velocities.dq[:, j]
    yield Hypothesis(
        check="velocity-scale",
        joint=velocities.description.joints[j],
        observation=f"q changes {ratio_text} than dq",
        remedy=cause,
        severity=severity,
        trials=(
            Statistic(
                name="the ratio of both",
                estimate=Estimate(value=ratio, error=match.error),
                low=1.0,
                high=1.0,
            ),
            Race(
                rival="its unit as it is",
                rival_squares=(v - sign * dq) ** 2,
                squares=(v - match.slope * dq) ** 2,
            ),
        ),
        record=_TELLING_MOTION,
        changes=changes,
    )


def _find_cause(velocities: _Velocities, j: int) -> tuple[str, dict[str, object]]:
    """Return what explains the ratio of a position's change to its velocity, and its mend."""
    description = velocities.description
    matches = velocities.matches
    is_prismatic = velocities.slides[j]
    ratio = abs(matches[j].slope)
    concerns_all = all(
        abs(np.log(abs(other.slope) / ratio)) < _FACTOR_TOLERANCE for other in matches.values()
    )
    unit_cause = _find_joint_unit(velocities, j, concerns_all=concerns_all)
    if unit_cause is not None:
        return unit_cause
    if not is_prismatic:
        motor_cause = _find_motor_unit(description, j, ratio)
        if motor_cause is not None:
            return motor_cause
    if concerns_all:
        clock_cause = _find_clock(description.log.units, matches, velocities.part.log)
        if clock_cause is not None:
            return clock_cause
    if is_prismatic:
        return _UNKNOWN_CAUSE, {}
    if len(matches) == 1 and max(ratio, 1.0 / ratio) < _MAX_RATE_FACTOR:
        # Of a single joint a gear and a wrong rate of the stamps are the same.
        return f"{_UNKNOWN_CAUSE}, or the rate of the time stamps", {}
    return _find_gear(description, j, matches[j])


def _find_joint_unit(
    velocities: _Velocities, j: int, *, concerns_all: bool
) -> tuple[str, dict[str, object]] | None:
    """Return the unit of the position or velocity of a joint that explains their ratio."""
    ratio = abs(velocities.matches[j].slope)
    slides = velocities.slides
    units = velocities.description.log.units
    known_units = PRISMATIC_UNITS if slides[j] else REVOLUTE_UNITS
    # Sliding and rotary joints have different units.
    is_corrected = [
        k == j or (concerns_all and is_sliding == slides[j]) for k, is_sliding in enumerate(slides)
    ]
    # q' = q f scales the derivative of the position by f, dq' = dq f the logged velocity.
    needed_factors = {"dq": ratio, "q": 1.0 / ratio}
    quantities = ["dq", "q"]
    if np.max(np.ptp(velocities.part.q, axis=0)) > _MAX_ARM_TRAVEL:
        quantities = ["q", "dq"]  # the position is the likelier one
    for quantity in quantities:
        declared_factor = float(units.factors(quantity, len(slides))[j])
        unit = _find_unit(known_units[quantity], declared_factor, needed_factors[quantity])
        if unit is None:
            continue
        joint_units = units.replace_units(quantity, is_corrected, unit)
        is_only_unit = concerns_all and set(joint_units) == {unit}
        changes: dict[str, object] = {f"log.units.{quantity}": joint_units}
        if is_only_unit:
            changes = {f"log.units.{quantity}": unit}
        return f"{quantity} is in {unit}", changes
    return None


def _find_motor_unit(
    description: RobotDescription, j: int, ratio: float
) -> tuple[str, dict[str, object]] | None:
    """Return the unit in which a velocity or position before the stated gear explains a ratio."""
    if not description.gear_ratio or description.gear_ratio[j] == 1.0:
        return None
    gear_ratio = description.gear_ratio[j]
    units = description.log.units
    joint_count = len(description.joints)
    is_joint = [k == j for k in range(joint_count)]
    for quantity, needed_factor in (("dq", ratio), ("q", 1.0 / ratio)):
        # At the joint, a unit of the motor is smaller by the gear ratio.
        declared_factor = float(units.factors(quantity, joint_count)[j])
        motor_units = REVOLUTE_UNITS[quantity]
        unit = _find_unit(motor_units, declared_factor, needed_factor * gear_ratio)
        if unit is not None:
            size = float(f"{find_si_factor(quantity, unit) / gear_ratio:.6g}")
            joint_units = units.replace_units(quantity, is_joint, size)
            remedy = f"{quantity} belongs to the motor, in {unit}"
            return remedy, {f"log.units.{quantity}": joint_units}
    return None


def _find_clock(
    units: LogUnits, matches: Mapping[int, VelocityMatch], log: Log
) -> tuple[str, dict[str, object]] | None:
    """Return the unit of time, or the rate of stamps, that explains the ratio of all joints."""
    ratio = float(np.median([abs(match.slope) for match in matches.values()]))
    stated_factor = float(units.factors("t", 1)[0])
    tolerance = max(_compute_tolerance(match) for match in matches.values())
    for unit, factor in COMMON_UNITS["t"].items():
        is_plausible = is_plausible_period(log.period * factor / stated_factor)
        # A motor's speed before a gear has such ratios too, but its log then lasts for no time.
        is_long = float(np.ptp(log.t)) * factor / stated_factor >= SHORTEST_PART
        explains = abs(np.log(ratio * stated_factor / factor)) < tolerance
        if explains and is_plausible and is_long:
            return f"time is in {unit}", {"log.units.t": unit}
    if len(matches) > 1 and max(ratio, 1.0 / ratio) < _MAX_RATE_FACTOR:
        return (
            f"all joints agree: time stamps run {1 / ratio:.2g} times as fast as time (wrong "
            "sample rate), or the unit of dq is wrong",
            {"log.units.t": stated_factor * ratio},
        )
    return None


def _compute_tolerance(match: VelocityMatch) -> float:
    """Return the relative distance that the uncertainty of a ratio explains."""
    uncertainty = _RATIO_ERRORS * match.error / abs(match.slope)
    return float(np.clip(uncertainty, _MIN_RATIO_TOLERANCE, _FACTOR_TOLERANCE))


def _find_gear(
    description: RobotDescription, j: int, match: VelocityMatch
) -> tuple[str, dict[str, object]]:
    """Return a gear of whole turns before the joint that explains a velocity, if chance does not.

    Of large ratios, any is close to a whole number in some unit.
    """
    units = description.log.units
    joint_count = len(description.joints)
    tolerance = _compute_tolerance(match)
    declared_factor = float(units.factors("dq", joint_count)[j])
    declared_unit = units.expand_per_joint("dq", joint_count)[j]
    motor_units = dict(REVOLUTE_UNITS["dq"])
    if declared_unit != LogUnits().dq:  # which is no default, but stated
        motor_units = {str(declared_unit): declared_factor}
    for unit, factor in motor_units.items():
        gear_ratio = abs(factor / (match.slope * declared_factor))
        whole_ratio = round(gear_ratio)
        by_chance = 2.0 * tolerance * whole_ratio * len(motor_units)
        if whole_ratio < 2 or by_chance > _MAX_CHANCE:
            continue
        if abs(np.log(gear_ratio / whole_ratio)) < tolerance:
            is_joint = [k == j for k in range(joint_count)]
            size = float(f"{factor / whole_ratio:.6g}")
            return (
                f"dq belongs to a motor, in {unit}, that turns {whole_ratio} times per turn of the "
                "joint",
                {"log.units.dq": units.replace_units("dq", is_joint, size)},
            )
    remedy = _UNKNOWN_CAUSE
    if description.gear_ratio is None:
        remedy += ", or state gear_ratio if it belongs to a motor"
    return remedy, {}


def _find_unit(
    known_units: Mapping[str, float], declared_factor: float, needed_factor: float
) -> str | None:
    """Return the known unit that is `needed_factor` times the size of the declared one, or None."""
    for unit, factor in known_units.items():
        if abs(np.log(abs(factor / declared_factor) / needed_factor)) < _FACTOR_TOLERANCE:
            return f"-{unit}" if declared_factor < 0 else unit
    return None
