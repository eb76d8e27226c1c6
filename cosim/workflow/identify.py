"""Identification of the rigid body."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

from cosim.workflow.answer import Answer, Written, read_health, written_files
from cosim.workflow.arguments import (
    find_body,
    list_logs,
    list_names,
    paths_among,
    read_checked_logs,
    read_model,
    require_choice,
    to_optional_output,
)
from hesr_model.errors import ArgumentError
from hesr_model.support.files import PathArg, provenance
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from cosim.workflow.arguments import BodyArg, CheckedLogs, LawArg, Logs, Names, RobotArg
    from hesr_model.findings import Finding
    from hesr_model.logs.robot_log import Log
    from hesr_model.rigid_body.identification import RigidBody
    from hesr_model.rigid_body.payload import Payload

Method = Literal["stacked", "paper"]
Body = Literal["choose", "nominal", "physical", "free"]


def identify(
    logs: Logs,
    *,
    robot: RobotArg | None = None,
    reversed_logs: Logs = (),
    method: Method = "stacked",
    body: Body = "choose",
    physical: bool = False,
    friction: LawArg | None = None,
    rigid_body: BodyArg | None = None,
    payload: BodyArg | None = None,
    output: PathArg | None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> RigidBody:
    """Identify the rigid body, or a payload, from logs.

    Parameters
    ----------
    logs : log or sequence of logs
        CSV, Parquet or MATLAB files, or ROS bags; in Python also `Log` objects.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    reversed_logs : log or sequence of logs, optional
        Time-reversed counterparts of the logs.
    method : {"stacked", "paper"}
        stacked (least squares with friction columns) or paper (average of
        forward and reverse).
    body : {"choose", "nominal", "physical", "free"}
        Masses of the model file (nominal), physically possible ones, or those
        of plain least squares (free); choose takes those that predict left-out
        rows best.
    physical : bool
        The same as `body` physical.
    friction : law or path, optional
        Friction law to subtract first, to refine the body `rigid_body`.
    rigid_body : body or path, optional
        Rigid body that the law of `friction` was fitted with.
    payload : body or path, optional
        Rigid body without payload, to identify the payload in the logs.
    output : path, optional
        JSON file to write.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    RigidBody
        Base parameters with standard errors [SI units], and their provenance.

    Raises
    ------
    HesrError
        If a log, the robot or the data do not allow the identification.

    Notes
    -----
    Equations 5 to 7 of the paper; `method` paper is its section II, with a free
    body. Logs of more than 4 million numbers are read in pieces, with memory
    that does not grow with the rows and a free body, except with `method`
    paper, `friction`, `payload`, or `body` nominal or physical; the checks then
    read eight pieces. Logs with commands and no torque give servo, armature and
    friction of each joint; the links are those of the model file.

    Examples
    --------
    On the command line::

        $ hesr identify excitation.csv --robot robot.toml -o rigid_body.json

    >>> import hesr
    >>> log_path = "my_arm/logs/sample_training.csv"
    >>> log = hesr.Log.read(log_path, "my_arm/robot.toml")
    >>> hesr.identify(log, body="physical", output="rigid_body.json")
    RigidBody('my_arm', 3 joints, 16 base parameters, condition number 24)
    """
    from hesr_model.findings import log_findings
    from hesr_model.health.examine import check_body
    from hesr_model.rigid_body.refinement import identify_again

    forward_sources = list_logs("logs", logs)
    backward_sources = list_logs("reversed_logs", reversed_logs)
    accepted = list_names("accept", accept)
    output_path = to_optional_output("output", output)
    require_choice("method", method, get_args(Method))
    require_choice("body", body, get_args(Body))
    if physical and body in ("nominal", "free"):
        raise ArgumentError(f"'physical' and 'body' {body} exclude each other; give one of them.")
    option: Body = "physical" if physical else body
    _require_compatible(method, friction, rigid_body, payload, option)

    # All other ways to identify need all rows at once.
    all_at_once = option in ("nominal", "physical") or friction is not None or payload is not None
    in_pieces = method == "stacked" and not all_at_once
    sources = [*forward_sources, *backward_sources]
    checked = read_checked_logs(
        sources, robot, accepted, progress, in_pieces=in_pieces, from_commands=True
    )
    forward_logs = checked.logs[: len(forward_sources)]
    backward_logs = checked.logs[len(forward_sources) :]

    progress("identifying", 0, 1)
    carried_payload = None
    if checked.lacks_torque:
        if backward_sources or all_at_once or method == "paper" or option == "free":
            raise ArgumentError(
                "the logs have no torque; leave out 'reversed_logs', 'method', 'body', 'physical', "
                "'friction' and 'payload'."
            )
        identified_body = _identify_from_commands(checked, progress)
    elif payload is not None:
        identified_body, carried_payload = _identify_payload(checked, payload)
    elif friction is not None and rigid_body is not None:
        identified_body = identify_again(
            forward_logs,
            checked.robot,
            find_body(rigid_body, (), checked.robot),
            read_model(friction),
            reversed_logs=backward_logs,
        )
    else:
        identified_body = _identify_from_torque(
            checked, forward_logs, backward_logs, method, option
        )

    findings = list(check_body(identified_body, checked.robot, checked.logs))
    files = [*checked.files, *paths_among(payload, friction, rigid_body)]
    identified_body = replace(
        identified_body, provenance=_provenance(checked, findings, files, carried_payload)
    )
    if output_path is not None:
        identified_body.write(output_path)
    log_findings(findings)
    return identified_body


def _require_compatible(
    method: Method,
    friction: LawArg | None,
    rigid_body: BodyArg | None,
    payload: BodyArg | None,
    option: Body,
) -> None:
    """Raise ArgumentError for options of different ways to identify."""
    if (friction is None) != (rigid_body is None):
        raise ArgumentError("'friction' and 'rigid_body' must be given together.")
    is_stated = option != "choose"
    if payload is not None and (is_stated or friction is not None or method != "stacked"):
        raise ArgumentError(
            "'payload' excludes 'body', 'physical', 'friction' and 'method' paper; give it alone."
        )
    if is_stated and friction is not None:
        raise ArgumentError("'body' and 'physical' exclude 'friction'; give one of them.")
    if method == "paper" and option == "nominal":
        raise ArgumentError("'method' paper excludes 'body' nominal; give one of them.")


def _identify_from_torque(
    checked: CheckedLogs,
    forward_logs: Sequence[Log],
    backward_logs: Sequence[Log],
    method: Method,
    option: Body,
) -> RigidBody:
    """Return the body of logs with torque, by least squares or by the method of the paper."""
    from hesr_model.rigid_body.accumulation import identify_long
    from hesr_model.rigid_body.choice import identify_from_logs
    from hesr_model.rigid_body.identification import identify as identify_body

    if checked.long_logs:
        return identify_long(checked.long_logs, checked.robot)
    if method == "paper":
        return identify_body(
            forward_logs,
            checked.robot,
            method=method,
            reversed_logs=backward_logs,
            physical=option == "physical",
        )
    return identify_from_logs(forward_logs, checked.robot, option, reversed_logs=backward_logs)


def _identify_from_commands(checked: CheckedLogs, progress: Stages) -> RigidBody:
    """Return the model file's links with the armature that the servos turn."""
    from cosim.servo.body import identify_from_commands

    return identify_from_commands(
        checked.logs, checked.robot, progress=partial(progress, "fitting servos to commands")
    )


def _identify_payload(checked: CheckedLogs, body: BodyArg) -> tuple[RigidBody, Payload]:
    """Return a body with the payload in the logs, and the payload."""
    from hesr_model.rigid_body.payload import add_payload, identify_payload

    unloaded_body = find_body(body, (), checked.robot)
    payload = identify_payload(checked.logs, checked.robot, unloaded_body)
    return add_payload(unloaded_body, payload, checked.robot), payload


def _provenance(
    checked: CheckedLogs,
    findings: Sequence[Finding],
    files: Sequence[Path],
    payload: Payload | None,
) -> dict[str, Any]:
    from hesr_model.support.typed_files import to_json

    entries: dict[str, Any] = {**checked.robot.description.constants}
    if payload is not None:
        entries["payload"] = payload.to_dict()
    if any(checked.robot.slides):
        entries["sliding"] = checked.robot.slides
    health = [to_json(finding) for finding in (*checked.findings, *findings)]
    return provenance(files=files, **entries, health=health)


def answer(body: RigidBody, output: PathArg | None) -> Answer:
    """Return the answer of a rigid body: parameters and residuals, or the payload."""
    from cosim.report.tables.laws import rigid_body
    from hesr_model.robots.description import statements
    from hesr_model.support.typed_files import to_json

    payload = body.provenance.get("payload")
    line = rigid_body(body, body.provenance.get("sliding", ()))
    if payload:
        line = _payload_line(body, payload)
    return Written(
        format="hesr-rigid-body-1",
        lines=[*statements(body.provenance), line],
        data=to_json(body),
        findings=read_health(body.provenance),
        files=written_files(output),
    )


def _payload_line(body: RigidBody, payload: dict[str, Any]) -> str:
    mass, *moments = list(payload["parameters"].values())[:4]
    centre = ", ".join(f"{moment / mass:.4f}" for moment in moments)
    return (
        f"Payload of {mass:.4g} +- {payload['standard_errors'][0]:.2g} kg, centre of mass {centre} "
        f"m in the frame of {body.joints[-1]}."
    )
