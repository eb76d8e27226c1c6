"""Proposal of a robot file: guessed from column names, corrected until the checks pass."""

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from os.path import relpath
from pathlib import Path
from typing import Any, NamedTuple

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
from hesr_model.health.evidence import SmoothPart, TorqueFit
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
from hesr_model.health.torque import TorqueFits
from hesr_model.health.velocity import match_velocity
from hesr_model.logs.csv_text import HeaderError
from hesr_model.logs.guess import guess_columns
from hesr_model.logs.left_over import report_left_over
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
_PRINTED_LINE = re.compile(r"\[(log(?:\.units)?)\] (\w+ = (?:'[^']*'|[\w.+]+))")
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
    """A robot description with reasons, the logs read with it, and what their checks find.

    Attributes
    ----------
    description : proposed for the robot file.
    reasons : for its values, with their certainty, by key such as ``log.units.q``.
    logs : read with the description; empty if they cannot be read.
    examination : of these logs.
    first_findings : before any change.
    prismatic_joints : indices of joints that slide.
    undecided : values by key that an edit of the robot file can choose.
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
    if robot is None:
        return _inspect_unknown_robot(paths)
    if not paths:
        description, reason = choose_joints(robot, joints)
        proposal = _build_unread_proposal(description, {})
        return _add_doubts(proposal, _explain_joints(reason))
    log_format = LogFormat()
    if not is_model_path(robot):
        log_format = to_description(robot).log
    try:
        table = open_table(paths[0], log_format)
    except HeaderError as error:
        description = to_description(robot)
        missing_lines = find_missing_lines(error, None, description)
        proposal = _build_unread_proposal(description, {}, missing_lines)
        raise ProposalError.from_refusal(error, proposal) from error
    description = select_joints(robot, joints, table)
    reason = ""
    if table and not joints and is_model_path(robot):
        description, reason = selection.select_joints_of_table(description, table)
    return _add_doubts(propose(paths, description, has_model=True), _explain_joints(reason))


def _inspect_unknown_robot(paths: Sequence[Path]) -> Proposal:
    """Inspect logs by their columns alone, with as many joints as the first one has."""
    table = open_table(paths[0], LogFormat())
    joint_count = 1
    if table:
        joint_count = guess_columns(table).joint_count
    names = tuple(f"joint{number}" for number in range(1, joint_count + 1))
    description = RobotDescription(name="robot", model=Path("unknown"), joints=names)
    return propose(paths, description, has_model=False)


def _explain_joints(reason: str) -> dict[str, str]:
    """Return the reason for the choice of joints by its key, if there is one."""
    if not reason:
        return {}
    return {"joints": f"likely: {reason}"}


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
    search = _Search(paths=paths, has_model=has_model, stated_format=description.log)
    attempt, undecided = search.begin(description)
    first_findings = attempt.examination.findings
    if any(finding.check == "velocity-match" for finding in first_findings):
        changes, open_choices = choose_motion(
            attempt.description, search.read_logs, search.reasons, has_model=has_model
        )
        undecided |= open_choices
        if changes:
            attempt = search.apply_and_examine(attempt.description, changes)
    attempt = search.correct(attempt)
    if has_model:
        attempt = search.lock_resting_joints(attempt)
    description = attempt.description
    if description.log.filter_cutoff == search.stated_format.filter_cutoff:
        search.reasons.pop("log.filter_cutoff", None)  # of a change that was only tried
    prismatic_joints: frozenset[int] = frozenset()
    if has_model:
        prismatic_joints = frozenset(np.flatnonzero(Robot(description).slides).tolist())
    findings = attempt.examination.findings
    remaining_findings = tuple(search.withdraw_changes(finding, attempt) for finding in findings)
    left_over = tuple(finding for log in attempt.logs for finding in report_left_over(log))
    examination = replace(attempt.examination, findings=remaining_findings + left_over)
    return Proposal(
        description=description,
        reasons=search.reasons,
        logs=attempt.logs,
        examination=examination,
        first_findings=first_findings,
        prismatic_joints=prismatic_joints,
        undecided={**undecided, **find_count_size(findings, examination.parts, description)},
    )


class _Attempt(NamedTuple):
    """A description that is tried, the logs read with it, and what their checks find."""

    description: RobotDescription
    logs: list[Log]
    examination: Examination


@dataclass(frozen=True, kw_only=True, eq=False)
class _Search:
    """Search for a description with which logs pass the checks.

    Attributes
    ----------
    paths : logs.
    has_model : whether the robot has a model file.
    stated_format : of the logs, before changes.
    reasons : for values of the robot file, by key; each step adds those of its changes.
    """

    paths: Sequence[Path]
    has_model: bool
    stated_format: LogFormat
    reasons: dict[str, str] = field(default_factory=dict)

    def read_logs(self, description: RobotDescription) -> list[Log]:
        """Read logs with a description that may not become the proposal."""
        return _read_logs(self.paths, description, dict(self.reasons))[1]

    def read_and_examine(self, description: RobotDescription) -> _Attempt:
        """Read logs, with what their refusals and their rate demand, and check them."""
        description, logs = _read_logs(self.paths, description, self.reasons)
        stated_cutoff = self.stated_format.filter_cutoff
        description = _limit_cutoff(description, logs, self.reasons, stated_cutoff)
        robot = Robot(description) if self.has_model else None
        return _Attempt(description, logs, examine(logs, description, robot))

    def apply_and_examine(
        self, description: RobotDescription, changes: Mapping[str, Any]
    ) -> _Attempt:
        """Examine the logs with a changed description."""
        return self.read_and_examine(apply_changes(description, changes))

    def begin(self, description: RobotDescription) -> tuple[_Attempt, dict[str, Undecided]]:
        """Examine the logs with guessed columns; return what remains undecided as well.

        Raises
        ------
        ProposalError : the logs cannot be read yet.
        """
        column_proposal = _propose_columns(self.paths[0], description, self.reasons)
        description = column_proposal.description
        try:
            if column_proposal.refusal is not None:
                raise column_proposal.refusal
            changes, undecided = choose_effort(
                column_proposal, self.read_logs, self.reasons, has_model=self.has_model
            )
            return self.apply_and_examine(description, changes), undecided
        except LogError as error:
            table = open_table(self.paths[0], description.log)
            missing_lines = find_missing_lines(error, table, description)
            proposal = _build_unread_proposal(description, self.reasons, missing_lines)
            raise ProposalError.from_refusal(error, proposal) from error

    def correct(self, attempt: _Attempt) -> _Attempt:
        """Apply the changes of findings, round by round, as long as these improve."""
        for _ in range(_ROUNDS):
            improvement, change_reasons = self._try_findings(attempt)
            if improvement is None:
                improvement = self._try_constants(attempt)
            if improvement is None:
                break
            attempt = improvement
            for key, change_reason in change_reasons.items():
                earlier_reason = self.reasons.get(key, "")
                if earlier_reason.startswith("guess: "):
                    self.reasons[key] = f"{earlier_reason}; {change_reason}"
                else:
                    self.reasons[key] = change_reason
        return attempt

    def _try_findings(self, attempt: _Attempt) -> tuple[_Attempt | None, dict[str, str]]:
        """Try the changes of all findings, then of each; return the first improvement."""
        findings = attempt.examination.findings
        # A velocity that lags may be wanted; one that contradicts its position is a witness.
        candidate_findings = [
            finding for finding in findings if finding.check not in _CHOSEN_BY_TRIAL
        ]
        for target_findings in (candidate_findings, *([finding] for finding in candidate_findings)):
            changes, change_reasons = _merge_changes(attempt.description, target_findings)
            if not changes:
                continue
            changed = self.apply_and_examine(attempt.description, changes)
            if _is_improvement(findings, target_findings, changed.examination.findings):
                return changed, change_reasons
        return None, {}

    def _try_constants(self, attempt: _Attempt) -> _Attempt | None:
        """Estimate torque constants that were only guessed, if the model tells them."""
        is_guessed = (
            self.stated_format.torque_per_ampere is None and "log.torque_per_ampere" in self.reasons
        )
        if not (is_guessed and self.has_model):
            return None
        changes = _estimate_constants(attempt.description, attempt.examination, self.reasons)
        if not changes:
            return None
        return self.apply_and_examine(attempt.description, changes)

    def lock_resting_joints(self, attempt: _Attempt) -> _Attempt:
        """Remove joints that rest in all logs."""
        resting_joints = find_resting_joints(attempt.description, attempt.examination.parts)
        if not resting_joints:
            return attempt
        verb = "rests" if len(resting_joints) == 1 else "rest"
        self.reasons["locked"] = f"likely: {', '.join(resting_joints)} {verb} in all logs"
        optional = [name for name in OPTIONAL if _has_quantity(attempt.logs, name)]
        return self.read_and_examine(remove_joints(attempt.description, resting_joints, optional))

    def withdraw_changes(self, finding: Finding, attempt: _Attempt) -> Finding:
        """Return a finding without its changes, which were tried in vain, unless a user chooses.

        A velocity that lags may be wanted: its changes stay if they would help.
        """
        if not finding.changes or finding.check == "velocity-match":
            return finding
        if finding.check == "velocity-lag":
            changes, _ = _merge_changes(attempt.description, [finding])
            changed = self.apply_and_examine(attempt.description, changes)
            findings = attempt.examination.findings
            if _is_improvement(findings, [finding], changed.examination.findings):
                return finding
        return replace(finding, remedy=_NO_REMEDY, changes={})


def open_table(path: Path, log_format: LogFormat) -> LogTable | None:
    """Open a log as a table, if its columns have names."""
    read_named_table = find_format(path).table
    if read_named_table is None or not path.is_file():
        return None
    return read_named_table(path, log_format)


def _has_quantity(logs: Sequence[Log], name: str) -> bool:
    """Return whether any log has a quantity."""
    return any(getattr(log, name) is not None for log in logs)


def _propose_columns(
    path: Path, description: RobotDescription, reasons: dict[str, str]
) -> ColumnProposal:
    table = open_table(path, description.log)
    if table is None:
        return ColumnProposal(description=description)
    proposal = propose_columns(table, description)
    reasons |= proposal.reasons
    return proposal


def _build_unread_proposal(
    description: RobotDescription,
    reasons: Mapping[str, str],
    undecided: Mapping[str, Undecided] | None = None,
) -> Proposal:
    """Return what is known without reading a log, and the lines that are missing."""
    return Proposal(
        description=description,
        reasons=reasons,
        logs=(),
        examination=Examination(),
        first_findings=(),
        undecided=undecided or {},
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
    for table, line in _PRINTED_LINE.findall(message):
        ((key, value),) = tomllib.loads(line).items()
        yield f"{table}.{key}", value
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
    changes: dict[str, Any] = {}
    change_reasons: dict[str, str] = {}
    for key, value in new_values.items():
        if value == attrgetter(key)(description):
            continue
        mark = "sure" if len(reasons[key]) > 1 else "likely"
        changes[key] = value
        change_reasons[key] = f"{mark}: {'; '.join(reasons[key].values())}"
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
    plain_findings = [
        finding
        for finding in findings_after
        if finding.severity == "error" or finding.check not in _HIDEABLE_CHECKS
    ]
    new_places = _collect_places(plain_findings) - places_before
    was_hidden = is_hopeless(findings_before) and ("time-unit", "") not in new_places
    return not places_after & target_places and (was_hidden or not new_places)


def _collect_places(findings: Iterable[Finding]) -> set[tuple[str, str]]:
    """Return check and joint of findings; without joints, one place without a name."""
    places = set()
    for finding in findings:
        places |= {(finding.check, joint) for joint in finding.joints or ("",)}
    return places


def _merge_values(declared: Any, earlier: Any, value: Any) -> Any:
    """Return a value by joint in which what it leaves as declared is that of an earlier one."""
    if not (isinstance(earlier, tuple) and isinstance(value, tuple)):
        return value
    declared_values = declared
    if not isinstance(declared, tuple):
        declared_values = (declared,) * len(value)
    merged = []
    for declared_entry, earlier_entry, entry in zip(declared_values, earlier, value, strict=True):
        is_as_declared = entry == declared_entry
        merged.append(earlier_entry if is_as_declared else entry)
    return tuple(merged)


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
    new_gains = []
    new_sources = []
    for constant, gain, source in zip(constants, gains, sources, strict=True):
        if constant.determined:
            new_gains.append(float(f"{constant.value:.4g}"))
            new_sources.append("identified")
        else:
            new_gains.append(gain)
            new_sources.append(source)
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
    lines = [f"# {head}", ""]
    lines += [_format_line(key, document[key], reasons.get(key, "")) for key in non_defaults]
    tables: dict[str, dict[str, Any]] = {"log": {}}
    for key, value in log_entries.items():
        if isinstance(value, dict):
            tables[f"log.{key}"] = value
        else:
            tables["log"][key] = value
    choices: dict[str, dict[str, Undecided]] = {}  # by table
    for key, choice in (undecided or {}).items():
        table_name, _, name = key.rpartition(".")
        choices.setdefault(table_name, {})[name] = choice
    for table_name in dict.fromkeys((*tables, *choices)):
        entry_lines = [
            _format_line(key, value, reasons.get(f"{table_name}.{key}", ""))
            for key, value in tables.get(table_name, {}).items()
        ]
        entry_lines += [
            f"# {name}: undecided: {choice.reason}\n# {name} = {to_toml(choice.value)}"
            for name, choice in choices.get(table_name, {}).items()
        ]
        if entry_lines:
            lines += ["", f"[{table_name}]", *entry_lines]
    return "\n".join(lines) + "\n"


def _format_line(key: str, value: Any, reason: str) -> str:
    line = f"{key} = {to_toml(value)}"
    if not reason:
        return line
    return f"# {key}: {reason}\n{line}"


def summary_rows(proposal: Proposal) -> Iterator[tuple[str, ...]]:
    """Yield a table of moving joints by log."""
    examination = proposal.examination
    log_names = [part.log.name for part in examination.parts]
    for k, part in enumerate(examination.parts):
        place = part.log.name
        if log_names.count(place) > 1:
            place = f"{place} from {part.t[0]:.3g} s"
        fits: TorqueFits = {}
        if examination.fits:
            fits = examination.fits[k]
        for j in np.flatnonzero(part.is_moving):
            yield (
                place,
                proposal.description.joints[j],
                *_format_motion(part, int(j)),
                *_format_fit(fits.get(int(j))),
            )


_NO_CELL = "–"  # of what a log does not tell


def _format_motion(part: SmoothPart, j: int) -> tuple[str, ...]:
    """Return the cells of a joint that come from its position and velocity."""
    q = part.q[:, j]
    v = part.v[:, j]
    resting_speed = part.find_resting_speed(j)
    slope = _NO_CELL
    lag = _NO_CELL
    if part.dq is not None:
        joint_match = match_velocity(v, part.dq[:, j], part.period)
        slope = f"{joint_match.slope:.3f}"
        lag = f"{1e3 * joint_match.lag:.0f}"
    return (
        f"{q.min():.2f} to {q.max():.2f}",
        f"{np.max(np.abs(v)):.2f}",
        str(len(reversals(v, resting_speed))),
        f"{100 * np.mean(~moving(v, resting_speed)):.0f}",
        slope,
        lag,
    )


def _format_fit(fit: TorqueFit | None) -> tuple[str, str, str]:
    """Return the cells of a joint that come from the regression of its torque."""
    if fit is None:
        return _NO_CELL, _NO_CELL, _NO_CELL
    gravity = _NO_CELL
    if fit.bears_gravity:
        gravity = f"{fit.gravity.value:.2f} ± {fit.gravity.error:.2f}"
    friction = f"{fit.friction.value:.3g} ({fit.friction.t:.0f})"
    return gravity, friction, f"{100 * fit.r2:.0f}"


HEAD = (
    *("log", "joint", "position", "max speed", "reversals", "rests %", "dq slope", "lag ms"),
    *("gravity / model", "friction (errors)", "expl. %"),
)  # Column headings of `summary_rows`
