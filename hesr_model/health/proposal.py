"""Proposal of a robot file: guessed from column names, corrected until the checks pass."""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.findings import Finding, sort_by_severity
from hesr_model.health import joints as selection
from hesr_model.health.choices import (
    Undecided,
    choose_effort,
    choose_motion,
    find_count_size,
    find_missing_lines,
)
from hesr_model.health.columns import ColumnProposal, propose_columns
from hesr_model.health.examine import SYMPTOMS, Examination, examine, is_hopeless
from hesr_model.health.joints import (
    apply_changes,
    choose_joints,
    find_resting_joints,
    is_model_path,
    remove_joints,
    select_joints,
)
from hesr_model.health.positions import is_plausible_period
from hesr_model.health.velocity import match_velocity
from hesr_model.logs.csv_text import HeaderError
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.log_format import OPTIONAL, LogFormat
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.readers.formats import find_format
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import moving, reversals
from hesr_model.rigid_body.torque_constants import TorqueConstant
from hesr_model.robots.robot import Robot, RobotDescription, RobotLike, to_description
from hesr_model.support.text import to_toml

_ROUNDS = 4
_CUTOFF_SHARE = 0.3  # low pass over the sample rate
_PRINTED_LINE = re.compile(r"\[log\] (\w+ = (?:'[^']*'|[\w.+]+))")
_REMEDIES = (
    ("sample_rate", "log.sample_rate", None),
    ("finite number is needed", "log.missing", "drop"),
    ("is nan;", "log.missing", "drop"),
)  # Words of a refusal, and the key and value of the robot file that remove it
# Warnings that other findings can hide.
_HIDEABLE_CHECKS = {*SYMPTOMS, "speed-limit", "velocity-lag"}
_CHOSEN_BY_TRIAL = ("velocity-lag", "velocity-match")
_NO_REMEDY = "no change that was tried removes it; check the column, its unit and the model"


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """A robot description with reasons by key, logs read with it, and findings before changes.

    `undecided` are values by key that an edit of the robot file can choose.
    """

    description: RobotDescription
    reasons: Mapping[str, str]
    logs: Sequence[Log]
    examination: Examination
    first_findings: Sequence[Finding]
    prismatic_joints: frozenset[int] = frozenset()
    undecided: Mapping[str, Undecided] = field(default_factory=dict)


class ProposalError(LogError):
    """A log that cannot be read yet; `proposal` holds what is known and what must be stated."""

    proposal: Proposal

    @classmethod
    def from_refusal(cls, refusal: LogError, proposal: Proposal) -> "ProposalError":
        """Return the refusal of a log with a proposal."""
        error = cls(str(refusal), code=refusal.code, where=refusal.where, key=refusal.key)
        error.proposal = proposal
        return error


def inspect_logs(
    paths: Sequence[Path], robot: RobotLike | None = None, joints: Sequence[str] = ()
) -> Proposal:
    """Inspect logs of a known robot and its chosen joints, or by their columns alone."""
    if robot is not None and not paths:
        description, reason = choose_joints(robot, joints)
        proposal = Proposal(
            description=description,
            reasons={},
            logs=(),
            examination=Examination(),
            first_findings=(),
        )
        return _add_doubts(proposal, {"joints": f"likely: {reason}"} if reason else {})
    stated_description = None if robot is None or is_model_path(robot) else to_description(robot)
    try:
        table = open_table(paths[0], stated_description.log if stated_description else LogFormat())
    except HeaderError as error:
        if robot is None:
            raise
        description = to_description(robot)
        missing_lines = find_missing_lines(error, None, description)
        proposal = _build_refused_proposal(description, {}, missing_lines)
        raise ProposalError.from_refusal(error, proposal) from error
    if robot is not None:
        description = select_joints(robot, joints, table)
        reason = ""
        if table and not joints and is_model_path(robot):
            description, reason = selection.select_joints_of_table(description, table)
        reasons = {"joints": f"likely: {reason}"} if reason else {}
        return _add_doubts(propose(paths, description, has_model=True), reasons)
    joint_count = guess_columns(table).joint_count if table else 1
    names = tuple(f"joint{number}" for number in range(1, joint_count + 1))
    unknown_description = RobotDescription(name="robot", model=Path("unknown"), joints=names)
    return propose(paths, unknown_description, has_model=False)


def _add_doubts(proposal: Proposal, reasons: Mapping[str, str]) -> Proposal:
    """Return a proposal with reasons, whose findings begin with doubts about the model file."""
    findings = Robot(proposal.description).doubts
    examination = proposal.examination
    examination = replace(
        examination, findings=tuple(sort_by_severity([*findings, *examination.findings]))
    )
    first_findings = sort_by_severity([*findings, *proposal.first_findings])
    all_reasons = {**reasons, **proposal.reasons}
    return replace(
        proposal, first_findings=first_findings, reasons=all_reasons, examination=examination
    )


def propose(paths: Sequence[Path], description: RobotDescription, *, has_model: bool) -> Proposal:
    """Find a description, with a model file if `has_model`, that passes the checks."""
    reasons: dict[str, str] = {}
    has_stated_constants = description.log.torque_per_ampere is not None
    stated_cutoff = description.log.filter_cutoff

    def read_and_examine(
        description: RobotDescription,
    ) -> tuple[RobotDescription, list[Log], Examination]:
        description, logs = _read_logs(paths, description, reasons)
        description = _limit_cutoff(description, logs, reasons, stated_cutoff)
        return (
            description,
            logs,
            examine(logs, description, Robot(description) if has_model else None),
        )

    column_proposal = _propose_columns(paths[0], description, reasons)
    description = column_proposal.description
    try:
        if column_proposal.refusal is not None:
            raise column_proposal.refusal
        read_logs = partial(_read_changed_logs, paths, reasons)
        changes, undecided = choose_effort(column_proposal, read_logs, reasons, has_model=has_model)
        description, logs, examination = read_and_examine(apply_changes(description, changes))
    except LogError as error:
        table = open_table(paths[0], description.log)
        missing_lines = find_missing_lines(error, table, description)
        proposal = _build_refused_proposal(description, reasons, missing_lines)
        raise ProposalError.from_refusal(error, proposal) from error
    first_findings = examination.findings
    if any(finding.check == "velocity-match" for finding in first_findings):
        changes, open_choices = choose_motion(description, read_logs, reasons, has_model=has_model)
        undecided |= open_choices
        if changes:
            description, logs, examination = read_and_examine(apply_changes(description, changes))
    for _ in range(_ROUNDS):
        findings = examination.findings
        # A velocity that lags may be wanted; one that contradicts its position is a witness.
        candidate_findings = [
            finding for finding in findings if finding.check not in _CHOSEN_BY_TRIAL
        ]
        for target_findings in (candidate_findings, *([finding] for finding in candidate_findings)):
            changes, change_reasons = _merge_changes(description, target_findings)
            attempt = read_and_examine(apply_changes(description, changes)) if changes else None
            if attempt and _is_improvement(findings, target_findings, attempt[2].findings):
                break
        else:
            change_reasons = {}
            attempt = None
            if not has_stated_constants and "log.torque_per_ampere" in reasons and has_model:
                changes = _estimate_constants(description, examination, reasons)
                attempt = read_and_examine(apply_changes(description, changes)) if changes else None
        if attempt is None:
            break
        description, logs, examination = attempt
        guesses = {
            key: reasons[key]
            for key in change_reasons
            if reasons.get(key, "").startswith("guess: ")
        }
        reasons |= change_reasons | {
            key: f"{reason}; {change_reasons[key]}" for key, reason in guesses.items()
        }
    if has_model and (resting_joints := find_resting_joints(description, examination.parts)):
        reasons["locked"] = (
            f"likely: {', '.join(resting_joints)} rest{'s' * (len(resting_joints) == 1)} in all "
            "logs"
        )
        optional = [
            name for name in OPTIONAL if any(getattr(log, name) is not None for log in logs)
        ]
        description, logs, examination = read_and_examine(
            remove_joints(description, resting_joints, optional)
        )
    if description.log.filter_cutoff == stated_cutoff:
        reasons.pop("log.filter_cutoff", None)  # of a change that was only tried
    slides = Robot(description).slides if has_model else ()
    findings = examination.findings
    remaining_findings = tuple(
        finding
        if not finding.changes
        or finding.check == "velocity-match"
        or (
            finding.check == "velocity-lag"
            and _is_improvement(
                findings,
                [finding],
                read_and_examine(
                    apply_changes(description, _merge_changes(description, [finding])[0])
                )[2].findings,
            )
        )
        else replace(finding, remedy=_NO_REMEDY, changes={})
        for finding in findings
    )
    examination = replace(examination, findings=remaining_findings)
    return Proposal(
        description=description,
        reasons=reasons,
        logs=logs,
        examination=examination,
        first_findings=first_findings,
        prismatic_joints=frozenset(np.flatnonzero(slides).tolist()),
        undecided={**undecided, **find_count_size(findings, examination.parts, description)},
    )


def open_table(path: Path, log_format: LogFormat) -> LogTable | None:
    """Open a log as a table, if its columns have names."""
    read_named_table = find_format(path).table
    return read_named_table(path, log_format) if read_named_table and path.is_file() else None


def _propose_columns(
    path: Path, description: RobotDescription, reasons: dict[str, str]
) -> ColumnProposal:
    table = open_table(path, description.log)
    if table is None:
        return ColumnProposal(description=description)
    proposal = propose_columns(table, description)
    reasons |= proposal.reasons
    return proposal


def _read_changed_logs(
    paths: Sequence[Path], reasons: Mapping[str, str], description: RobotDescription
) -> list[Log]:
    """Read logs with a description that may not become the proposal."""
    return _read_logs(paths, description, dict(reasons))[1]


def _build_refused_proposal(
    description: RobotDescription,
    reasons: Mapping[str, str],
    undecided: Mapping[str, Undecided],
) -> Proposal:
    """Return what is known of a log that cannot be read, and the lines that are missing."""
    return Proposal(
        description=description,
        reasons=reasons,
        logs=(),
        examination=Examination(),
        first_findings=(),
        undecided=undecided,
    )


def _read_logs(
    paths: Sequence[Path], description: RobotDescription, reasons: dict[str, str]
) -> tuple[RobotDescription, list[Log]]:
    try:
        return description, [Log.read(path, description) for path in paths]
    except LogError as error:
        message = str(error)
        for key, value in _read_remedies(message):
            if key not in reasons:
                reasons[key] = f"sure: {message.split(': ', 1)[-1].rstrip('.')}"
                return _read_logs(paths, apply_changes(description, {key: value}), reasons)
        raise


def _read_remedies(message: str) -> Iterator[tuple[str, Any]]:
    """Yield keys and values of the robot file that remove a refusal, first those it prints."""
    for line in _PRINTED_LINE.findall(message):
        ((key, value),) = tomllib.loads(line).items()
        yield f"log.{key}", value
    for words, key, value in _REMEDIES:
        if words in message:
            yield key, value


def _limit_cutoff(
    description: RobotDescription,
    logs: Sequence[Log],
    reasons: dict[str, str],
    stated_cutoff: float,
) -> RobotDescription:
    """Return a description whose low pass suits the rate of the logs, as far as their unit does.

    A later correction of the unit of time changes the rate, so that the stated cut-off [Hz] counts.
    """
    slowest_period = max(log.period for log in logs)
    slowest_rate = 1.0 / slowest_period
    if stated_cutoff <= 0.4 * slowest_rate or not is_plausible_period(slowest_period):
        return apply_changes(description, {"log.filter_cutoff": stated_cutoff})
    reasons["log.filter_cutoff"] = f"sure: the sample rate is only {slowest_rate:.4g} Hz"
    return apply_changes(
        description, {"log.filter_cutoff": float(f"{_CUTOFF_SHARE * slowest_rate:.2g}")}
    )


def _merge_changes(
    description: RobotDescription, findings: Sequence[Finding]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return changes of the robot file with a reason each; two witnesses make one sure."""
    new_values: dict[str, Any] = {}
    reasons: dict[str, dict[str, str]] = {}  # by key and check
    for finding in findings:
        for key, value in finding.changes.items():
            new_values[key] = _merge_values(
                attrgetter(key)(description), new_values.get(key), value
            )
            reasons.setdefault(key, {}).setdefault(finding.check, finding.found)
    changes = {
        key: value for key, value in new_values.items() if value != attrgetter(key)(description)
    }
    marks = {key: "sure" if len(reasons[key]) > 1 else "likely" for key in changes}
    change_reasons = {
        key: f"{mark}: {'; '.join(reasons[key].values())}" for key, mark in marks.items()
    }
    return changes, change_reasons


def _is_improvement(
    findings_before: Sequence[Finding],
    target_findings: Sequence[Finding],
    findings_after: Sequence[Finding],
) -> bool:
    """Return whether findings with changes are gone, and none is new unless it was hidden."""
    places_after = _collect_places(findings_after)
    places_before = _collect_places(findings_before)
    target_places = _collect_places(finding for finding in target_findings if finding.changes)
    new_places = (
        _collect_places(
            finding
            for finding in findings_after
            if finding.severity == "error" or finding.check not in _HIDEABLE_CHECKS
        )
        - places_before
    )
    was_hidden = is_hopeless(findings_before) and ("time-unit", "") not in new_places
    return not places_after & target_places and (was_hidden or not new_places)


def _collect_places(findings: Iterable[Finding]) -> set[tuple[str, str]]:
    return {(finding.check, joint) for finding in findings for joint in finding.joints or ("",)}


def _merge_values(declared: Any, earlier: Any, value: Any) -> Any:
    if not (isinstance(earlier, tuple) and isinstance(value, tuple)):
        return value
    declared_values = declared if isinstance(declared, tuple) else (declared,) * len(value)
    return tuple(
        b if v == o else v for o, b, v in zip(declared_values, earlier, value, strict=True)
    )


def _estimate_constants(
    description: RobotDescription, examination: Examination, reasons: dict[str, str]
) -> dict[str, Any]:
    slopes: dict[int, list[float]] = {}
    for fits in examination.fits:
        for j, fit in fits.items():
            if fit.bears_gravity and abs(fit.gravity.t) > 10.0:
                slopes.setdefault(j, []).append(abs(fit.gravity.value))
    gains = description.log.torque_per_ampere or ()
    scales = {j: 1.0 / float(np.median(joint_slopes)) for j, joint_slopes in slopes.items()}
    if not scales or all(abs(np.log(scale)) < 0.2 for scale in scales.values()):
        return {}
    median_scale = float(np.median(list(scales.values())))
    reasons["log.torque_per_ampere"] = (
        "guess: only currents are logged; from the model's gravity at joints "
        f"{', '.join(description.joints[j] for j in sorted(scales))}, the median for the others; "
        "replace them by the manufacturer's values if known"
    )
    constants = tuple(
        float(f"{gain * scales.get(j, median_scale):.4g}") for j, gain in enumerate(gains)
    )
    return {"log.torque_per_ampere": constants}


def apply_constants(proposal: Proposal, constants: Sequence[TorqueConstant]) -> Proposal:
    """Return the proposal with the torque constants that were determined."""
    description = proposal.description
    constants = [constant for constant in constants if constant.joint in description.joints]
    gains = description.log.torque_per_ampere
    if gains is None or not any(constant.determined for constant in constants):
        return proposal
    key = "torque_per_ampere"
    sources = description.sources.expand_per_joint("torque_per_ampere", len(gains))
    triples = list(zip(constants, gains, sources, strict=True))
    new_gains = [float(f"{c.value:.4g}") if c.determined else gain for c, gain, _ in triples]
    new_sources = ["identified" if c.determined else source for c, _, source in triples]
    description = apply_changes(
        description, {f"log.{key}": tuple(new_gains), f"sources.{key}": tuple(new_sources)}
    )
    reason = "identified: from known masses"
    return replace(
        proposal, description=description, reasons={**proposal.reasons, f"log.{key}": reason}
    )


def robot_file(proposal: Proposal, path: Path) -> str:
    """Return the text of a robot file, with reasons."""
    head = "Proposed by 'hesr inspect'. Comments give certainty and reason."
    return robot_text(proposal.description, path, head, proposal.reasons, proposal.undecided)


def robot_text(
    description: RobotDescription,
    path: Path,
    head: str,
    reasons: Mapping[str, str] | None = None,
    undecided: Mapping[str, Undecided] | None = None,
) -> str:
    """Return the text of a robot file at `path`, with a comment as its head and reasons by key.

    Values that are `undecided` are comments: removing the mark makes one of them the file's.
    """
    reasons = reasons or {}
    document = description.model_dump()
    non_defaults = description.model_dump(exclude_defaults=True)
    document["model"] = Path(relpath(description.model, path.resolve().parent)).as_posix()
    log_entries = non_defaults.pop("log", {})
    if description.log.cylinder is not None:  # with its usual unit
        log_entries["cylinder"] = document["log"]["cylinder"]
    lines = [
        f"# {head}",
        "",
        *(_format_line(key, document[key], reasons.get(key, "")) for key in non_defaults),
    ]
    tables = {"log": {k: v for k, v in log_entries.items() if not isinstance(v, dict)}}
    tables |= {f"log.{k}": v for k, v in log_entries.items() if isinstance(v, dict)}
    choices: dict[str, dict[str, Undecided]] = {}  # by table
    for key, choice in (undecided or {}).items():
        table_name, _, name = key.rpartition(".")
        choices.setdefault(table_name, {})[name] = choice
    for table_name in dict.fromkeys((*tables, *choices)):
        entry_lines = [
            _format_line(k, v, reasons.get(f"{table_name}.{k}", ""))
            for k, v in tables.get(table_name, {}).items()
        ]
        entry_lines += [
            f"# {name}: undecided: {choice.reason}\n# {name} = {to_toml(choice.value)}"
            for name, choice in choices.get(table_name, {}).items()
        ]
        lines += ["", f"[{table_name}]", *entry_lines] if entry_lines else []
    return "\n".join(lines) + "\n"


def _format_line(key: str, value: Any, reason: str) -> str:
    comment = f"# {key}: {reason}\n" if reason else ""
    return f"{comment}{key} = {to_toml(value)}"


def summary_rows(proposal: Proposal) -> Iterator[tuple[str, ...]]:
    """Yield a table of moving joints by log."""
    examination = proposal.examination
    log_names = [part.log.name for part in examination.parts]
    for k, part in enumerate(examination.parts):
        is_only_part = log_names.count(part.log.name) == 1
        fits = examination.fits[k] if examination.fits else {}
        for j in np.flatnonzero(part.is_moving):
            fit = fits.get(int(j))
            v = part.v[:, j]
            resting_speed = part.find_resting_speed(int(j))
            joint_match = None if part.dq is None else match_velocity(v, part.dq[:, j], part.period)
            yield (
                part.log.name if is_only_part else f"{part.log.name} from {part.t[0]:.3g} s",
                proposal.description.joints[j],
                f"{part.q[:, j].min():.2f} to {part.q[:, j].max():.2f}",
                f"{np.max(np.abs(v)):.2f}",
                str(len(reversals(v, resting_speed))),
                f"{100 * np.mean(~moving(v, resting_speed)):.0f}",
                "–" if joint_match is None else f"{joint_match.slope:.3f}",
                "–" if joint_match is None else f"{1e3 * joint_match.lag:.0f}",
                f"{fit.gravity.value:.2f} ± {fit.gravity.error:.2f}"
                if fit and fit.bears_gravity
                else "–",
                f"{fit.friction.value:.3g} ({fit.friction.t:.0f})" if fit else "–",
                f"{100 * fit.r2:.0f}" if fit else "–",
            )


HEAD = (
    *("log", "joint", "position", "max speed", "reversals", "rests %", "dq slope", "lag ms"),
    *("gravity / model", "friction (errors)", "expl. %"),
)  # Column headings of `summary_rows`
