"""Page of `hesr inspect`: contents of logs by joint, and findings."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.figures.chart import Line
from cosim.report.figures.motions import JointView, joints, picture
from cosim.report.figures.style import MEASURED, SERIES, Stroke, write_svg
from cosim.report.markup import Pictures, Section, render, table, write_sections
from cosim.report.tables.laws import robot_tables
from cosim.report.tables.table import ResultTable, row_of
from hesr_model.health.evidence import Motionwise
from hesr_model.health.examine import Examination, unseen
from hesr_model.health.proposal import HEAD, Proposal, robot_file, summary_rows
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_POINTS = 700  # maximum number of points of a line


def write_inspection(path: Path, proposal: Proposal) -> None:
    """Write the page, or only its figure if the suffix is ``.svg``."""
    robot = Robot(proposal.robot) if proposal.robot.model.is_file() else None
    if path.suffix.lower() == ".svg":
        alone = robot if not proposal.logs else None
        write_svg(picture(alone) if alone else joints(_views(proposal)), path)
        return
    values = _values(proposal, path)
    if robot:
        values |= {"tables": robot_tables(robot), "arm": picture(robot)}
    subject = "logs of" if proposal.logs else "robot"
    of_logs = {
        "joints": "Joints",
        "pictures": "Motion and torque",
        "unseen": "What this log cannot show",
    }
    titles = {
        **({"arm": "Robot"} if robot else {}),
        **(of_logs if proposal.logs else {}),
        "robot": "Proposed robot file",
    }
    parts = {part: render("sections/inspection.html.j2", part=part, **values) for part in titles}
    write_sections(
        path,
        title=f"HESR: {subject} {proposal.robot.name}",
        heading=f"{subject.capitalize()} {proposal.robot.name}",
        summary=render("sections/inspection.html.j2", part="summary", **values),
        sections=[Section(key=key, title=titles[key], html=html) for key, html in parts.items()],
    )


def _values(proposal: Proposal, path: Path) -> dict[str, Any]:
    views = _views(proposal)
    gaps: dict[str, list[str]] = {}
    for joint, gap in unseen(proposal.examination, proposal.robot.joints):
        gaps.setdefault(gap, []).append(joint)
    return {
        "first": proposal.first,
        "after": proposal.examination.findings,
        "errors": sum(finding.severity == "error" for finding in proposal.first),
        "mended": bool(proposal.reasons),
        "logs": _logs(proposal),
        "joints": _joints(proposal),
        "table": table,
        "figure": Pictures(folder=path.parent).shown,
        "picture": joints(views) if views else None,
        "log": _longest(proposal)[1].log.name if views else "",
        "usable": bool(proposal.examination.parts),
        "gaps": gaps,
        "file": robot_file(proposal, path) if proposal.robot.model.is_file() else "",
    }


def _logs(proposal: Proposal) -> ResultTable:
    rows = []
    for log in proposal.logs:
        numbers = (f"{log.t[-1] - log.t[0]:.1f}", f"{log.rate:.4g}", f"{100 * log.jitter:.0f}")
        gaps = str(len(log.gaps))
        dropped = str(log.dropped)
        rows.append(row_of(log.name, str(len(log.t)), *numbers, gaps, dropped))
    head = ("log", "rows", "length in s", "rate in Hz", "jitter in %", "gaps", "rows left out")
    return ResultTable(caption="Logs", head=head, rows=rows)


def _joints(proposal: Proposal) -> ResultTable:
    rows = [row_of(f"{log}: {joint}", *cells) for log, joint, *cells in summary_rows(proposal)]
    caption = (
        "Moving joints with the proposed robot file. ‘dq slope’: velocity from the position over "
        "the logged one; ‘gravity / model’: measured over modelled gravity torque; ‘friction’: "
        "torque in phase with the velocity in N.m, and in standard errors"
    )
    return ResultTable(caption=caption, head=("log: joint", *HEAD[2:]), rows=rows)


def _longest(proposal: Proposal) -> tuple[int, Motionwise]:
    return max(enumerate(proposal.examination.parts), key=lambda part: np.ptp(part[1].t))


def _views(proposal: Proposal) -> list[JointView]:
    examination = proposal.examination
    if not examination.parts:
        return []
    k, part = _longest(proposal)
    return [
        JointView(
            name=proposal.robot.joints[j],
            # Without a model joints count as revolute.
            unit="m/s" if j in proposal.sliding else "rad/s",
            velocities=_velocities(part, int(j)),
            friction=_friction(examination, k, int(j)),
            covered=np.concatenate([each.v[:, j] for each in examination.parts]),
            loads=np.concatenate([torques.gravity[:, j] for torques in examination.torques])
            if examination.torques
            else None,
        )
        for j in np.flatnonzero(part.moves)
    ]


def _line(name: str, x: Array, y: Array, stroke: Stroke) -> Line:
    step = -(-len(x) // _POINTS)
    return Line(name=name, x=x[::step], y=y[::step], stroke=stroke)


def _velocities(part: Motionwise, j: int) -> Sequence[Line]:
    raw = part.log
    own = _line("from the position", part.t, part.v[:, j], Stroke(colour=SERIES[1], width=0.9))
    return (own,) if raw.dq is None else (_line("logged", raw.t, raw.dq[:, j], MEASURED), own)


def _friction(examination: Examination, k: int, j: int) -> Line | None:
    if not examination.torques or j not in examination.explained[k]:
        return None
    part = examination.parts[k]
    of_model = examination.torques[k]
    fit = examination.explained[k][j]
    left = part.tau[:, j].copy()
    for estimate, torque in ((fit.gravity, of_model.gravity), (fit.inertia, of_model.inertial)):
        if np.isfinite(estimate.error):
            left -= estimate.value * torque[:, j]
    return _line("friction", part.v[:, j], left - left.mean(), Stroke(colour=SERIES[0], width=0.6))
