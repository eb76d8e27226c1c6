"""All checks of logs against their robot."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

from hesr_model.errors import FitError
from hesr_model.findings import Finding
from hesr_model.health import positions
from hesr_model.health.causes import check_causes
from hesr_model.health.evidence import Motionwise, Torques, as_logged, motionwise
from hesr_model.health.findings import merged, of_log, require_known, require_sound
from hesr_model.health.loss import check_loss
from hesr_model.health.sample_hold import check_held, check_speed
from hesr_model.health.timing import check_clocks
from hesr_model.health.torque import NO_SIGNAL, Explained, check_torque, explained
from hesr_model.health.velocity import check_velocity
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import identify_motions
from hesr_model.robots.robot import Robot, RobotDescription

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

    findings: tuple[Finding, ...]
    parts: tuple[Motionwise, ...]
    torques: tuple[Torques, ...]
    explained: tuple[Explained, ...]


def examine(logs: Sequence[Log], robot: RobotDescription, model: Robot | None) -> Examination:
    """Check logs one by one, against the model, and together; raises LogError."""
    findings: list[Finding] = []
    parts: list[Motionwise] = []
    for log in logs:
        timed = of_log(log, positions.check_time(log, robot))
        findings += timed
        if any(f.severity == "error" for f in timed):
            continue
        for check in (positions.check_jumps, positions.check_steps, check_held):
            findings += of_log(log, check(log, robot))
        parts += motionwise(log, robot.log.filter_cutoff)
    if model and (robot.known is not None or model.springs):
        model = _informed(model, parts)
    torques = [Torques.of(model, part.q, part.v, part.a) for part in parts] if model else []
    logged = [as_logged(*both, robot.logged) for both in zip(parts, torques, strict=False)]
    fits = [explained(part, torque) for part, torque in logged]
    broken = {name for f in findings if f.check in ("wrap", "spikes") for name in f.joints}
    coarse = {name for f in findings if f.check == "coarse" for name in f.joints}
    for part in parts:
        findings += of_log(part.log, check_velocity(part, robot, broken))
        if model:
            findings += of_log(part.log, positions.check_limits(part, model))
            findings += of_log(part.log, positions.check_sliding(part, model))
            findings += of_log(part.log, check_speed(part, model))
        findings += of_log(part.log, positions.check_columns(part, robot))
    if model and not hopeless(findings):
        for part, (own, torque), fit in zip(parts, logged, fits, strict=True):
            clocks, late = check_clocks(part, [j for j in fit if fit[j].r2 > NO_SIGNAL], model)
            blurred = {*late, *(j for j in fit if robot.joints[j] in coarse)}
            found = (*clocks, *check_torque(own, fit, model, blurred))
            findings += of_log(part.log, (*found, *check_loss(own, torque, model)))
        findings = _caused(findings, check_causes(parts, model))
    return Examination(
        findings=tuple(merged(_without_followers(findings))),
        parts=tuple(parts),
        torques=tuple(torques),
        explained=tuple(fits),
    )


def _informed(model: Robot, parts: Sequence[Motionwise]) -> Robot | None:
    """Return a robot whose unknown parameters are identified, or None if that fails.

    Only its springs are unknown if it has some and lists no known parameters.
    """
    informed = copy(model)
    if model.description.known is None:
        own = {"known": model.parameter_names[: model.inertial]}
        model = Robot(model.description.model_copy(update=own))
    motions = [
        Motion(name=p.log.name, t=p.t, q=p.q, q_raw=p.q, dq=p.v, ddq=p.a, tau=p.tau) for p in parts
    ]
    try:
        informed.nominal_parameters = identify_motions(motions, model).parameters
    except FitError:
        return None
    return informed


def hopeless(findings: Sequence[Finding]) -> bool:
    """Return whether errors of units or positions hide what the model would show."""
    return any(
        f.severity == "error"
        and (
            f.check in ("limits", "wrap", "spikes")
            or {"log.units.t", "log.units.q"} & set(f.changes)
        )
        for f in findings
    )


SYMPTOMS = (
    *("torque-sign", "torque-scale", "torque-signal", "torque-lag", "torque-small", "time-scale"),
    "gravity-sign",
)
"""Checks whose findings a deeper cause can explain."""


def _caused(findings: Sequence[Finding], causes: Sequence[Finding]) -> list[Finding]:
    local = {name for cause in causes if cause.check == "torque-sign" for name in cause.joints}
    everywhere = any(cause.check != "torque-sign" or not cause.joints for cause in causes)
    kept = [
        f for f in findings if f.check not in SYMPTOMS or not (everywhere or local & set(f.joints))
    ]
    signs = {f.joints: f.found for f in findings if f.check == "torque-sign"}
    told = [
        replace(c, found=signs[c.joints])
        if c.check in ("torque-sign", "position-sign") and c.joints in signs
        else c
        for c in causes
    ]
    return [*kept, *told]


def _without_followers(findings: Sequence[Finding]) -> list[Finding]:
    clear = {f.joints for f in findings if f.check in ("velocity-columns", "same-column")}
    coarse = any(f.check == "coarse" for f in findings)
    hidden = hopeless(findings)
    mended = any(key.startswith("log.units") for f in findings for key in f.changes)
    return [
        f
        for f in findings
        if (f.check != "velocity-match" or f.joints not in clear)
        and not (f.check in ("time-scale", "speed-limit") and (mended or coarse or hidden))
    ]


def checked(logs: Sequence[Log], model: Robot, accepted: Sequence[str] = ()) -> list[Finding]:
    """Check logs; return warnings and accepted errors, or raise HealthError."""
    require_known(accepted, CHECKS)
    return require_sound(examine(logs, model.description, model).findings, accepted)
