"""Page of `hesr inspect`: contents of logs by joint, and findings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cosim.report.figures.chart import Line
from cosim.report.figures.motions import JointView, joints, picture
from cosim.report.figures.style import MEASURED, SERIES, Stroke, write_svg
from cosim.report.markup import ResultFigure, Section, render
from cosim.report.result_page import write_answer
from cosim.report.tables.laws import robot_tables
from cosim.report.tables.table import ResultTable, make_row
from cosim.workflow.answer import Written
from hesr_model.health.evidence import SmoothPart
from hesr_model.health.examine import Examination, find_unseen_effects
from hesr_model.health.proposal import HEAD, Proposal, robot_file, summary_rows
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.text import count_noun

_POINTS = 700  # maximum number of points of a line


_JOINTS = "Joints"
_ROBOT = "Robot"
_MOTION = "Motion and torque"


def write_inspection(path: Path, proposal: Proposal) -> None:
    """Write the page, or only its figure if the suffix is ``.svg``."""
    robot = None
    if proposal.description.model.is_file():
        robot = Robot(proposal.description)
    if path.suffix.lower() == ".svg":
        figure = picture(robot) if robot and not proposal.logs else joints(_views(proposal))
        write_svg(figure, path)
        return
    views = _views(proposal)
    subject = "Logs of" if proposal.logs else "Robot"
    answer = Written(
        title=f"{subject} {proposal.description.name}",
        lines=_summary_lines(proposal, views),
        findings=proposal.first_findings,
        shown=_tables(proposal, robot),
        drawn=_figures(proposal, robot, views),
    )
    write_answer(answer, path, _text_sections(proposal, path))


def _summary_lines(proposal: Proposal, views: Sequence[JointView]) -> list[str]:
    """Count the findings, and say whether the proposal fixes them and what has no figure."""
    errors = sum(finding.severity == "error" for finding in proposal.first_findings)
    warnings = len(proposal.first_findings) - errors
    lines = ["No errors or warnings."]
    if proposal.first_findings:
        lines = [f"{count_noun(errors, 'error')}, {count_noun(warnings, 'warning')}."]
    if proposal.first_findings and proposal.reasons and not proposal.examination.findings:
        lines.append("The proposed robot file fixes all of them.")
    if proposal.logs and not proposal.examination.parts:
        lines.append("No figure: the time stamps are unusable.")
    elif proposal.logs and not views:
        lines.append("No joint moves.")
    return lines


def _tables(proposal: Proposal, robot: Robot | None) -> list[ResultTable]:
    """Return the tables of the robot, if its model is known, of the logs and of the joints."""
    tables = []
    if robot:
        tables += [replace(table, section=_ROBOT) for table in robot_tables(robot)]
    if proposal.logs:
        tables += [_logs(proposal), _joints(proposal)]
    return tables


def _figures(
    proposal: Proposal, robot: Robot | None, views: Sequence[JointView]
) -> list[ResultFigure]:
    """Return two poses of the robot, and motion and torque of the joints that move."""
    figures = []
    if robot:
        figures.append(
            ResultFigure(
                section=_ROBOT,
                key="arm",
                drawing=picture(robot),
                caption="The arm without its shapes, in the frame of its base: axes of the joints, "
                "and centres of mass of the links.",
                alt="Two poses of the arm, with the axes of its joints.",
                small=True,
            )
        )
    if views:
        log = _longest(proposal)[1].log.name
        figures.append(
            ResultFigure(
                section=_MOTION,
                key="joints",
                drawing=joints(views),
                caption=f"Log {log}: velocity, logged and from the smoothed position; friction "
                "(torque not explained by the model) over velocity; histograms of velocity and "
                "gravity torque over all logs. Friction is learned only where there are rows.",
                alt="For each joint velocity over time, friction over velocity, and two "
                "histograms.",
            )
        )
    return figures


def _text_sections(proposal: Proposal, path: Path) -> list[Section]:
    """Return open findings, what the logs cannot show, and the proposed robot file."""
    open_findings = proposal.examination.findings if proposal.reasons else ()
    gaps: dict[str, list[str]] = {}
    for joint, gap in find_unseen_effects(proposal.examination, proposal.description.joints):
        gaps.setdefault(gap, []).append(joint)
    file = ""
    if proposal.description.model.is_file():
        file = robot_file(proposal, path)
    titles = {"file": "Proposed robot file"}
    if proposal.logs:
        titles = {"unseen": "What this log cannot show", **titles}
    if open_findings:
        titles = {"open": "Still open with the proposed robot file", **titles}
    sections = []
    for key, title in titles.items():
        html = render(
            "sections/inspection.html.j2", part=key, findings=open_findings, gaps=gaps, file=file
        )
        sections.append(Section(key=key, title=title, html=html))
    return sections


def _logs(proposal: Proposal) -> ResultTable:
    rows = []
    for log in proposal.logs:
        numbers = (f"{log.t[-1] - log.t[0]:.1f}", f"{log.rate:.4g}", f"{100 * log.jitter:.0f}")
        gaps = str(len(log.gaps))
        dropped = str(log.dropped)
        rows.append(make_row(log.name, str(len(log.t)), *numbers, gaps, dropped))
    head = ("log", "rows", "length in s", "rate in Hz", "jitter in %", "gaps", "rows left out")
    return ResultTable(caption="Logs", head=head, rows=rows)


def _joints(proposal: Proposal) -> ResultTable:
    rows = [make_row(f"{log}: {joint}", *cells) for log, joint, *cells in summary_rows(proposal)]
    caption = (
        "Moving joints with the proposed robot file. ‘dq slope’: velocity from the position over "
        "the logged one; ‘gravity / model’: measured over modelled gravity torque; ‘friction’: "
        "torque in phase with the velocity in N.m, and in standard errors"
    )
    head = ("log: joint", *HEAD[2:])
    return ResultTable(caption=caption, head=head, rows=rows, section=_JOINTS)


def _longest(proposal: Proposal) -> tuple[int, SmoothPart]:
    return max(enumerate(proposal.examination.parts), key=lambda part: np.ptp(part[1].t))


def _views(proposal: Proposal) -> list[JointView]:
    examination = proposal.examination
    if not examination.parts:
        return []
    k, part = _longest(proposal)
    views = []
    for j in np.flatnonzero(part.is_moving).tolist():
        loads = None
        if examination.torques:
            loads = np.concatenate([torques.gravity[:, j] for torques in examination.torques])
        view = JointView(
            name=proposal.description.joints[j],
            # Without a model joints count as revolute.
            unit="m/s" if j in proposal.prismatic_joints else "rad/s",
            velocities=_velocities(part, j),
            friction=_friction(examination, k, j),
            covered=np.concatenate([smooth_part.v[:, j] for smooth_part in examination.parts]),
            loads=loads,
        )
        views.append(view)
    return views


def _line(name: str, x: Array, y: Array, stroke: Stroke) -> Line:
    step = -(-len(x) // _POINTS)
    return Line(name=name, x=x[::step], y=y[::step], stroke=stroke)


def _velocities(part: SmoothPart, j: int) -> Sequence[Line]:
    """Return the lines of a joint's velocity: logged, if it is, and from the position."""
    log = part.log
    stroke = Stroke(colour=SERIES[1], width=0.9)
    position_line = _line("from the position", part.t, part.v[:, j], stroke)
    if log.dq is None:
        return [position_line]
    return [_line("logged", log.t, log.dq[:, j], MEASURED), position_line]


def _friction(examination: Examination, k: int, j: int) -> Line | None:
    if not examination.torques or j not in examination.fits[k]:
        return None
    part = examination.parts[k]
    model_torques = examination.torques[k]
    fit = examination.fits[k][j]
    residual = part.tau[:, j].copy()
    # A scale without a finite error was not determined by this log.
    if np.isfinite(fit.gravity.error):
        residual -= fit.gravity.value * model_torques.gravity[:, j]
    if np.isfinite(fit.inertia.error):
        residual -= fit.inertia.value * model_torques.inertial[:, j]
    stroke = Stroke(colour=SERIES[0], width=0.6)
    return _line("friction", part.v[:, j], residual - residual.mean(), stroke)
