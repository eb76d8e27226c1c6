"""All checks of logs against their robot, and of fits; findings merged over logs and joints."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np

from hesr_model.errors import ArgumentError, FitError, LogError
from hesr_model.findings import Finding, sort_by_severity
from hesr_model.fitting.estimator import select_laws
from hesr_model.friction.model import FrictionModel
from hesr_model.health import omissions, positions
from hesr_model.health import torque as efforts
from hesr_model.health.directions import doubt_one_slope
from hesr_model.health.evidence import (
    ModelTorques,
    SmoothPart,
    TorqueFit,
    find_rests,
    smooth_parts,
    to_logged_side,
)
from hesr_model.health.mistakes import check_causes
from hesr_model.health.referee import Estimate, Hypothesis, Statistic, judge, state
from hesr_model.health.timing import check_clocks
from hesr_model.health.torque import NO_SIGNAL_R2, TorqueFits, check_torque, fit_joint_torques
from hesr_model.health.velocity import check_velocity
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, moving, reversals
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.residual import find_resting_speed, transform_all_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import transform_motion
from hesr_model.support.arrays import Array, select_rows
from hesr_model.units import unit_of_joint

CHECKS = (
    *("time-unit", "gaps", "missing-rows", "dropped-rows", "wrap", "spikes", "coarse", "limits"),
    "sliding-unit",
    *("stuck", "held-samples", "torque-spikes", "speed-limit", "time-scale", "no-friction"),
    *("same-column", "velocity-constant", "velocity-columns", "velocity-match", "velocity-sign"),
    *("velocity-scale", "velocity-lag", "torque-constant", "saturation", "torque-sign"),
    *("torque-scale", "torque-signal", "torque-lag", "torque-limit", "torque-small"),
    *("torque-columns", "position-sign", "joint-order", "zero", "gravity", "gravity-sign"),
    "angle-unit",
    *("torque-unsigned", "position-integral", "other-robot"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Examination:
    """What the checks of logs say, and what they were derived from.

    Attributes
    ----------
    findings : merged over logs and joints, errors first.
    parts : parts of the logs whose time is sound.
    torques : of the model along each part; empty without a model.
    fits : regressions of the torques of each part, by joint; empty without a model.
    undecided : hypotheses that the logs can neither confirm nor contradict, as advice.
    """

    findings: tuple[Finding, ...] = ()
    parts: tuple[SmoothPart, ...] = ()
    torques: tuple[ModelTorques, ...] = ()
    fits: tuple[TorqueFits, ...] = ()
    undecided: tuple[Finding, ...] = ()


def examine(logs: Sequence[Log], description: RobotDescription, robot: Robot | None) -> Examination:
    """Check logs one by one, against the model, and together; raises LogError.

    Of logs without torque only time, positions and velocities are checked.
    """
    if not all(log.has_torque for log in logs):
        return _examine_motion(logs, description, robot)
    checks = (positions.check_jumps, positions.check_steps, efforts.check_raw_signals)
    hypotheses, parts = _check_rows(logs, description, checks)
    # The acceleration of a guessed end may be wrong by all of it.
    measured_parts = [select_rows(part, part.is_measured) for part in parts]
    slides = _list_sliding(robot)
    if robot and (description.known is not None or robot.springs):
        robot = _inform_robot(robot, measured_parts)
    modelled_parts: list[_ModelledPart] = []
    measured_torques: list[ModelTorques | None] = [None] * len(parts)
    if robot:
        modelled_parts = [_ModelledPart.from_part(part, robot, description) for part in parts]
        measured_torques = [modelled_part.measured_torques for modelled_part in modelled_parts]
    broken_joints = _collect_joints(hypotheses, ("wrap", "spikes"))
    coarse_joints = _collect_joints(hypotheses, ("coarse",))
    for part, measured_part, torques in zip(parts, measured_parts, measured_torques, strict=True):
        hypotheses += _check_omissions(measured_part, torques, description)
        hypotheses += _check_motion(part, description, robot, broken_joints, coarse_joints, slides)
        hypotheses += add_log_name(part.log, positions.check_columns(part, description))
    hypotheses += _doubt_direction(parts, description)
    hypotheses += _doubt_one_speed(measured_parts, description, slides)
    judgement = judge(hypotheses)
    findings = list(judgement.findings)
    undecided = list(judgement.undecided)
    if robot and not _lacks_evidence(findings) and not is_hopeless(findings):
        for modelled_part in modelled_parts:
            part_judgement = judge(_check_torques(modelled_part, description, robot, coarse_joints))
            findings += part_judgement.findings
            undecided += part_judgement.undecided
        cause_judgement = judge(check_causes(measured_parts, robot))
        findings = _replace_symptoms(findings, cause_judgement.findings)
        undecided += cause_judgement.undecided
    return Examination(
        findings=tuple(merge_findings(_remove_followers(findings))),
        parts=tuple(parts),
        torques=tuple(modelled_part.torques for modelled_part in modelled_parts),
        fits=tuple(modelled_part.fits for modelled_part in modelled_parts),
        undecided=tuple(merge_findings(undecided)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _ModelledPart:
    """A part of a log, and what a model and its regressions say of it.

    Attributes
    ----------
    part : with all of its rows.
    torques : of the model along all rows.
    measured_torques : along the rows that smoothing did not have to guess at an end.
    logged_part, logged_torques : of the measured rows, at the side that the log measures.
    fits : regressions of the logged torques, by index of the joint.
    """

    part: SmoothPart
    torques: ModelTorques
    measured_torques: ModelTorques
    logged_part: SmoothPart
    logged_torques: ModelTorques
    fits: TorqueFits

    @classmethod
    def from_part(
        cls, part: SmoothPart, robot: Robot, description: RobotDescription
    ) -> "_ModelledPart":
        """Evaluate the model along a part and regress the torques."""
        torques = ModelTorques.from_motion(robot, part.q, part.v, part.a)
        measured_torques = select_rows(torques, part.is_measured)
        measured_part = select_rows(part, part.is_measured)
        logged_part, logged_torques = to_logged_side(
            measured_part, measured_torques, description.logged
        )
        return cls(
            part=part,
            torques=torques,
            measured_torques=measured_torques,
            logged_part=logged_part,
            logged_torques=logged_torques,
            fits=fit_joint_torques(logged_part, logged_torques),
        )


def _list_sliding(robot: Robot | None) -> tuple[bool, ...]:
    """Return which joints slide; empty without a model."""
    if robot is None:
        return ()
    return tuple(robot.slides)


RowCheck = Callable[[Log, RobotDescription], Iterable[Hypothesis]]


def _check_rows(
    logs: Sequence[Log], description: RobotDescription, checks: Sequence[RowCheck]
) -> tuple[list[Hypothesis], list[SmoothPart]]:
    """Check the time of logs, then their rows; return the parts whose time is sound as well."""
    hypotheses: list[Hypothesis] = []
    parts: list[SmoothPart] = []
    for log in logs:
        time_hypotheses = add_log_name(log, positions.check_time(log, description))
        hypotheses += time_hypotheses
        if any(hypothesis.severity == "error" for hypothesis in time_hypotheses):
            continue
        for check in checks:
            hypotheses += add_log_name(log, check(log, description))
        parts += smooth_parts(log, description.log.filter_cutoff)
    return hypotheses, find_rests(parts)


def _check_motion(
    part: SmoothPart,
    description: RobotDescription,
    robot: Robot | None,
    broken_joints: set[str],
    coarse_joints: set[str],
    slides: Sequence[bool],
) -> list[Hypothesis]:
    """Check velocities, and positions and speeds against the limits of the model."""
    hypotheses = [*check_velocity(part, description, broken_joints, coarse_joints, slides)]
    if robot and description.log.columns.q:
        hypotheses += positions.check_limits(part, robot)
        hypotheses += positions.check_sliding(part, robot)
        hypotheses += efforts.check_speed(part, robot)
    return add_log_name(part.log, hypotheses)


def _check_omissions(
    part: SmoothPart, torques: ModelTorques | None, description: RobotDescription
) -> list[Hypothesis]:
    """Check what the measured rows of a part leave out."""
    hypotheses = [
        *omissions.check_signs(part, torques, description),
        *omissions.check_integral(part, torques, description),
    ]
    return add_log_name(part.log, hypotheses)


def _check_torques(
    modelled_part: _ModelledPart,
    description: RobotDescription,
    robot: Robot,
    coarse_joints: set[str],
) -> list[Hypothesis]:
    """Check clocks, torques and lost rows of a part against the model."""
    part = modelled_part.part
    fits = modelled_part.fits
    explained_joints = [j for j, fit in fits.items() if fit.r2 > NO_SIGNAL_R2]
    clock_hypotheses, late_joints = check_clocks(part, explained_joints, robot)
    blurred_joints = set(late_joints)
    blurred_joints |= {j for j in fits if description.joints[j] in coarse_joints}
    torque_hypotheses = check_torque(
        modelled_part.logged_part,
        fits,
        robot,
        blurred_joints,
        modelled_part.logged_torques,
        is_stated=description.known is None,
    )
    # Lost rows blur the ends as well.
    logged_side = to_logged_side(part, modelled_part.torques, description.logged)
    loss_hypotheses = positions.check_loss(*logged_side, robot)
    return add_log_name(part.log, (*clock_hypotheses, *torque_hypotheses, *loss_hypotheses))


def _examine_motion(
    logs: Sequence[Log], description: RobotDescription, robot: Robot | None
) -> Examination:
    """Check time, positions and velocities of logs without torque."""
    checks = (positions.check_jumps, positions.check_steps)
    hypotheses, parts = _check_rows(logs, description, checks)
    broken_joints = _collect_joints(hypotheses, ("wrap", "spikes"))
    coarse_joints = _collect_joints(hypotheses, ("coarse",))
    slides = _list_sliding(robot)
    for part in parts:
        hypotheses += _check_motion(part, description, robot, broken_joints, coarse_joints, slides)
    judgement = judge(hypotheses)
    return Examination(
        findings=tuple(merge_findings(judgement.findings)),
        parts=tuple(parts),
        undecided=tuple(merge_findings(judgement.undecided)),
    )


def _doubt_direction(
    parts: Sequence[SmoothPart], description: RobotDescription
) -> Iterator[Hypothesis]:
    """Doubt that joints which never reverse show friction, by measured rows only."""
    for j, joint in enumerate(description.joints):
        moving_parts = [part for part in parts if part.is_moving[j]]
        yield from omissions.doubt_direction(
            joint,
            [part.log.q[:, j] for part in moving_parts],
            [part.log.name for part in moving_parts],
        )


def _doubt_one_speed(
    parts: Sequence[SmoothPart], description: RobotDescription, slides: Sequence[bool]
) -> Iterator[Hypothesis]:
    """Doubt that joints which move at one speed show Coulomb and viscous friction."""
    for j, joint in enumerate(description.joints):
        moving_parts = [part for part in parts if part.is_moving[j]]
        resting_speed = 0.0
        if moving_parts:
            resting_speed = moving_parts[0].find_resting_speed(j)
        yield from omissions.doubt_one_speed(
            joint,
            unit_of_joint("rad/s", is_prismatic=bool(slides) and slides[j]),
            [part.t for part in moving_parts],
            [part.v[:, j] for part in moving_parts],
            resting_speed,
        )


def _lacks_evidence(findings: Sequence[Finding]) -> bool:
    """Return whether torques without a sign, or unknown angles, show neither scales nor causes."""
    return any(
        finding.check in ("torque-unsigned", "position-integral") and finding.severity == "error"
        for finding in findings
    )


def _collect_joints(hypotheses: Sequence[Hypothesis], checks: Sequence[str]) -> set[str]:
    """Return the joints that the referee finds faulty in one of some checks."""
    findings = state(hypothesis for hypothesis in hypotheses if hypothesis.check in checks)
    return set(chain.from_iterable(finding.joints for finding in findings))


def _inform_robot(robot: Robot, parts: Sequence[SmoothPart]) -> Robot | None:
    """Return a robot whose unknown parameters are identified, or None if that fails."""
    informed_robot = copy(robot)
    if robot.description.known is None:  # then only its springs, if any, are unknown
        update = {"known": robot.parameter_names[: robot.inertial]}
        robot = Robot(robot.description.model_copy(update=update))
    motions = [
        Motion(
            name=part.log.name,
            t=part.t,
            q=part.q,
            # Unsmoothed: its noise decides whether a slow joint moves.
            q_raw=part.log.q[np.searchsorted(part.log.t, part.t)],
            dq=part.v,
            ddq=part.a,
            tau=part.tau,
        )
        for part in parts
    ]
    try:
        # A negative inertia shows a torque that counts backwards.
        body = identify_motions(motions, robot, holds=False)
        informed_robot.nominal_parameters = body.parameters
    except FitError:
        return None
    return informed_robot


def is_hopeless(findings: Sequence[Finding]) -> bool:
    """Return whether errors of units or positions hide what the model would show."""
    error_findings = [finding for finding in findings if finding.severity == "error"]
    units = {"log.units.t", "log.units.q"}
    return any(
        finding.check in ("limits", "wrap", "spikes") or units & set(finding.changes)
        for finding in error_findings
    )


_CHECKS_OF_ROWS = ("dropped-rows", "gaps")  # whose counts differ by log
SYMPTOMS = (
    *("torque-sign", "torque-scale", "torque-signal", "torque-lag", "torque-small", "time-scale"),
    "gravity-sign",
)  # Checks whose findings a deeper cause can explain


def _replace_symptoms(
    findings: Sequence[Finding], cause_findings: Sequence[Finding]
) -> list[Finding]:
    """Replace symptoms by causes that explain them: one of a joint only its own, others all."""
    reversed_joints: set[str] = set()
    explains_all = False
    for cause_finding in cause_findings:
        if cause_finding.check == "torque-sign":
            reversed_joints |= set(cause_finding.joints)
        if cause_finding.check != "torque-sign" or not cause_finding.joints:
            explains_all = True
    remaining_findings: list[Finding] = []
    sign_observations: dict[tuple[str, ...], str] = {}  # by joints
    for finding in findings:
        is_explained = explains_all or bool(reversed_joints & set(finding.joints))
        if finding.check not in SYMPTOMS or not is_explained:
            remaining_findings.append(finding)
        if finding.check == "torque-sign":
            sign_observations[finding.joints] = finding.found
    restated_findings: list[Finding] = []
    for cause_finding in cause_findings:
        is_of_sign = cause_finding.check in ("torque-sign", "position-sign")
        if is_of_sign and cause_finding.joints in sign_observations:
            observation = sign_observations[cause_finding.joints]
            restated_findings.append(replace(cause_finding, found=observation))
        else:
            restated_findings.append(cause_finding)
    return [*remaining_findings, *restated_findings]


def _remove_followers(findings: Sequence[Finding]) -> list[Finding]:
    """Remove what other findings explain: contradicting velocities, and speeds in wrong units."""
    explained_joints = {
        finding.joints
        for finding in findings
        if finding.check in ("velocity-columns", "same-column")
    }
    is_coarse = any(finding.check == "coarse" for finding in findings)
    changes_units = any(map(_changes_units, findings))
    explains_speeds = changes_units or is_coarse or is_hopeless(findings)
    remaining_findings: list[Finding] = []
    for finding in findings:
        if finding.check == "velocity-match":
            is_explained = finding.joints in explained_joints
        elif finding.check in ("time-scale", "speed-limit"):
            is_explained = explains_speeds
        else:
            is_explained = False
        if not is_explained:
            remaining_findings.append(finding)
    return remaining_findings


def _changes_units(finding: Finding) -> bool:
    return any(key.startswith("log.units") for key in finding.changes)


def check_logs(logs: Sequence[Log], robot: Robot, accepted: Sequence[str] = ()) -> list[Finding]:
    """Check logs; return warnings and accepted errors, or raise HealthError."""
    require_known(accepted, CHECKS)
    return require_sound(examine(logs, robot.description, robot).findings, accepted)


class HealthError(LogError):
    """Impossible data, a line per finding."""

    def __init__(self, message: str, findings: Sequence[Finding]) -> None:
        super().__init__(message)
        self.findings = tuple(findings)

    def format_for_command_line(self, options: Mapping[str, str]) -> str:
        """Return the message with an option for each accepted check."""
        checks = _list_checks(self.findings)
        accept_options = " ".join(f"{options.get('accept', '--accept')} {name}" for name in checks)
        return str(self).replace(f"accept={checks}", accept_options)


def _list_checks(findings: Sequence[Finding]) -> list[str]:
    return list(dict.fromkeys(finding.check for finding in findings))


def _format_refusal(findings: Sequence[Finding]) -> str:
    lines = [f"{finding.sentence} [{finding.check}]" for finding in findings]
    hint = ""
    if any(finding.changes for finding in findings):
        hint = "hesr inspect tries the changes on these logs. "
    advice = f"{hint}To continue anyway: accept={_list_checks(findings)}."
    if len(lines) == 1:
        return f"{lines[0]} {advice}"
    return "\n  ".join([f"{len(lines)} errors in the data.", *lines, advice])


def add_log_name(log: Log, hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses with the name of their log."""
    return [replace(hypothesis, logs=(log.name,)) for hypothesis in hypotheses]


def merge_findings(findings: Iterable[Finding]) -> list[Finding]:
    """Merge findings of several logs or joints; errors first."""
    log_findings = _merge_by_key(findings, _get_place)
    return sort_by_severity(_merge_by_key(log_findings, _get_statement))


def _get_place(finding: Finding) -> tuple[object, ...]:
    return finding.check, finding.joints, _get_counted_rows(finding)


def _get_statement(finding: Finding) -> tuple[object, ...]:
    statement = finding.check, finding.severity, finding.remedy, repr(finding.changes)
    return *statement, _get_counted_rows(finding)


def _get_counted_rows(finding: Finding) -> str:
    """Return the observation of a finding that counts the rows of one log; "" of others."""
    return finding.found if finding.check in _CHECKS_OF_ROWS else ""


def _merge_by_key(findings: Iterable[Finding], key: Callable[[Finding], object]) -> list[Finding]:
    """Merge findings with the same key; the worst one speaks for the joints and logs of all."""
    groups: dict[object, list[Finding]] = {}
    for finding in findings:
        groups.setdefault(key(finding), []).append(finding)
    merged_findings = []
    for group in groups.values():
        worst_finding = sort_by_severity(group)[0]
        joints = dict.fromkeys(chain.from_iterable(finding.joints for finding in group))
        logs = dict.fromkeys(chain.from_iterable(finding.logs for finding in group))
        merged_findings.append(replace(worst_finding, joints=tuple(joints), logs=tuple(logs)))
    return merged_findings


def require_sound(findings: Sequence[Finding], accepted: Sequence[str] = ()) -> list[Finding]:
    """Return all findings, or raise HealthError with errors not accepted."""
    refused_findings = [
        finding
        for finding in findings
        if finding.severity == "error" and finding.check not in accepted
    ]
    if refused_findings:
        raise HealthError(_format_refusal(refused_findings), refused_findings)
    return list(findings)


def require_known(accepted: Sequence[str], checks: Sequence[str]) -> None:
    """Raise ConfigError if `accepted` contains an unknown check."""
    for check in accepted:
        if check not in checks:
            raise ArgumentError(f"'accept' is '{check}'; the checks are {', '.join(checks)}.")


_MIN_REST_SHARE = 0.02  # share of rests that shows stiction
_MIN_REVERSALS = 4
_SLOW_SPEED_SHARE = 0.1  # of the peak speed, below which a row is slow
_MIN_SLOW_ROWS_SHARE = 0.05  # share of slow rows that is needed
_MIN_GRAVITY_TO_FRICTION = 0.5  # gravity over friction that shows load-dependent friction


def bears_load(fits: TorqueFits) -> bool:
    """Return whether the load of a joint changes enough to show load-dependent friction."""
    return any(fit.bears_gravity and _changes_load(fit) for fit in fits.values())


def _changes_load(fit: TorqueFit) -> bool:
    return fit.gravity_size >= _MIN_GRAVITY_TO_FRICTION * fit.friction_size


def find_unseen_effects(
    examination: Examination, joints: Sequence[str]
) -> Iterator[tuple[str, str]]:
    """Yield joints with effects that the logs do not show, and what they do not decide."""
    for finding in examination.undecided:
        for joint in finding.joints or ("all joints",):
            yield joint, f"{finding.found}: {finding.remedy}"
    for j, joint in enumerate(joints):
        for effect in _find_unseen_of_joint(examination, j):
            yield joint, effect


def _find_unseen_of_joint(examination: Examination, j: int) -> Iterator[str]:
    """Yield effects that the motion and the torques of a joint do not show."""
    part_numbers = [k for k, part in enumerate(examination.parts) if part.is_moving[j]]
    if not part_numbers:
        yield "it does not move in any log"
        return
    speeds = [examination.parts[k].v[:, j] for k in part_numbers]
    v = np.concatenate(speeds)
    resting_speed = examination.parts[0].find_resting_speed(j)
    reversal_count = sum(len(reversals(speed, resting_speed)) for speed in speeds)
    if reversal_count < _MIN_REVERSALS:
        yield f"fewer than {_MIN_REVERSALS} reversals: neither hysteresis nor an offset"
    if np.mean(~moving(v, resting_speed)) < _MIN_REST_SHARE:
        yield "hardly any rest: no stiction"
    is_slow = np.abs(v) < _SLOW_SPEED_SHARE * np.max(np.abs(v))
    if np.mean(is_slow) < _MIN_SLOW_ROWS_SHARE:
        yield "hardly any slow motion: no Stribeck effect"
    fits = [
        joint_fits[j]
        for k, joint_fits in enumerate(examination.fits)
        if k in part_numbers and j in joint_fits
    ]
    if fits and not any(fit.bears_gravity for fit in fits):
        yield "no gravity torque: its torque constant cannot be checked"
    elif fits and not any(map(_changes_load, fits)):
        yield "hardly any change of load: no load-dependent friction"


_STATE_COUNT = 60
_MIN_USELESS_ERROR = 0.95  # error over deviation of a law that explains nothing
_BOUND_TOLERANCE = 0.01
_MIN_NEGATIVE_FRICTION = 0.5  # negative friction over the residual


def check_body(
    body: RigidBody, robot: Robot, motions: Sequence[Log | Motion] = ()
) -> list[Finding]:
    """Check that a mass matrix is positive definite and friction brakes.

    Parameters
    ----------
    body : identified from logs.
    robot : its robot.
    motions : logs or motions; friction must brake at their usual speeds, or at rest if there are
        none.
    """
    return state(_doubt_body(body, robot, _find_usual_speeds(motions, robot)))


def _find_usual_speeds(motions: Sequence[Log | Motion], robot: Robot) -> Array:
    """Return the median speed (n,) of rows in motion, at friction coordinates; 0 without any."""
    usual_speeds = np.zeros(robot.n)
    if not motions:
        return usual_speeds
    velocities = [_compute_velocities(motion) for motion in motions]
    speeds = np.abs(transform_motion(robot.description.coupling, np.concatenate(velocities)))
    for j, joint_speeds in enumerate(speeds.T):
        moving_speeds = joint_speeds[joint_speeds > _SLOW_SPEED_SHARE * np.max(joint_speeds)]
        if len(moving_speeds):
            usual_speeds[j] = float(np.median(moving_speeds))
    return usual_speeds


def _compute_velocities(motion: Log | Motion) -> Array:
    """Return velocities (N, n), of a log from its positions."""
    if isinstance(motion, Log):
        return efforts.compute_speeds(motion)
    return motion.dq


def _doubt_body(body: RigidBody, robot: Robot, usual_speeds: Array) -> Iterator[Hypothesis]:
    joints = robot.description.joints
    least_inertia = _find_least_inertia(body, robot)
    if least_inertia.eigenvalue <= 0.0:
        positions_text = ", ".join(f"{position:.2f}" for position in least_inertia.q)
        example = f"{least_inertia.eigenvalue:.2g}, for instance at q = {positions_text}"
        remedy = "the identified masses are not physically possible; use longer or faster logs"
        if not robot.description.known:  # which exclude it
            remedy += "; the physical body excludes such masses"
        yield Hypothesis(
            check="mass-matrix",
            joint=joints[least_inertia.j],
            observation=f"the identified mass matrix is not positive definite (eigenvalue "
            f"{example})",
            remedy=remedy,
            severity="warning",
        )
    for j, (coulomb, viscous, _) in enumerate(body.friction):
        unit = unit_of_joint("N.m", is_prismatic=robot.slides[j])
        speed_unit = unit_of_joint("rad/s", is_prismatic=robot.slides[j])
        # A line over the speeds seen may fall below 0 at rest, as of friction that grows with v^2.
        sliding_friction = coulomb + viscous * usual_speeds[j]
        residual_size = max(float(body.rmse[j]), 1e-300)  # an exact fit leaves nothing
        yield Hypothesis(
            check="negative-friction",
            joint=joints[j],
            observation=f"its friction at {usual_speeds[j]:.3g} {speed_unit} is identified as "
            f"{sliding_friction:.3g} {unit}",
            remedy="torque or velocity count backwards, or lag each other",
            severity="warning",
            trials=(
                Statistic(
                    name="its negative friction over what the body leaves unexplained",
                    estimate=Estimate(value=-sliding_friction / residual_size, error=0.0),
                    high=_MIN_NEGATIVE_FRICTION,
                ),
            ),
        )


class _LeastInertia(NamedTuple):
    """The state in which a mass matrix is least definite.

    Attributes
    ----------
    eigenvalue : the lowest one of the matrix over the usual inertia of its joints.
    q : positions (n,) [rad, m].
    j : index of the joint that moves most in this direction.
    """

    eigenvalue: float
    q: Array
    j: int


def _find_least_inertia(body: RigidBody, robot: Robot) -> _LeastInertia:
    lower, upper, _ = robot.reach
    q = np.random.default_rng(0).uniform(lower, upper, (_STATE_COUNT, robot.n))
    mass_matrices, _ = robot.dynamics(body.parameters, q, np.zeros_like(q))
    mass_matrices = 0.5 * (mass_matrices + mass_matrices.transpose(0, 2, 1))
    # Over the usual inertia of each joint, so that a light wrist counts as much as the base.
    mean_inertias = np.mean(np.diagonal(mass_matrices, axis1=1, axis2=2), axis=0)
    scale = np.sqrt(np.maximum(np.abs(mean_inertias), 1e-12))
    eigenvalues, eigenvectors = np.linalg.eigh(mass_matrices / np.outer(scale, scale))
    worst_row = int(np.argmin(eigenvalues[:, 0]))
    return _LeastInertia(
        eigenvalue=float(eigenvalues[worst_row, 0]),
        q=q[worst_row],
        j=int(np.argmax(np.abs(eigenvectors[worst_row, :, 0]))),
    )


def check_laws(
    models: Mapping[str, FrictionModel], records: Sequence[Sequence[FrictionRecord]]
) -> list[Finding]:
    """Check laws fitted to records [joint][log]; the baselines are there to be beaten.

    What the records cannot show of friction is advice.
    """
    friction_records = transform_all_records(records)
    judgement = judge(_doubt_motion(friction_records))
    return [*state(_doubt_laws(models, friction_records)), *judgement.undecided]


def _doubt_motion(records: Sequence[Sequence[FrictionRecord]]) -> Iterator[Hypothesis]:
    """Doubt what one speed, or one direction, shows of friction."""
    for joint_records in records:
        joint = joint_records[0].joint
        resting_speed = find_resting_speed(joint_records)
        yield from omissions.doubt_one_speed(
            joint,
            unit_of_joint("rad/s", is_prismatic=joint_records[0].sliding),
            [record.t for record in joint_records],
            [record.dq for record in joint_records],
            resting_speed,
        )
        moving_records = [
            record for record in joint_records if moving(record.dq, resting_speed).any()
        ]
        yield from omissions.doubt_direction(joint, [record.q for record in moving_records])


def _doubt_laws(
    models: Mapping[str, FrictionModel], records: Sequence[Sequence[FrictionRecord]]
) -> Iterator[Hypothesis]:
    baselines = select_laws("baseline")
    for law_name, model in models.items():
        if law_name in baselines:
            continue
        for j, joint in enumerate(model.joints):
            deviation = float(np.std(np.concatenate([record.tau for record in records[j]])))
            if len(model.training_rmse):
                yield from _doubt_error(law_name, joint, model.training_rmse[j], deviation)
            yield from _doubt_ratio(law_name, joint, model.laws[j].values)
            yield from doubt_one_slope(law_name, model.laws[j], records[j])


def _doubt_error(law_name: str, joint: str, error: float, deviation: float) -> Iterator[Hypothesis]:
    """Doubt a law whose error is that of no law."""
    if error >= _MIN_USELESS_ERROR * deviation:
        yield Hypothesis(
            check="no-better-than-nothing",
            joint=joint,
            observation=f"the error of the law {law_name}, {error:.3g}, is no smaller than "
            f"friction itself, {deviation:.3g}",
            remedy="the torque contains no friction to be fitted; check its column and its unit",
            severity="warning",
        )


def _doubt_ratio(law_name: str, joint: str, values: Mapping[str, float]) -> Iterator[Hypothesis]:
    """Doubt a ratio of static to Coulomb friction at an end of its search range."""
    if not {"F_c", "F_s"} <= set(values) or values["F_c"] == 0:
        return
    ratio = values["F_s"] / values["F_c"]
    for bound in STATIC_RATIO_BOUNDS:
        if abs(np.log(max(ratio, 1e-9) / bound)) < _BOUND_TOLERANCE:
            yield Hypothesis(
                check="bound",
                joint=joint,
                observation=f"F_s / F_c of the law {law_name} hit its limit ({ratio:.3g})",
                remedy="the logs do not determine it; record slow motion and standstill",
                severity="warning",
            )


def check_owner(model: FrictionModel, robot: Robot) -> list[Finding]:
    """Check that a law belongs to the robot."""
    return state(_doubt_owner(model, robot))


def _doubt_owner(model: FrictionModel, robot: Robot) -> Iterator[Hypothesis]:
    description = robot.description
    # A law of other joints is refused elsewhere.
    if model.robot != description.name and model.joints == description.joints:
        yield Hypothesis(
            check="other-robot",
            joint="",
            observation=f"the law {model.law} was fitted to '{model.robot}' and is evaluated on "
            f"'{description.name}'",
            remedy="one of the files is of another robot",
            severity="warning",
        )
