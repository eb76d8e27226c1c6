"""Friction models with their servos, fitted to logs without torque."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from cosim.servo.fit import JointProblem
from cosim.servo.interval import compute_interval
from cosim.servo.joint_fit import JointFit
from cosim.servo.record import ServoRecord, read_servo_records
from cosim.servo.result import ServoResult, finish_joint
from cosim.servo.scale import find_shared_scale
from cosim.servo.sentences import describe_servo
from hesr_model.errors import FitError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.servo_description import ServoKind
from hesr_model.support import parallel
from hesr_model.support.progress import Progress, silent

_LEAST_LATENCY_ERROR = 5e-3  # [s] of a joint among several


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
    final_fits = list(fits)
    latency_error: float | None = None  # the fit's own
    if len(fits) > 1:
        common_latency, latency_error = latency or find_common_latency(fits)
        final_fits = _refit_all(records, robot, fits, common_latency, workers, report)
    results = _finish_joints(records, final_fits, latency_error, robot.description)
    sentences: list[str] = []
    for joint, result in zip(robot.joints, results, strict=True):
        sentences += [f"{joint}: {sentence}" for sentence in describe_servo(result)]
    periods = np.concatenate([np.diff(record.t) for record in records[0]])
    law_name = results[0].law.name
    if any(result.law.name != law_name for result in results):
        law_name = MIXED
    return FrictionModel(
        law=law_name,
        robot=robot.description.name,
        joints=robot.joints,
        laws=tuple(result.law for result in results),
        sliding=tuple(robot.slides),
        sample_time=round(float(np.median(periods)), 9),
        trained=tuple(result.trained for result in results),
        servos=tuple(result.servo for result in results),
        provenance={**provenance, "from_commands": sentences},
    )


def _finish_joints(
    records: Sequence[Sequence[ServoRecord]],
    fits: Sequence[JointFit],
    latency_error: float | None,
    description: RobotDescription,
) -> list[ServoResult]:
    """Scale the fits of all joints; one without a source takes the size of the same servos."""
    results = [
        finish_joint(joint_records, fit, latency_error, description, j)
        for j, (joint_records, fit) in enumerate(zip(records, fits, strict=True))
    ]
    shared_scale = find_shared_scale([result.scale for result in results])
    if not description.scale.same_servos or shared_scale is None:
        return results
    for j, result in enumerate(results):
        if result.scale.source == "none":
            results[j] = finish_joint(
                records[j], fits[j], latency_error, description, j, shared_scale
            )
    return results


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
    known_variance = float(np.sum((weights[is_known] * errors[is_known]) ** 2))
    variance = known_variance / float(np.sum(weights)) ** 2
    return mean, float(np.sqrt(variance + scatter))
