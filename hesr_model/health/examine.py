"""All checks of logs against their robot, and of fits; findings merged over logs and joints."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from hesr_model.errors import ConfigError, FitError, LogError
from hesr_model.findings import Finding, errors_first, of_joint
from hesr_model.friction.model import FrictionModel
from hesr_model.health import positions
from hesr_model.health import torque as efforts
from hesr_model.health.evidence import JointTorque, Motionwise, Torques, motionwise, to_logged_side
from hesr_model.health.mistakes import check_causes
from hesr_model.health.timing import check_clocks
from hesr_model.health.torque import NO_SIGNAL, Explained, check_torque, explained
from hesr_model.health.velocity import check_velocity
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, moving, reversals
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.arrays import Array

CHECKS = (
    *("time-unit", "gaps", "missing-rows", "dropped-rows", "wrap", "spikes", "coarse", "limits"),
    "sliding-unit",
    *("stuck", "held-samples", "torque-spikes", "speed-limit", "time-scale", "no-friction"),
    *("same-column", "velocity-constant", "velocity-columns", "velocity-match", "velocity-sign"),
    *("velocity-scale", "velocity-lag", "torque-constant", "saturation", "torque-sign"),
    *("torque-scale", "torque-signal", "torque-lag", "torque-limit", "torque-small"),
    *("torque-columns", "position-sign", "joint-order", "zero", "gravity", "gravity-sign"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Examination:
    """Findings, with model torques and regressions of each part."""

    findings: tuple[Finding, ...] = ()
    parts: tuple[Motionwise, ...] = ()
    torques: tuple[Torques, ...] = ()
    explained: tuple[Explained, ...] = ()


def examine(logs: Sequence[Log], description: RobotDescription, model: Robot | None) -> Examination:
    """Check logs one by one, against the model, and together; raises LogError."""
    findings: list[Finding] = []
    parts: list[Motionwise] = []
    for log in logs:
        timed = of_log(log, positions.check_time(log, description))
        findings += timed
        if any(finding.severity == "error" for finding in timed):
            continue
        for check in (positions.check_jumps, positions.check_steps, efforts.check_raw_signals):
            findings += of_log(log, check(log, description))
        parts += motionwise(log, description.log.filter_cutoff)
    if model and (description.known is not None or model.springs):
        model = _inform_robot(model, parts)
    torques = [Torques.of(model, part.q, part.v, part.a) for part in parts] if model else []
    logged = [
        to_logged_side(*both, description.logged) for both in zip(parts, torques, strict=False)
    ]
    fits = [explained(part, torque) for part, torque in logged]
    broken = {
        name
        for finding in findings
        if finding.check in ("wrap", "spikes")
        for name in finding.joints
    }
    coarse = {name for finding in findings if finding.check == "coarse" for name in finding.joints}
    for part in parts:
        findings += of_log(part.log, check_velocity(part, description, broken))
        if model:
            findings += of_log(part.log, positions.check_limits(part, model))
            findings += of_log(part.log, positions.check_sliding(part, model))
            findings += of_log(part.log, efforts.check_speed(part, model))
        findings += of_log(part.log, positions.check_columns(part, description))
    if model and not hopeless(findings):
        for part, (own, torque), fit in zip(parts, logged, fits, strict=True):
            clocks, late = check_clocks(part, [j for j in fit if fit[j].r2 > NO_SIGNAL], model)
            blurred = {*late, *(j for j in fit if description.joints[j] in coarse)}
            found = (*clocks, *check_torque(own, fit, model, blurred))
            findings += of_log(part.log, (*found, *positions.check_loss(own, torque, model)))
        findings = _caused(findings, check_causes(parts, model))
    return Examination(
        findings=tuple(merged(_without_followers(findings))),
        parts=tuple(parts),
        torques=tuple(torques),
        explained=tuple(fits),
    )


def _inform_robot(robot: Robot, parts: Sequence[Motionwise]) -> Robot | None:
    """Return a robot whose unknown parameters are identified, or None if that fails."""
    informed = copy(robot)
    if robot.description.known is None:  # then only its springs, if any, are unknown
        own = {"known": robot.parameter_names[: robot.inertial]}
        robot = Robot(robot.description.model_copy(update=own))
    motions = [
        Motion(name=p.log.name, t=p.t, q=p.q, q_raw=p.q, dq=p.v, ddq=p.a, tau=p.tau) for p in parts
    ]
    try:
        informed.nominal_parameters = identify_motions(motions, robot).parameters
    except FitError:
        return None
    return informed


def hopeless(findings: Sequence[Finding]) -> bool:
    """Return whether errors of units or positions hide what the model would show."""
    errors = [finding for finding in findings if finding.severity == "error"]
    units = {"log.units.t", "log.units.q"}
    return any(
        finding.check in ("limits", "wrap", "spikes") or units & set(finding.changes)
        for finding in errors
    )


SYMPTOMS = (
    *("torque-sign", "torque-scale", "torque-signal", "torque-lag", "torque-small", "time-scale"),
    "gravity-sign",
)  # Checks whose findings a deeper cause can explain


def _caused(findings: Sequence[Finding], causes: Sequence[Finding]) -> list[Finding]:
    local = {name for cause in causes if cause.check == "torque-sign" for name in cause.joints}
    every = any(cause.check != "torque-sign" or not cause.joints for cause in causes)
    kept = [
        finding
        for finding in findings
        if finding.check not in SYMPTOMS or not (every or local & set(finding.joints))
    ]
    signs = {
        finding.joints: finding.found for finding in findings if finding.check == "torque-sign"
    }
    told = [
        replace(c, found=signs[c.joints])
        if c.check in ("torque-sign", "position-sign") and c.joints in signs
        else c
        for c in causes
    ]
    return [*kept, *told]


def _without_followers(findings: Sequence[Finding]) -> list[Finding]:
    clear = {
        finding.joints
        for finding in findings
        if finding.check in ("velocity-columns", "same-column")
    }
    coarse = any(finding.check == "coarse" for finding in findings)
    hidden = hopeless(findings)
    mended = any(key.startswith("log.units") for finding in findings for key in finding.changes)
    return [
        finding
        for finding in findings
        if (finding.check != "velocity-match" or finding.joints not in clear)
        and not (finding.check in ("time-scale", "speed-limit") and (mended or coarse or hidden))
    ]


def checked(logs: Sequence[Log], robot: Robot, accepted: Sequence[str] = ()) -> list[Finding]:
    """Check logs; return warnings and accepted errors, or raise HealthError."""
    require_known(accepted, CHECKS)
    return require_sound(examine(logs, robot.description, robot).findings, accepted)


class HealthError(LogError):
    """Impossible data, a line per finding."""

    def __init__(self, said: str, findings: Sequence[Finding]) -> None:
        super().__init__(said)
        self.findings = tuple(findings)


def _said(findings: Sequence[Finding]) -> str:
    lines = [f"{finding.sentence} [{finding.check}]" for finding in findings]
    names = " ".join(
        f"--accept {name}" for name in dict.fromkeys(finding.check for finding in findings)
    )
    tried = "hesr inspect tries the changes on these logs. " * any(
        finding.changes for finding in findings
    )
    told = f"{tried}To continue anyway: {names}."
    if len(lines) == 1:
        return f"{lines[0]} {told}"
    return "\n  ".join([f"{len(lines)} errors in the data.", *lines, told])


def of_log(log: Log, findings: Iterable[Finding]) -> list[Finding]:
    """Return findings with the name of their log."""
    return [replace(finding, logs=(log.name,)) for finding in findings]


def merged(findings: Iterable[Finding]) -> list[Finding]:
    """Merge findings of several logs or joints; errors first."""
    by_log = _merged(findings, lambda f: (f.check, f.joints))
    return errors_first(_merged(by_log, lambda f: (f.check, f.severity, f.remedy, repr(f.changes))))


def _merged(findings: Iterable[Finding], key: Callable[[Finding], object]) -> list[Finding]:
    groups: dict[object, list[Finding]] = {}
    for finding in findings:
        groups.setdefault(key(finding), []).append(finding)
    return [
        replace(
            errors_first(group)[0],
            joints=tuple(dict.fromkeys(joint for f in group for joint in f.joints)),
            logs=tuple(dict.fromkeys(log for f in group for log in f.logs)),
        )
        for group in groups.values()
    ]


def require_sound(findings: Sequence[Finding], accepted: Sequence[str] = ()) -> list[Finding]:
    """Return all findings, or raise HealthError with errors not accepted."""
    refused = [
        finding
        for finding in findings
        if finding.severity == "error" and finding.check not in accepted
    ]
    if refused:
        raise HealthError(_said(refused), refused)
    return list(findings)


def require_known(accepted: Sequence[str], known: Sequence[str]) -> None:
    """Raise ConfigError if `accepted` contains an unknown check."""
    for name in accepted:
        if name not in known:
            raise ConfigError(f"--accept is '{name}'; the checks are {', '.join(known)}.")


_RESTS = 0.02  # share of rests that shows stiction
_REVERSALS = 4
_SLOW = 0.1
_SLOWLY = 0.05  # share of the peak speed, share of slow rows needed
_LOAD = 0.5  # gravity over friction that shows load-dependent friction


def bears_load(fits: Explained) -> bool:
    """Return whether the load of a joint changes enough to show load-dependent friction."""
    return any(fit.bears_gravity and _changes_load(fit) for fit in fits.values())


def _changes_load(fit: JointTorque) -> bool:
    return fit.gravity_size >= _LOAD * fit.friction_size


def unseen(examination: Examination, joints: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield joints with effects that the logs do not show."""
    for j, joint in enumerate(joints):
        parts = [k for k, part in enumerate(examination.parts) if part.moves[j]]
        if not parts:
            yield joint, "it does not move in any log"
            continue
        own = [examination.parts[k].v[:, j] for k in parts]
        v = np.concatenate(own)
        if sum(len(reversals(one)) for one in own) < _REVERSALS:
            yield joint, f"fewer than {_REVERSALS} reversals: neither hysteresis nor an offset"
        if np.mean(~moving(v)) < _RESTS:
            yield joint, "hardly any rest: no stiction"
        if np.mean(np.abs(v) < _SLOW * np.max(np.abs(v))) < _SLOWLY:
            yield joint, "hardly any slow motion: no Stribeck effect"
        fits = [fits[j] for k, fits in enumerate(examination.explained) if k in parts and j in fits]
        if fits and not any(fit.bears_gravity for fit in fits):
            yield joint, "no gravity torque: its torque constant cannot be checked"
        elif fits and not any(map(_changes_load, fits)):
            yield joint, "hardly any change of load: no load-dependent friction"


_STATES = 60
_NOTHING = 0.95  # error over deviation of a law that explains nothing
_AT_BOUND = 0.01
_NEGATIVE = 0.5  # negative Coulomb friction over the residual


def check_body(body: RigidBody, robot: Robot) -> Iterator[Finding]:
    """Check that a mass matrix is positive definite and friction brakes."""
    joints = robot.description.joints
    lowest, q, joint = _least_inertia(body, robot)
    if lowest <= 0.0:
        at = f"{lowest:.2g}, for instance at q = {', '.join(f'{value:.2f}' for value in q)}"
        found = f"the identified mass matrix is not positive definite (eigenvalue {at})"
        remedy = "the identified masses are not physically possible; use longer or faster logs, or "
        yield of_joint("mass-matrix", joints[joint], found, f"{remedy}--physical", "warning")
    for name, (coulomb, _, _), rmse in zip(joints, body.friction, body.rmse, strict=True):
        if -coulomb > _NEGATIVE * rmse:
            found = f"its Coulomb friction is identified as {coulomb:.3g} N.m"
            remedy = "torque or velocity count backwards, or lag each other"
            yield of_joint("negative-friction", name, found, remedy, "warning")


def _least_inertia(body: RigidBody, robot: Robot) -> tuple[float, Array, int]:
    lower, upper, _ = robot.reach
    q = np.random.default_rng(0).uniform(lower, upper, (_STATES, robot.n))
    mass, _ = robot.dynamics(body.parameters, q, np.zeros_like(q))
    mass = 0.5 * (mass + mass.transpose(0, 2, 1))
    scale = np.sqrt(np.maximum(np.abs(np.mean(np.diagonal(mass, axis1=1, axis2=2), axis=0)), 1e-12))
    values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
    state = int(np.argmin(values[:, 0]))
    return float(values[state, 0]), q[state], int(np.argmax(np.abs(vectors[state, :, 0])))


def check_laws(
    models: Mapping[str, FrictionModel], records: Sequence[Sequence[FrictionRecord]]
) -> Iterator[Finding]:
    """Check laws fitted to records [joint][log]."""
    records = all_at_friction(records)
    for name, model in models.items():
        for j, joint in enumerate(model.joints):
            deviation = float(np.std(np.concatenate([record.tau for record in records[j]])))
            if len(model.training_rmse) and model.training_rmse[j] >= _NOTHING * deviation:
                found = (
                    f"the error of the law {name}, {model.training_rmse[j]:.3g}, is no "
                    f"smaller than friction itself, {deviation:.3g}"
                )
                remedy = "the torque contains no friction to be fitted; see 'hesr inspect'"
                yield of_joint("no-better-than-nothing", joint, found, remedy, "warning")
            values = model.laws[j].values
            if {"F_c", "F_s"} <= set(values) and values["F_c"] != 0:
                ratio = values["F_s"] / values["F_c"]
                for bound in STATIC_RATIO_BOUNDS:
                    if abs(np.log(max(ratio, 1e-9) / bound)) < _AT_BOUND:
                        found = f"F_s / F_c of the law {name} hit its limit ({ratio:.3g})"
                        remedy = "the logs do not determine it; record slow motion and standstill"
                        yield of_joint("bound", joint, found, remedy, "warning")


def check_owner(model: FrictionModel, robot: Robot) -> Iterator[Finding]:
    """Check that a law belongs to the robot."""
    description = robot.description
    if (
        model.robot != description.name and model.joints == description.joints
    ):  # else refused elsewhere
        found = (
            f"the law {model.law} was fitted to '{model.robot}' and is evaluated on "
            f"'{description.name}'"
        )
        yield of_joint("other-robot", "", found, "one of the files is of another robot", "warning")
