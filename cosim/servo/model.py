"""Friction models with their servos, fitted to logs without torque."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cosim.servo.fit import JointFit, JointProblem, find_encoder_step
from cosim.servo.interval import NORMAL_QUANTILE, Interval, compute_interval
from cosim.servo.record import ServoRecord, read_servo_records
from cosim.servo.scale import TorqueScale, find_scale
from cosim.servo.start import delay_commands
from hesr_model.errors import FitError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.friction.records import predict_record
from hesr_model.friction.servo import FittedServo, JointServo
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.servo_description import ServoKind
from hesr_model.support import parallel
from hesr_model.support.arrays import Array, rms
from hesr_model.support.progress import Progress, silent

MOST_UNEXPLAINED = 0.5  # least error over the ideal servo's that commands leave unexplained
_TORQUE = "N.m"
_LEAST_LATENCY_ERROR = 5e-3  # [s] of a joint among several
_MANY_STEPS = 3.0  # of the encoder: an error that it does not explain


@dataclass(frozen=True, kw_only=True, eq=False)
class ServoResult:
    """Law and servo of one joint from commands; torques are in N.m where the scale is known.

    `encoder_step` is the smallest step of the measured positions [rad; m].
    """

    law: FrictionLaw
    servo: FittedServo
    scale: TorqueScale
    encoder_step: float
    trained: TrainedRange


def fit_from_commands(
    logs: Sequence[Log],
    robot: Robot,
    law_name: str,
    *,
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> FrictionModel:
    """Fit a law and the servo of every joint to the motion that commands cause.

    Parameters
    ----------
    logs : logs with commanded positions.
    robot : robot of the logs.
    law_name : law without memory, of the registry.
    provenance : JSON data on the origin of the model.
    workers : processes, by default one per core.
    progress : called with joints done and in total.

    Returns
    -------
    FrictionModel
        With a servo per joint. Its torques are in N.m, or, if nothing fixes their size, over the
        gain of the servo.

    Raises
    ------
    FitError
        If the law has memory, a joint hardly moves, or commands do not explain its motion.
    """
    require_suitable(law_name)
    records = read_servo_records(logs, robot, robot.nominal_parameters)
    kind = robot.description.servo.kind
    jobs = [partial(_fit_joint, joint_records, law_name, kind) for joint_records in records]
    joint_count = len(jobs)
    with parallel.results_of(jobs, workers, names=robot.joints) as answers:
        fits = _collect(answers, lambda done: progress(done, 2 * joint_count))
    return finish_model(
        records,
        robot,
        fits,
        provenance=provenance or {},
        workers=workers,
        report=lambda done: progress(joint_count + done, 2 * joint_count),
    )


def finish_model(
    records: Sequence[Sequence[ServoRecord]],
    robot: Robot,
    fits: Sequence[JointFit],
    *,
    provenance: Mapping[str, Any],
    workers: int | None,
    report: Callable[[int], None],
    latency: tuple[float, float] | None = None,
) -> FrictionModel:
    """Return the model in N.m; several joints are fitted again with their common latency.

    The `latency` with its error [s] is by default that of the fits; `report` is called with the
    number of finished joints.
    """
    if len(fits) == 1:
        latency_error = None  # the fit's own
        finished = list(fits)
    else:
        common_latency, latency_error = latency or find_common_latency(fits)
        finished = _refit_all(records, robot, fits, common_latency, workers, report)
    results = [
        _finish_joint(joint_records, fit, latency_error, robot.description, j)
        for j, (joint_records, fit) in enumerate(zip(records, finished, strict=True))
    ]
    sentences = [
        f"{joint}: {sentence}"
        for joint, result in zip(robot.joints, results, strict=True)
        for sentence in describe_servo(result)
    ]
    periods = np.concatenate([np.diff(record.t) for record in records[0]])
    law_names = {result.law.name for result in results}
    return FrictionModel(
        law=law_names.pop() if len(law_names) == 1 else MIXED,
        robot=robot.description.name,
        joints=robot.joints,
        laws=tuple(result.law for result in results),
        sliding=tuple(robot.slides),
        sample_time=round(float(np.median(periods)), 9),
        trained=tuple(result.trained for result in results),
        servos=tuple(result.servo for result in results),
        provenance={**provenance, "from_commands": sentences},
    )


def require_suitable(law_name: str) -> None:
    """Raise FitError for a law with memory, whose states at the start are not known."""
    law = estimator(law_name)
    if law.form(law.typical).memory:
        raise FitError(
            f"law '{law_name}' has memory, which commands and positions do not show yet; take one "
            "without, such as coulomb_viscous, stribeck or bam_m4."
        )


def _collect(fits: Iterable[JointFit], report: Callable[[int], None]) -> list[JointFit]:
    """Return the fits as they arrive, and report their number."""
    collected = []
    for fit in fits:
        collected.append(fit)
        report(len(collected))
    return collected


def _fit_joint(records: Sequence[ServoRecord], law_name: str, kind: ServoKind) -> JointFit:
    with threadpool_limits(1), JointProblem(records, estimator(law_name), kind) as problem:
        return problem.fit()


def _refit_all(
    records: Sequence[Sequence[ServoRecord]],
    robot: Robot,
    fits: Sequence[JointFit],
    latency: float,
    workers: int | None,
    report: Callable[[int], None],
) -> list[JointFit]:
    """Return the fits of all joints with a common latency."""
    kind = robot.description.servo.kind
    jobs = [
        partial(_refit_joint, joint_records, fit.law.name, kind, fit, latency)
        for joint_records, fit in zip(records, fits, strict=True)
    ]
    with parallel.results_of(jobs, workers, names=robot.joints) as answers:
        return _collect(answers, report)


def _refit_joint(
    records: Sequence[ServoRecord],
    law_name: str,
    kind: ServoKind,
    fit: JointFit,
    latency: float,
) -> JointFit:
    with threadpool_limits(1), JointProblem(records, estimator(law_name), kind) as problem:
        return problem.refit(fit, latency)


def find_common_latency(fits: Sequence[JointFit]) -> tuple[float, float]:
    """Return the latency of all joints and its standard error [s], by the errors of each.

    One bus carries all commands, and a joint that hardly moves does not know how late they act.
    Where servos and laws are incomplete, the errors of single joints are too small: none weighs
    more than with `_LEAST_LATENCY_ERROR`, and the scatter between joints is part of the error.
    """
    pairs = [compute_interval(fit).find("latency") for fit in fits]
    if len(pairs) == 1:
        return pairs[0]
    latencies = np.array([latency for latency, _ in pairs])
    errors = np.array([error for _, error in pairs])
    weights = 1.0 / np.hypot(errors, _LEAST_LATENCY_ERROR) ** 2
    mean = float(np.average(latencies, weights=weights))
    scatter = float(np.average((latencies - mean) ** 2, weights=weights)) / (len(pairs) - 1)
    is_known = np.isfinite(errors)
    variance = (
        float(np.sum((weights[is_known] * errors[is_known]) ** 2)) / float(np.sum(weights)) ** 2
    )
    return mean, float(np.sqrt(variance + scatter))


def _finish_joint(
    records: Sequence[ServoRecord],
    fit: JointFit,
    latency_error: float | None,
    description: RobotDescription,
    j: int,
) -> ServoResult:
    """Scale the fit of joint j; raise FitError if the commands do not explain its motion."""
    interval = compute_interval(fit, latency_error)
    scale = find_scale(interval, description, j)
    ideal_rmse = _compute_ideal_rmse(records, fit.servo)
    if fit.rmse > MOST_UNEXPLAINED * ideal_rmse:
        raise FitError(
            f"joint '{records[0].joint}': the commands do not explain the motion (error "
            f"{fit.rmse:.2g} rad, {ideal_rmse:.2g} rad without any friction); are they "
            "filtered, of another time base, or of another joint?"
        )
    return _scale_result(records, fit, interval, scale, ideal_rmse, latency_error)


def _compute_ideal_rmse(records: Sequence[ServoRecord], servo: JointServo) -> float:
    """Return the position error [rad; m] of a servo that follows its delayed commands exactly."""
    errors = [delay_commands(record, servo.latency) - record.q for record in records]
    return float(rms(np.concatenate(errors)))


def _scale_result(
    records: Sequence[ServoRecord],
    fit: JointFit,
    interval: Interval,
    scale: TorqueScale,
    ideal_rmse: float,
    latency_error: float | None,
) -> ServoResult:
    """Return law and servo with torques in N.m if their scale is known."""
    gain = scale.gain
    scale_error = scale.error or 0.0
    servo = fit.servo.scale(gain)
    follows = scale.follows_gravity
    relative_widths = {
        name: interval.scale(
            name,
            follows_gravity=follows and _power_of_torque(name, fit.law) != 0,
            error=scale_error if _power_of_torque(name, fit.law) else 0.0,
        )
        for name in fit.names
    }
    values = {
        name: value * gain ** _power_of_torque(name, fit.law)
        for name, value in fit.law.values.items()
    }
    # A report shows 1.96 standard errors of a coefficient, which are to be its interval.
    standard_errors = {
        name: abs(values[name]) * relative_widths[name] / NORMAL_QUANTILE
        for name in values
        if name in relative_widths and np.isfinite(relative_widths[name])
    }
    law = replace(fit.law, values=values, standard_errors=standard_errors)
    intervals = {
        name: abs(getattr(servo, name)) * width
        for name, width in relative_widths.items()
        if name not in values and np.isfinite(width)
    }
    if latency_error is not None:
        intervals["latency"] = NORMAL_QUANTILE * latency_error
    if scale.source != "none":  # kp over itself is 1
        gravity_width = relative_widths.get("body_factor", 0.0)
        intervals["kp"] = gain * (gravity_width if follows else NORMAL_QUANTILE * scale_error)
    fitted = FittedServo(
        servo=servo,
        scale=scale.source,
        scale_error=scale.error,
        intervals=intervals,
        position_rmse=fit.rmse,
        ideal_rmse=ideal_rmse,
    )
    friction = [_to_friction_record(record, servo, law) for record in records]
    return ServoResult(
        law=law,
        servo=fitted,
        scale=scale,
        encoder_step=find_encoder_step(records),
        trained=TrainedRange.from_records(friction),
    )


def _power_of_torque(name: str, law: FrictionLaw) -> int:
    """Return the power of the torque in the unit of a coefficient, or of a value of the servo."""
    units = {coefficient.name: coefficient.unit for coefficient in law.form.coefficients}
    if name not in units:
        return 0 if name in ("latency", "command_filter", "speed_limit") else 1
    unit = units[name].replace("(N.m)", _TORQUE)
    if unit.startswith(_TORQUE):
        return 1
    return -1 if f"/{_TORQUE}" in unit else 0


def _to_friction_record(record: ServoRecord, servo: JointServo, law: FrictionLaw) -> FrictionRecord:
    """Return the friction of a law along the measured motion, for the ranges of its training."""
    load = servo.body_factor * record.tau_load + servo.armature * record.ddq
    bare = record.to_friction_record(load, np.zeros_like(load))
    tau: Array = predict_record(law, bare)
    return replace(bare, tau=tau)


# Values of a servo in sentences: name, unit with and without a scale, and factor.
_SHOWN = (
    ("kp", "gain", "N.m/rad", "", 1.0),
    ("ki", "integral gain", "N.m/(rad.s)", "1/s of the gain", 1.0),
    ("kd", "derivative gain", "N.m.s/rad", "s of the gain", 1.0),
    ("armature", "armature", "kg.m2", "s2 of the gain", 1.0),
    ("torque_limit", "torque limit", "N.m", "rad of the servo's error", 1.0),
    ("latency", "delay", "ms", "ms", 1e3),
    ("command_filter", "filter of commands", "ms", "ms", 1e3),
    ("speed_limit", "speed limit", "rad/s", "rad/s", 1.0),
)


def describe_servo(result: ServoResult) -> list[str]:
    """Return the sentences about the servo of a joint: its values, and what fixes their size."""
    fitted = result.servo
    has_scale = fitted.scale != "none"
    values = []
    for name, title, unit, ratio_unit, factor in _SHOWN:
        value = getattr(fitted.servo, name)
        shown_unit = unit if has_scale else ratio_unit
        if not value or not shown_unit:
            continue
        width = fitted.intervals.get(name)
        spread = "" if width is None else f" +- {factor * width:.2g}"
        values.append(f"{title} {factor * value:.4g}{spread} {shown_unit}")
    sentences = [
        f"{', '.join(values)}; position error {1e3 * fitted.position_rmse:.3g} mrad, "
        f"{1e3 * fitted.ideal_rmse:.3g} of an ideal servo"
    ]
    percent = 100.0 * (fitted.scale_error or 0.0)
    if fitted.scale == "none":
        sentences.append(
            "torques are known up to one factor; friction is in rad of the servo's error: state "
            "servo.kp or servo.torque_limit, or log a posture that gravity loads"
        )
    elif fitted.scale == "gravity":
        sentences.append(
            f"scale from gravity, +- {percent:.0f} %: as good as the masses of the model file"
        )
    else:
        sentences.append(f"scale from the stated {fitted.scale}, +- {percent:.0f} %")
    if fitted.position_rmse > _MANY_STEPS * result.encoder_step:
        sentences.append(
            f"the error is {fitted.position_rmse / result.encoder_step:.0f} steps of the encoder: "
            "servo or law is incomplete, and friction may hold what the servo does"
        )
    if result.scale.contradiction is not None:
        sentences.append(
            f"servo.kp and the model's gravity disagree by a factor of "
            f"{result.scale.contradiction:.3g}: is the base tilted, a mass missing, or the gain in "
            "other units? the gain is kept"
        )
    return sentences
