"""Law and servo of one joint in N.m, from a fit whose torques are over the gain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cosim.servo.current import CurrentReading, read_current
from cosim.servo.interval import NORMAL_QUANTILE, Interval, compute_interval
from cosim.servo.joint_fit import JointFit
from cosim.servo.record import ServoRecord, find_encoder_step
from cosim.servo.scale import TorqueScale, find_scale
from cosim.servo.start import delay_commands, find_moving_rows
from hesr_model.errors import FitError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.friction.servo import FittedServo, JointServo
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array, rms

MOST_UNEXPLAINED = 0.5  # least error over the ideal servo's that commands leave unexplained
_TORQUE = "N.m"
_UNSCALED = ("latency", "command_filter", "speed_limit")  # no torques
_COMMAND_REST = 0.3  # time after which a command rests [s]
_JOINT_REST = 0.2  # and a joint [s]
_RELEASE_TIME = 0.3  # after a joint was shaken loose, for its travel [s]
_RELEASE_STEPS = 3.0  # of the encoder, at least
_ROUNDING_STEPS = 1.5  # of the encoder, between which a resting joint may be read


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoResult:
    """Law and servo of one joint from commands; torques are in N.m where the scale is known.

    Attributes
    ----------
    law, servo, scale, trained : results of the joint.
    encoder_step : smallest step of the measured positions [rad; m].
    travel : of the joint in all logs [rad; m].
    largest_error : of the servo [rad; m].
    usual_friction : median size while the joint moves, over the gain [rad; m].
    release_count : how often a resting joint moved while its command rested.
    gravity_range : largest less smallest gravity over their mean; infinite without gravity.
    added_inertia : known inertia [kg.m2; kg] that every log added.
    current : kind of the current without a sign; None if it was not logged.
    """

    law: FrictionLaw
    servo: FittedServo
    scale: TorqueScale
    trained: TrainedRange
    encoder_step: float
    travel: float
    largest_error: float
    usual_friction: float
    release_count: int
    gravity_range: float
    added_inertia: float
    current: CurrentReading | None


def finish_joint(
    records: Sequence[ServoRecord],
    fit: JointFit,
    latency_error: float | None,
    description: RobotDescription,
    j: int,
    shared_scale: TorqueScale | None = None,
) -> ServoResult:
    """Scale the fit of joint j; raise FitError if the commands do not explain its motion.

    `latency_error` is the standard error [s] of a latency that the fit did not search. The
    `shared_scale` of other joints takes the place of its own.
    """
    ideal_errors = [delay_commands(record, fit.servo.latency) - record.q for record in records]
    ideal_rmse = float(rms(np.concatenate(ideal_errors)))
    if fit.rmse > MOST_UNEXPLAINED * ideal_rmse:
        raise FitError(
            f"joint '{records[0].joint}': the commands do not explain the motion (error "
            f"{fit.rmse:.2g} rad, {ideal_rmse:.2g} rad without any friction); are they "
            "filtered, of another time base, or of another joint?"
        )
    interval = compute_interval(fit, latency_error)
    current = _read_current(records, fit)
    scale = shared_scale or find_scale(interval, description, j, current)
    widths = _find_relative_widths(fit, interval, scale)
    law = _scale_law(fit.law, scale.gain, widths)
    servo = fit.servo.scale(scale.gain)
    intervals = _find_intervals(servo, fit.law, widths, scale, latency_error)
    if "body_factor" not in fit.names and scale.source != "none":
        servo, intervals = _separate_links(records, servo, intervals, description)
    friction = [_to_friction_record(record, servo, law) for record in records]
    moving = np.concatenate(find_moving_rows(records))
    sizes = np.abs(np.concatenate([record.tau for record in friction]))
    encoder_step = find_encoder_step(records)
    return ServoResult(
        law=law,
        servo=FittedServo(
            servo=servo,
            scale=scale.source,
            scale_error=scale.error,
            intervals=intervals,
            position_rmse=fit.rmse,
            ideal_rmse=ideal_rmse,
        ),
        scale=scale,
        trained=TrainedRange.from_records(friction),
        encoder_step=encoder_step,
        travel=max(float(np.ptp(record.q)) for record in records),
        largest_error=float(np.max(np.abs(np.concatenate(ideal_errors)))),
        usual_friction=float(np.median(sizes[moving])) / scale.gain,
        release_count=sum(count_releases(record, encoder_step) for record in records),
        gravity_range=_find_gravity_range(records),
        added_inertia=min(record.added for record in records),
        current=current,
    )


def _read_current(records: Sequence[ServoRecord], fit: JointFit) -> CurrentReading | None:
    """Return the kind of the current by the simulated servo, which is finer than the encoder.

    A servo with an integral is left out: its torque at the start is not known.
    """
    if fit.servo.ki > 0.0:
        return None
    ends = np.cumsum([len(record.t) for record in records])[:-1]
    servo_errors = []
    for record, residual in zip(records, np.split(fit.residual, ends), strict=True):
        commands = delay_commands(record, fit.servo.latency, fit.servo.command_filter)
        torque = commands - record.q - residual
        if fit.servo.kd > 0.0:
            torque = torque + fit.servo.kd * (record.dq_cmd - record.dq)
        if fit.servo.torque_limit is not None:
            torque = np.clip(torque, -fit.servo.torque_limit, fit.servo.torque_limit)
        servo_errors.append(torque)
    return read_current(records, servo_errors, fit.blocks)


def _find_relative_widths(
    fit: JointFit, interval: Interval, scale: TorqueScale
) -> dict[str, float]:
    """Return the relative half width of the interval of each unknown, in N.m if these are known."""
    widths = {}
    for name in fit.names:
        if _power_of_torque(name, fit.law) == 0:
            widths[name] = interval.scale(name, reference=None, error=0.0)
        else:
            widths[name] = interval.scale(name, reference=scale.reference, error=scale.error or 0.0)
    return widths


def _scale_law(law: FrictionLaw, gain: float, widths: Mapping[str, float]) -> FrictionLaw:
    """Return a law with all torques times the gain, and its standard errors."""
    values = {
        name: value * gain ** _power_of_torque(name, law) for name, value in law.values.items()
    }
    # A report shows 1.96 standard errors of a coefficient, which are to be its interval.
    standard_errors = {
        name: abs(values[name]) * width / NORMAL_QUANTILE
        for name, width in widths.items()
        if name in values and np.isfinite(width)
    }
    return replace(law, values=values, standard_errors=standard_errors)


def _find_intervals(
    servo: JointServo,
    law: FrictionLaw,
    widths: Mapping[str, float],
    scale: TorqueScale,
    latency_error: float | None,
) -> dict[str, float]:
    """Return the half widths of the intervals of the servo's values by name."""
    intervals = {
        name: abs(getattr(servo, name)) * width
        for name, width in widths.items()
        if name not in law.values and np.isfinite(width)
    }
    if latency_error is not None:
        intervals["latency"] = NORMAL_QUANTILE * latency_error
    if scale.source == "none":
        return intervals  # the gain over itself is 1
    relative_width = NORMAL_QUANTILE * (scale.error or 0.0)
    if scale.reference is not None:
        relative_width = widths[scale.reference]
    return {**intervals, "kp": scale.gain * relative_width}


def _separate_links(
    records: Sequence[ServoRecord],
    servo: JointServo,
    intervals: Mapping[str, float],
    description: RobotDescription,
) -> tuple[JointServo, dict[str, float]]:
    """Return the servo without the links' constant inertia, which the fit found as armature."""
    link_inertia = float(np.mean(np.concatenate([record.inertia for record in records])))
    link_width = NORMAL_QUANTILE * description.scale.body_error * link_inertia
    armature = max(servo.armature - link_inertia, 0.0)
    separated = replace(servo, armature=armature, body_factor=1.0)
    if "armature" not in intervals:
        return separated, dict(intervals)
    width = float(np.hypot(intervals["armature"], link_width))
    return separated, {**intervals, "armature": width}


def _power_of_torque(name: str, law: FrictionLaw) -> int:
    """Return the power of the torque in the unit of a coefficient, or of a value of the servo."""
    units = {coefficient.name: coefficient.unit for coefficient in law.form.coefficients}
    if name not in units:  # a value of the servo
        return 0 if name in _UNSCALED else 1
    unit = units[name].replace("(N.m)", _TORQUE)
    if unit.startswith(_TORQUE):
        return 1
    if f"/{_TORQUE}" in unit:
        return -1
    return 0


def _to_friction_record(record: ServoRecord, servo: JointServo, law: FrictionLaw) -> FrictionRecord:
    """Return the friction of a law along the measured motion, for the ranges of its training."""
    rotor = servo.armature + servo.added_factor * record.added
    load = servo.body_factor * record.tau_load + rotor * record.ddq
    bare = record.to_friction_record(load, np.zeros_like(load))
    tau: Array = predict_record(law, bare)
    return replace(bare, tau=tau)


def count_releases(record: ServoRecord, encoder_step: float) -> int:
    """Return how often a joint that rested moved off while its command rested.

    No law describes that. Vibration from other joints is a possible cause.
    """
    t = record.t
    [is_moving] = find_moving_rows([record])
    starts = np.flatnonzero(is_moving[1:] & ~is_moving[:-1]) + 1
    count = 0
    for row in starts:
        resting = slice(np.searchsorted(t, t[row] - _JOINT_REST), row)
        travelling = slice(row, np.searchsorted(t, t[row] + _RELEASE_TIME))
        first_command = int(np.searchsorted(t, t[row] - _COMMAND_REST))
        if np.ptp(record.q_cmd[first_command : travelling.stop]) > 0.0:
            continue
        rested = np.ptp(record.q[resting]) <= _ROUNDING_STEPS * encoder_step
        travel = np.max(np.abs(record.q[travelling] - record.q[resting.start]))
        count += int(rested and travel > _RELEASE_STEPS * encoder_step)
    return count


def _find_gravity_range(records: Sequence[ServoRecord]) -> float:
    """Return the range of gravity over its mean size."""
    bias = np.concatenate([record.bias for record in records])
    mean = abs(float(np.mean(bias)))
    if mean > 0.0:
        return float(np.ptp(bias)) / mean
    return np.inf
