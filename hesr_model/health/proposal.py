"""Proposal of a robot file: guessed from column names, corrected until the checks pass."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.findings import Finding, errors_first
from hesr_model.health import joints as selection
from hesr_model.health.examine import SYMPTOMS, Examination, examine, hopeless
from hesr_model.health.joints import changed, chosen, is_model, resting, with_joints, without
from hesr_model.health.velocity import match
from hesr_model.logs.guess import guess
from hesr_model.logs.log_format import LogFormat, column_names
from hesr_model.logs.log_table import LogTable
from hesr_model.logs.readers.formats import format_of
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import moving, reversals
from hesr_model.rigid_body.torque_constants import Constant
from hesr_model.robots.robot import Robot, RobotDescription, RobotLike, description_of
from hesr_model.support.text import toml

_ROUNDS = 4
_CUTOFF_SHARE = 0.3  # low pass over the sample rate
_REMEDIES = (
    ("sample_rate", "log.sample_rate", None),
    ("sort = true", "log.sort", True),
    ("duplicates = 'first'", "log.duplicates", "first"),
    ("finite number is needed", "log.missing", "drop"),
    ("is nan;", "log.missing", "drop"),
)  # Words of a refusal, and the key and value of the robot file that remove it
_HIDDEN = {*SYMPTOMS, "speed-limit", "velocity-lag"}  # warnings that other findings can hide
_NO_REMEDY = "no change that was tried removes it; check the column, its unit and the model"


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """A robot description with reasons by key, logs read with it, and the `first` findings."""

    robot: RobotDescription
    reasons: Mapping[str, str]
    logs: Sequence[Log]
    examination: Examination
    first: Sequence[Finding]
    sliding: frozenset[int] = frozenset()


def inspect_logs(
    paths: Sequence[Path], robot: RobotLike | None = None, joints: Sequence[str] = ()
) -> Proposal:
    """Inspect logs of a known robot and its chosen joints, or by their columns alone."""
    if robot is not None and not paths:
        description, reason = chosen(robot, joints)
        alone = Proposal(
            robot=description, reasons={}, logs=(), examination=Examination(), first=()
        )
        return _with_doubts(alone, {"joints": f"likely: {reason}"} if reason else {})
    stated = None if robot is None or is_model(robot) else description_of(robot)
    table = open_table(paths[0], stated.log if stated else LogFormat())
    if robot is not None:
        description = with_joints(robot, joints, table)
        reason = ""
        if table and not joints and is_model(robot):
            description, reason = selection.select_joints_of_table(description, table)
        known = {"joints": f"likely: {reason}"} if reason else {}
        return _with_doubts(propose(paths, description, known=True), known)
    count = len(guess(table).columns["q"]) if table else 1
    names = tuple(f"joint{k}" for k in range(1, count + 1))
    stranger = RobotDescription(name="robot", model=Path("unknown"), joints=names)
    return propose(paths, stranger, known=False)


def _with_doubts(proposal: Proposal, reasons: Mapping[str, str]) -> Proposal:
    """Return a proposal with reasons, whose findings begin with doubts about the model file."""
    findings = Robot(proposal.robot).doubts
    own = proposal.examination
    own = replace(own, findings=tuple(errors_first([*findings, *own.findings])))
    first = errors_first([*findings, *proposal.first])
    known = {**reasons, **proposal.reasons}
    return replace(proposal, first=first, reasons=known, examination=own)


def propose(paths: Sequence[Path], description: RobotDescription, *, known: bool) -> Proposal:
    """Find a description, with a model file if `known`, that passes the checks."""
    reasons: dict[str, str] = {}
    stated = description.log.torque_per_ampere is not None

    def looked(description: RobotDescription) -> tuple[RobotDescription, list[Log], Examination]:
        description, logs = _read(paths, description, reasons)
        description = _with_cutoff(description, logs, reasons)
        return description, logs, examine(logs, description, Robot(description) if known else None)

    description, logs, examination = looked(_with_columns(paths[0], description, reasons))
    first = examination.findings
    for _ in range(_ROUNDS):
        findings = examination.findings
        some_or_all = [
            finding for finding in findings if finding.check != "velocity-lag"
        ]  # its dq may be wanted
        for some in (some_or_all, *([one] for one in some_or_all)):
            changes, why = _changes(description, some)
            tried = looked(changed(description, changes)) if changes else None
            if tried and _mends(findings, some, tried[2].findings):
                break
        else:
            why = {}
            tried = None
            if not stated and "log.torque_per_ampere" in reasons and known:
                changes = _constants(description, examination, reasons)
                tried = looked(changed(description, changes)) if changes else None
        if tried is None:
            break
        description, logs, examination = tried
        guessed = {k: reasons[k] for k in why if reasons.get(k, "").startswith("guess: ")}
        reasons |= why | {k: f"{said}; {why[k]}" for k, said in guessed.items()}
    if known and (rest := resting(description, examination.parts)):
        reasons["locked"] = f"likely: {', '.join(rest)} rest{'s' * (len(rest) == 1)} in all logs"
        heat = any(log.temperature is not None for log in logs)
        description, logs, examination = looked(without(description, rest, temperatures=heat))
    slides = enumerate(Robot(description).slides) if known else ()
    findings = examination.findings
    left = tuple(
        finding
        if not finding.changes
        or (
            finding.check == "velocity-lag"
            and _mends(
                findings,
                [finding],
                looked(changed(description, _changes(description, [finding])[0]))[2].findings,
            )
        )
        else replace(finding, remedy=_NO_REMEDY, changes={})
        for finding in findings
    )
    examination = replace(examination, findings=left)
    return Proposal(
        robot=description,
        reasons=reasons,
        logs=logs,
        examination=examination,
        first=first,
        sliding=frozenset(j for j, slid in slides if slid),
    )


def open_table(path: Path, log: LogFormat) -> LogTable | None:
    """Open a log as a table, if its columns have names."""
    table = format_of(path).table
    return table(path, log) if table and path.is_file() else None


def _with_columns(
    path: Path, description: RobotDescription, reasons: dict[str, str]
) -> RobotDescription:
    table = open_table(path, description.log)
    if table is None or _has_columns(table, description):
        return description
    found = guess(table, description.joints, timed=description.log.rate is None)
    changes: dict[str, Any] = {f"log.columns.{k}": v for k, v in found.columns.items()}
    if "dq" not in found.columns:
        changes["log.columns.dq"] = ""
        reasons["log.columns.dq"] = "likely: no column looks like a velocity"
    changes |= {f"log.units.{k}": v for k, v in found.units.items()}
    reasons |= {f"log.units.{k}": f"likely: {found.reasons[k]}" for k in found.units}
    reasons |= {
        f"log.columns.{k}": f"likely: {found.reasons.get(k, 'it rises')}" for k in found.columns
    }
    log = description.log
    if "tau" not in found.columns and log.torque_per_ampere is None and log.cylinder is None:
        changes["log.torque_per_ampere"] = (1.0,) * len(description.joints)
        changes["sources.torque_per_ampere"] = "guessed"
        reasons["log.torque_per_ampere"] = "guess: only currents are logged"
    return changed(description, changes)


def _has_columns(table: LogTable, description: RobotDescription) -> bool:
    columns = description.log.columns
    log = description.log
    wanted = [*([] if log.rate else [columns.t]), *column_names(columns.q, description.joints)]
    if log.cylinder is None:
        effort = columns.tau if log.torque_per_ampere is None else columns.current
        wanted += column_names(effort, description.joints)
    wanted += column_names(columns.dq, description.joints) if columns.dq else []
    return set(wanted) <= set(table.names)


def _read(
    paths: Sequence[Path], description: RobotDescription, reasons: dict[str, str]
) -> tuple[RobotDescription, list[Log]]:
    try:
        return description, [Log.read(path, description) for path in paths]
    except LogError as error:
        said = str(error)
        for words, key, value in _REMEDIES:
            if words in said and key not in reasons:
                reasons[key] = f"sure: {said.split(': ', 1)[-1].rstrip('.')}"
                return _read(paths, changed(description, {key: value}), reasons)
        raise


def _with_cutoff(
    description: RobotDescription, logs: Sequence[Log], reasons: dict[str, str]
) -> RobotDescription:
    slowest = 1.0 / max(log.period for log in logs)
    if description.log.filter_cutoff <= 0.4 * slowest or slowest < 1.0:
        return description
    reasons["log.filter_cutoff"] = f"sure: the sample rate is only {slowest:.4g} Hz"
    return changed(description, {"log.filter_cutoff": float(f"{_CUTOFF_SHARE * slowest:.2g}")})


def _changes(
    description: RobotDescription, findings: Sequence[Finding]
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return changes of the robot file with a reason each; two witnesses make one sure."""
    wanted: dict[str, Any] = {}
    reasons: dict[str, dict[str, str]] = {}  # by key and check
    for finding in findings:
        for key, value in finding.changes.items():
            wanted[key] = _merge_values(attrgetter(key)(description), wanted.get(key), value)
            reasons.setdefault(key, {}).setdefault(finding.check, finding.found)
    changes = {key: value for key, value in wanted.items() if value != attrgetter(key)(description)}
    marks = {key: "sure" if len(reasons[key]) > 1 else "likely" for key in changes}
    why = {key: f"{mark}: {'; '.join(reasons[key].values())}" for key, mark in marks.items()}
    return changes, why


def _mends(before: Sequence[Finding], mended: Sequence[Finding], after: Sequence[Finding]) -> bool:
    """Return whether findings with changes are gone, and none is new unless it was hidden."""
    left = _places(after)
    known = _places(before)
    gone = _places(finding for finding in mended if finding.changes)
    new = (
        _places(
            finding
            for finding in after
            if finding.severity == "error" or finding.check not in _HIDDEN
        )
        - known
    )
    hidden = hopeless(before) and ("time-unit", "") not in new
    return not left & gone and (hidden or not new)


def _places(findings: Iterable[Finding]) -> set[tuple[str, str]]:
    return {(finding.check, joint) for finding in findings for joint in finding.joints or ("",)}


def _merge_values(declared: Any, before: Any, value: Any) -> Any:
    if not (isinstance(before, tuple) and isinstance(value, tuple)):
        return value
    old = declared if isinstance(declared, tuple) else (declared,) * len(value)
    return tuple(b if v == o else v for o, b, v in zip(old, before, value, strict=True))


def _constants(
    description: RobotDescription, examination: Examination, reasons: dict[str, str]
) -> dict[str, Any]:
    slopes: dict[int, list[float]] = {}
    for fits in examination.explained:
        for j, fit in fits.items():
            if fit.bears_gravity and abs(fit.gravity.t) > 10.0:
                slopes.setdefault(j, []).append(abs(fit.gravity.value))
    gains = description.log.torque_per_ampere or ()
    scale = {j: 1.0 / float(np.median(found)) for j, found in slopes.items()}
    if not scale or all(abs(np.log(s)) < 0.2 for s in scale.values()):
        return {}
    rest = float(np.median(list(scale.values())))
    reasons["log.torque_per_ampere"] = (
        "guess: only currents are logged; from the model's gravity at joints "
        f"{', '.join(description.joints[j] for j in sorted(scale))}, the median for the others; "
        "replace "
        "them by the manufacturer's values if known"
    )
    new = tuple(float(f"{gain * scale.get(j, rest):.4g}") for j, gain in enumerate(gains))
    return {"log.torque_per_ampere": new}


def with_constants(proposal: Proposal, constants: Sequence[Constant]) -> Proposal:
    """Return the proposal with the torque constants that were determined."""
    description = proposal.robot
    constants = [one for one in constants if one.joint in description.joints]
    gains = description.log.torque_per_ampere
    if gains is None or not any(one.determined for one in constants):
        return proposal
    key = "torque_per_ampere"
    sources = description.sources.each("torque_per_ampere", len(gains))
    pairs = list(zip(constants, gains, sources, strict=True))
    new = [float(f"{c.value:.4g}") if c.determined else gain for c, gain, _ in pairs]
    known = ["identified" if c.determined else source for c, _, source in pairs]
    description = changed(description, {f"log.{key}": tuple(new), f"sources.{key}": tuple(known)})
    said = "identified: from known masses"
    return replace(proposal, robot=description, reasons={**proposal.reasons, f"log.{key}": said})


def robot_file(proposal: Proposal, path: Path) -> str:
    """Return the text of a robot file, with reasons."""
    head = "Proposed by 'hesr inspect'. Comments give certainty and reason."
    return robot_text(proposal.robot, path, head, proposal.reasons)


def robot_text(
    description: RobotDescription, path: Path, head: str, reasons: Mapping[str, str] | None = None
) -> str:
    """Return the text of a robot file at `path`, with a comment as its head and reasons by key."""
    reasons = reasons or {}
    data = description.model_dump()
    unusual = description.model_dump(exclude_defaults=True)
    data["model"] = Path(relpath(description.model, path.resolve().parent)).as_posix()
    log = unusual.pop("log", {})
    if description.log.cylinder is not None:  # with its usual unit
        log["cylinder"] = data["log"]["cylinder"]
    lines = [f"# {head}", "", *(_line(key, data[key], reasons.get(key, "")) for key in unusual)]
    tables = {"log": {k: v for k, v in log.items() if not isinstance(v, dict)}}
    tables |= {f"log.{k}": v for k, v in log.items() if isinstance(v, dict)}
    for table, values in tables.items():
        told = [_line(k, v, reasons.get(f"{table}.{k}", "")) for k, v in values.items()]
        lines += ["", f"[{table}]", *told] if told else []
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any, reason: str) -> str:
    comment = f"# {key}: {reason}\n" if reason else ""
    return f"{comment}{key} = {toml(value)}"


def summary_rows(proposal: Proposal) -> Iterator[tuple[str, ...]]:
    """Yield a table of moving joints by log."""
    examination = proposal.examination
    names = [part.log.name for part in examination.parts]
    for k, part in enumerate(examination.parts):
        whole = names.count(part.log.name) == 1
        fits = examination.explained[k] if examination.explained else {}
        for j in np.flatnonzero(part.moves):
            fit = fits.get(int(j))
            v = part.v[:, j]
            found = None if part.dq is None else match(v, part.dq[:, j], part.period)
            yield (
                part.log.name if whole else f"{part.log.name} from {part.t[0]:.3g} s",
                proposal.robot.joints[j],
                f"{part.q[:, j].min():.2f} to {part.q[:, j].max():.2f}",
                f"{np.max(np.abs(v)):.2f}",
                str(len(reversals(v))),
                f"{100 * np.mean(~moving(v)):.0f}",
                "–" if found is None else f"{found.slope:.3f}",
                "–" if found is None else f"{1e3 * found.lag:.0f}",
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
