"""Inspection of logs before anything is fitted to them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.workflow.answer import Answer, finding_lines, shorten_lines
from cosim.workflow.arguments import (
    find_robot,
    list_logs,
    list_names,
    list_numbers,
    read_logs,
    require_one_way,
    to_optional_output,
)
from hesr_model.errors import ArgumentError, HesrError, LogError
from hesr_model.support.files import PathArg, written_together, written_whole
from hesr_model.support.progress import Stages, silent
from hesr_model.support.text import count_noun, format_settings

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.workflow.arguments import Logs, LogSource, Names, RobotArg
    from hesr_model.findings import Finding
    from hesr_model.health.proposal import Proposal, ProposalError
    from hesr_model.rigid_body.torque_constants import TorqueConstant


_MASS_ERROR = 0.2  # relative error of the model's masses by default, one sigma


@dataclass(frozen=True, kw_only=True, repr=False)
class Inspection(Answer):
    """Result of `hesr.inspect`.

    Attributes
    ----------
    proposal : proposed robot file with reasons, its logs and findings.
    constants : estimated torque constants [N.m/A], one per joint; empty if not requested.
    next_command : command that follows; empty if there is none.
    failure : reason why no study can run.
    currents : kinds of unsigned currents, by joint.
    files : written files.
    """

    format = "hesr-inspection-1"
    proposal: Proposal
    constants: Sequence[TorqueConstant] = ()
    next_command: str = ""
    failure: str = ""
    currents: Sequence[str] = ()
    files: Sequence[Path] = field(default_factory=tuple)

    @property
    def findings(self) -> Sequence[Finding]:  # type: ignore[override]  # derived from the proposal
        """Findings that the proposed robot file leaves, and why a study is not proposed."""
        from hesr_model.findings import Finding

        findings = list(self.proposal.examination.findings)
        if self.failure:
            sentence = f"the study is not written, as it would fail: {self.failure}"
            findings.insert(0, Finding(check="study", found=sentence))
        return findings

    @property
    def fixed(self) -> Sequence[Finding]:
        """Findings that the proposed robot file removes."""
        open_checks = {(finding.check, finding.joints) for finding in self.findings}
        return [
            finding
            for finding in self.proposal.first_findings
            if (finding.check, finding.joints) not in open_checks
        ]

    @property
    def shows_tables(self) -> bool:  # type: ignore[override]  # derived from the proposal
        """Whether only a robot was inspected."""
        return not self.proposal.logs

    def summary(self) -> str:
        """Return what is fixed, still open and guessed, then files and the next command."""
        lines = [f"Fixed by the proposed robot file: {finding.sentence}" for finding in self.fixed]
        lines += finding_lines(self.findings)
        lines += [f"open: {finding.sentence}" for finding in self.proposal.examination.undecided]
        lines += [
            f"open: {format_settings({key: choice.value})}: {choice.reason}"
            for key, choice in self.proposal.undecided.items()
        ]
        if any(not log.has_torque for log in self.proposal.logs):
            lines.append("No torque: friction is found from commands and positions.")
        lines += self.currents
        if not self.proposal.first_findings:
            lines.append("Nothing wrong or unusual was found.")
        lines += [f"proposed: {key}: {text}" for key, text in self.proposal.reasons.items()]
        lines += [constant.sentence for constant in self.constants]
        text = shorten_lines(lines, self.files)
        if not self.next_command:
            return text
        return "\n".join(filter(None, [text, f"Next: {self.next_command}"]))

    def tables(self) -> Sequence[ResultTable | str]:
        """Return one line and one table per log and all findings, or the tables of a robot."""
        from cosim.report.tables.table import ResultTable, TableRow, make_row
        from hesr_model.health.proposal import HEAD, summary_rows

        shown: list[ResultTable | str] = []
        if not self.proposal.logs:
            from cosim.report.tables.laws import robot_tables
            from hesr_model.robots.robot import Robot

            shown += robot_tables(Robot(self.proposal.description))
        for log in self.proposal.logs:
            line = (
                f"{log.name}: {len(log.t)} rows, {log.t[-1] - log.t[0]:.1f} s, {log.rate:.4g} Hz, "
                f"jitter {100 * log.jitter:.0f} %"
            )
            if len(log.gaps):
                line += f", {count_noun(len(log.gaps), 'gap')}"
            if log.dropped:
                line += f", {log.dropped} rows left out"
            shown.append(line)
        by_log: dict[str, list[TableRow]] = {}
        for name, joint, *cells in summary_rows(self.proposal):
            by_log.setdefault(name, []).append(make_row(joint, *cells))
        shown += [ResultTable(caption=n, head=HEAD[1:], rows=rows) for n, rows in by_log.items()]
        if self.proposal.logs:
            shown += finding_lines(self.proposal.first_findings)
        return shown

    def result(self) -> Any:
        """Return findings before and after the proposal, what is undecided, reasons, constants."""
        from hesr_model.support.typed_files import to_json

        return {
            "given": [to_json(finding) for finding in self.proposal.first_findings],
            "proposed": [to_json(finding) for finding in self.findings],
            "undecided": [to_json(finding) for finding in self.proposal.examination.undecided],
            "choices": {
                key: {"value": choice.value, "reason": choice.reason}
                for key, choice in self.proposal.undecided.items()
            },
            "reasons": dict(self.proposal.reasons),
            "torque_constants": [
                to_json(constant) for constant in self.constants if constant.determined
            ],
        }


def inspect(
    logs: Logs = (),
    *,
    robot: RobotArg | None = None,
    joints: Names = (),
    write: PathArg | None = None,
    study: PathArg | None = None,
    output: PathArg | None = None,
    torque_constants: bool = False,
    mass_error: float = _MASS_ERROR,
    loaded: Logs = (),
    payload: Iterable[float] | None = None,
    progress: Stages = silent,
) -> Inspection:
    r"""Find errors in logs and robots; propose a robot file.

    Parameters
    ----------
    logs : log or sequence of logs
        CSV, Parquet or MATLAB files, or ROS bags; without any only the robot is
        inspected.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; without it logs are checked against
        themselves.
    joints : str or sequence of str, optional
        Joints that move in the logs; default: those of the columns.
    write : path, optional
        Robot file to write as proposed.
    study : path, optional
        Study of these logs to write, for `run`.
    output : path, optional
        Page (.html) or picture (.svg) to write.
    torque_constants : bool
        Estimate torque constants from known masses: those of the model, or a
        payload.
    mass_error : float
        Torque constants: relative error of the model's masses, one sigma.
    loaded : log or sequence of logs, optional
        Torque constants: logs under the payload.
    payload : sequence of four float, kg and m, optional
        Torque constants: mass and centre of the payload in the frame of the
        last joint.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    Inspection
        Findings, and a robot description with a reason for each change.

    Raises
    ------
    LogError
        If a log cannot be read.
    ConfigError
        If options contradict each other.

    Examples
    --------
    On the command line::

        $ hesr inspect log.csv --robot my_arm.urdf --write robot.toml \
          --study study.toml
        $ hesr inspect run.csv --robot robot.toml --torque-constants \
          --mass-error 0.2

    >>> import hesr
    >>> log_path = "my_arm/logs/sample_training.csv"
    >>> hesr.inspect(log_path, robot="my_arm/robot.toml").passed
    True
    """
    from hesr_model.health.proposal import ProposalError, apply_constants, inspect_logs

    sources = list_logs("logs", logs)
    loaded_sources = list_logs("loaded", loaded)
    names = list_names("joints", joints, commas=True)
    point_mass = None
    if payload is not None:
        point_mass = list_numbers("payload", payload)
    _require_robot(robot, names, write, study)
    page_path = to_optional_output("output", output)
    robot_path = to_optional_output("write", write)
    study_path = to_optional_output("study", study)
    if not torque_constants:
        _refuse_options_of_constants(mass_error, loaded_sources, point_mass)
    if not sources:
        _require_robot_alone(robot, study, torque_constants=torque_constants)
    log_files = _find_log_files(sources)
    progress("inspecting logs", 0, 1)
    try:
        proposal = inspect_logs(log_files, robot, names)
    except ProposalError as refusal:
        raise _write_refused(refusal, robot_path) from refusal
    constants: Sequence[TorqueConstant] = ()
    if torque_constants:
        constants = _estimate_torque_constants(
            sources, robot, names, mass_error, loaded_sources, point_mass, progress
        )
        proposal = apply_constants(proposal, constants)
    severities = {finding.severity for finding in proposal.examination.findings}
    has_errors = "error" in severities
    currents: Sequence[str] = ()
    if has_errors:
        study_path = None  # its logs cannot be used yet
    files, failure = _write(proposal, page_path, robot_path, study_path)
    if not has_errors:
        currents = _describe_currents(proposal)
    is_ready = not has_errors and not failure
    return Inspection(
        proposal=proposal,
        constants=constants,
        next_command=_next_command(write, study, is_ready=is_ready),
        failure=failure,
        currents=currents,
        files=files,
    )


def _describe_currents(proposal: Proposal) -> list[str]:
    """Return the kinds of unsigned currents in logs without torque."""
    from hesr_model.robots.robot import Robot

    logs = [log for log in proposal.logs if not log.has_torque and log.current_size is not None]
    if not logs or proposal.description is None:
        return []
    from cosim.servo.inspection import describe_currents

    return describe_currents(logs, Robot(proposal.description))


def _require_robot(
    robot: RobotArg | None, joints: Sequence[str], write: PathArg | None, study: PathArg | None
) -> None:
    """Raise ArgumentError for options that need a robot or its file."""
    if write and not robot:
        raise ArgumentError("'write' needs 'robot': a robot file names the robot's model.")
    if study and not write:
        raise ArgumentError(
            "'study' needs 'write': a study names the robot file that reads its logs."
        )
    if joints and robot is None:
        raise ArgumentError("'joints' needs 'robot': joints are those of a robot's model.")


def _require_robot_alone(
    robot: RobotArg | None, study: PathArg | None, *, torque_constants: bool
) -> None:
    if robot is None or study or torque_constants:
        raise ArgumentError("'study' and 'torque_constants' need logs; without logs give 'robot'.")


def _refuse_options_of_constants(
    mass_error: float, loaded: Sequence[LogSource], payload: Sequence[float] | None
) -> None:
    if loaded or payload is not None or mass_error != _MASS_ERROR:
        raise ArgumentError("'mass_error', 'loaded' and 'payload' need 'torque_constants'.")


def _find_log_files(sources: Sequence[LogSource]) -> list[Path]:
    """Return the files of logs; a log in memory without a file is refused."""
    files = []
    for source in sources:
        file = source if isinstance(source, Path) else source.path
        if file is None:
            raise ArgumentError("logs are inspected as files; give their paths.")
        files.append(file)
    return files


def _next_command(write: PathArg | None, study: PathArg | None, *, is_ready: bool) -> str:
    if not is_ready:
        return (
            "correct these errors in the robot file or the logs, then repeat hesr inspect with "
            f"--robot {write or 'FILE'}"
        )
    if study:
        return f"hesr run {study}"
    return ""


def _write_refused(refusal: ProposalError, robot_path: Path | None) -> LogError:
    """Write what is known of a log that cannot be read; return the refusal."""
    from hesr_model.health.proposal import robot_file

    keys = list(refusal.proposal.undecided)
    if robot_path is None or not keys:
        return refusal
    with written_whole(robot_path) as temporary:
        temporary.write_text(robot_file(refusal.proposal, robot_path), encoding="utf-8")
    return LogError(
        f"{refusal} {robot_path} is written; complete there {' or '.join(keys)}, which is a "
        "comment.",
        code=refusal.code,
        where=refusal.where,
        key=refusal.key,
    )


def _write(
    proposal: Proposal, page_path: Path | None, robot_path: Path | None, study_path: Path | None
) -> tuple[list[Path], str]:
    """Write what is requested; return the paths, and the reason if the study fails in a dry run."""
    from hesr_model.health.proposal import robot_file

    failure = ""
    if page_path:
        from cosim.report.inspection import write_inspection

        write_inspection(page_path, proposal)
    if robot_path and study_path:
        from cosim.study.proposal import dry_run, study_file
        from hesr_model.health.examine import HealthError

        try:
            dry_run(proposal)
        except HealthError as error:
            # Its advice is for commands that learn from logs.
            sentences = [f"{finding.sentence} [{finding.check}]" for finding in error.findings]
            study_path = None
            failure = " ".join(sentences)
        except HesrError as error:
            study_path = None
            failure = str(error)
    if robot_path:
        with written_together(study_path or robot_path) as new:
            new(robot_path).write_text(robot_file(proposal, robot_path), encoding="utf-8")
            if study_path:
                text = study_file(proposal, robot_path, study_path)
                new(study_path).write_text(text, encoding="utf-8")
    return [path for path in (page_path, robot_path, study_path) if path], failure


def _estimate_torque_constants(
    sources: Sequence[LogSource],
    robot: RobotArg | None,
    joints: Sequence[str],
    mass_error: float,
    loaded_sources: Sequence[LogSource],
    payload: Sequence[float] | None,
    progress: Stages,
) -> Sequence[TorqueConstant]:
    """Estimate torque constants, starting from the robot file's `torque_per_ampere`."""
    from hesr_model.health.joints import select_joints
    from hesr_model.logs.robot_log import collect_parts
    from hesr_model.logs.signals import Motion, smooth
    from hesr_model.rigid_body.torque_constants import point_payload, torque_constants

    point_mass = None
    if payload is not None:
        if len(payload) != 4:
            raise ArgumentError(
                f"'payload': found {len(payload)} values; expected mass and the three coordinates "
                "of its centre."
            )
        mass, *centre = payload
        point_mass = point_payload(mass, centre)
    if robot and joints:
        robot = select_joints(robot, joints)
    moved_robot = find_robot(robot, ())
    log_format = moved_robot.description.log

    def smooth_logs(sources: Sequence[LogSource]) -> list[Motion]:
        logs = read_logs(sources, moved_robot)
        require_one_way(logs, from_commands=False)
        parts = collect_parts(logs)
        return [smooth(part, log_format.filter_cutoff) for part in parts]

    progress("estimating torque constants", 0, 1)
    return torque_constants(
        smooth_logs(sources),
        moved_robot,
        log_format.torque_per_ampere or (1.0,) * moved_robot.n,
        mass_error=mass_error,
        loaded=smooth_logs(loaded_sources),
        payload=point_mass,
    )
