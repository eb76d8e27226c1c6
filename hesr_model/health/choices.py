"""What a log leaves open: choices by trial, and lines of a robot file that a user completes."""

from collections.abc import Sequence
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np

from hesr_model.errors import LogError
from hesr_model.findings import Finding
from hesr_model.health.columns import ColumnProposal
from hesr_model.health.evidence import SmoothPart
from hesr_model.health.trials import ReadLogs, try_descriptions
from hesr_model.logs.csv_text import HeaderError
from hesr_model.logs.guess import ColumnCandidate
from hesr_model.logs.kinematics import match_derivative
from hesr_model.logs.log_format import LogUnits, column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.robots.robot import RobotDescription

_EXAMPLE_RATE = 100.0  # [Hz]


class Undecided(NamedTuple):
    """A value of a robot file that may be right, or an example of it, and why that is open."""

    value: Any
    reason: str


def choose_effort(
    column_proposal: ColumnProposal,
    read_logs: ReadLogs,
    reasons: dict[str, str],
    *,
    has_model: bool,
) -> tuple[dict[str, Any], dict[str, Undecided]]:
    """Choose among columns of a torque or current that which motion and body explain."""
    candidates = column_proposal.efforts
    if len(candidates) < 2:
        return {}, {}
    trials = try_descriptions(
        column_proposal.description,
        [_change_effort(candidate) for candidate in candidates],
        read_logs,
        has_model=has_model,
    )
    if not trials:
        return {}, {}
    best = trials[0]
    undecided: dict[str, Undecided] = {}
    key = f"log.columns.{candidates[0].quantity}"
    for trial in trials[1:]:
        outcome = trial.race(best)
        if outcome == "won":
            best = trial
            reasons[key] = f"likely: motion explains {trial.changes[key][0]} better than others"
        elif outcome == "open":
            reason = f"motion explains {trial.changes[key][0]} a little better, which may be chance"
            undecided[key] = Undecided(value=trial.changes[key], reason=reason)
    return dict(best.changes), undecided


def _change_effort(candidate: ColumnCandidate) -> dict[str, Any]:
    changes: dict[str, Any] = {f"log.columns.{candidate.quantity}": candidate.names}
    default_unit = getattr(LogUnits(), candidate.quantity)
    return changes | {f"log.units.{candidate.quantity}": candidate.unit or default_unit}


def choose_motion(
    description: RobotDescription,
    read_logs: ReadLogs,
    reasons: dict[str, str],
    *,
    has_model: bool,
) -> tuple[dict[str, Any], dict[str, Undecided]]:
    """Choose between a position and a velocity that contradict each other, by the torque."""
    derived = {"log.columns.dq": ""}
    integrated = {"log.columns.q": ""}
    trials = try_descriptions(description, [derived, integrated], read_logs, has_model=has_model)
    # Without its velocity, or its position, the torque follows the other one.
    right_signals = {"log.columns.dq": "position", "log.columns.q": "velocity"}
    for trial, rival in permutations(trials, 2):
        if trial.race(rival) == "won":
            ((key, value),) = trial.changes.items()
            reasons[key] = (
                "likely: position and velocity contradict each other, and the torque follows the "
                f"{right_signals[key]}"
            )
            return {key: value}, {}
    reason = "position and velocity contradict each other, and the torque follows neither more"
    undecided = {
        key: Undecided(value=value, reason=reason)
        for key, value in {**derived, **integrated}.items()
    }
    return {}, undecided


def find_count_size(
    findings: Sequence[Finding], parts: Sequence[SmoothPart], description: RobotDescription
) -> dict[str, Undecided]:
    """Return the size of an encoder's count, that for which positions agree with velocities."""
    has_counts = any(
        finding.check == "coarse" and finding.severity == "error" for finding in findings
    )
    if not has_counts:
        return {}
    declared_sizes = description.log.units.factors("q", len(description.joints))
    sizes = list(map(float, declared_sizes))
    reason = "the size of a count [rad or m]; 2 pi over the counts per turn"
    for part in parts:
        if part.dq is None:
            continue
        for j in np.flatnonzero(part.is_moving):
            match = match_derivative(part.t, part.q[:, [j]], part.dq[:, [j]])
            if match.explains:
                sizes[j] = float(f"{declared_sizes[j] / match.factor:.6g}")
                reason = "the size of a count [rad or m], by the velocity"
    return {"log.units.q": Undecided(value=tuple(sizes), reason=reason)}


def _estimate_rate(table: LogTable | None, description: RobotDescription) -> float:
    """Return the rate [Hz] at which positions change as velocities say, or an example."""
    columns = description.log.columns
    units = description.log.units
    joints = description.joints
    if table is None or not columns.q or not columns.dq:
        return _EXAMPLE_RATE
    q_names = column_names(columns.q, joints)
    dq_names = column_names(columns.dq, joints)
    try:
        q = table.numbers(q_names, missing=True) * units.factors("q", len(joints))
        dq = table.numbers(dq_names, missing=True) * units.factors("dq", len(joints))
    except LogError:
        return _EXAMPLE_RATE
    match = match_derivative(np.arange(table.rows, dtype=float), q, dq)
    if not (match.explains and match.factor > 0.0):
        return _EXAMPLE_RATE
    return float(f"{1.0 / match.factor:.3g}")


def find_missing_lines(
    refusal: LogError, table: LogTable | None, description: RobotDescription
) -> dict[str, Undecided]:
    """Return the values by key that a log needs to be read, as examples to complete."""
    joint_count = len(description.joints)
    examples: dict[str, dict[str, Any]] = {
        "log.no_positions": {"log.columns.q": ("COLUMN",) * joint_count},
        "log.no_torque": {
            "log.columns.tau": ("COLUMN",) * joint_count,
            "log.columns.current": ("COLUMN",) * joint_count,
            "log.torque_per_ampere": (1.0,) * joint_count,
        },
        "log.torque_per_ampere": {"log.torque_per_ampere": (1.0,) * joint_count},
    }
    if refusal.code == "log.no_time":
        examples[refusal.code] = {"log.rate": _estimate_rate(table, description)}
    if isinstance(refusal, HeaderError):
        examples[refusal.code] = {"log.columns": refusal.suggestion}
    reason = str(refusal).split(": ", 1)[-1].rstrip(".")
    return {
        key: Undecided(value=value, reason=reason)
        for key, value in examples.get(refusal.code, {}).items()
    }
