"""The page of `hesr inspect`: what logs are like, joint by joint, and what is wrong or odd."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from markupsafe import Markup

from cosim.report.figures.chart import Line
from cosim.report.figures.motions import JointView, joints
from cosim.report.figures.style import MEASURED, SERIES, Stroke, write_svg
from cosim.report.markup import Pictures, Section, joined, listing, paragraph, table, write_sections
from cosim.report.tables.table import ResultTable, row_of
from hesr_model.findings import Finding
from hesr_model.health.evidence import Motionwise
from hesr_model.health.examine import Examination
from hesr_model.health.excitation_gaps import unseen
from hesr_model.health.proposal import HEAD, Proposal, robot_file, summary_rows
from hesr_model.support.arrays import Array

_POINTS = 700
"""Of a line; more are not seen."""


def write_inspection(path: Path, proposal: Proposal) -> None:
    """Write the page, or its picture alone where the path ends in ``.svg``.

    Raises
    ------
    ArtifactError
        If it cannot be written.
    """
    if path.suffix.lower() == ".svg":
        write_svg(joints(_views(proposal)), path)
        return
    pictures = Pictures(folder=path.parent)  # its figures stand in the page only
    sections = [
        Section(key="joints", title="Joints", html=_joints(proposal)),
        Section(key="pictures", title="Motion and torque", html=_drawn(proposal, pictures)),
        Section(key="unseen", title="What the motion does not tell", html=_unseen(proposal)),
        Section(key="robot", title="Proposed robot file", html=_file(proposal, path)),
    ]
    write_sections(
        path,
        title=f"HESR: logs of {proposal.robot.name}",
        heading=f"Logs of {proposal.robot.name}",
        summary=_summary(proposal),
        sections=sections,
    )


def _summary(proposal: Proposal) -> Markup:
    first = proposal.first
    after = proposal.examination.findings
    refused = sum(f.severity == "error" for f in first)
    said = (
        f"Cannot be right: {refused}. Odd: {len(first) - refused}."
        if first
        else "Nothing wrong or odd was found."
    )
    parts = [paragraph(said), _listed(first)]
    if first and proposal.reasons:
        left = "what is left is" if after else "nothing of it is left."
        parts += [paragraph(f"With the robot file that is proposed below {left}"), _listed(after)]
    rows = [
        row_of(
            log.name, str(len(log.t)), f"{log.t[-1] - log.t[0]:.1f}", f"{log.rate:.4g}",
            f"{100 * log.jitter:.0f}", str(len(log.gaps)), str(log.dropped),
        )
        for log in proposal.logs
    ]  # fmt: skip
    head = ("log", "rows", "length in s", "rate in Hz", "jitter in %", "gaps", "rows left out")
    return joined(*parts, table(ResultTable(caption="Logs", head=head, rows=rows)))


def _listed(findings: Sequence[Finding]) -> Markup:
    items = [
        Markup('<strong class="{}">{}.</strong> {}').format(
            "fail" if f.severity == "error" else "pass",
            "Wrong" if f.severity == "error" else "Odd",
            f.sentence,
        )
        for f in findings
    ]
    return listing(items) if items else Markup()


def _joints(proposal: Proposal) -> Markup:
    rows = [row_of(f"{log}: {joint}", *cells) for log, joint, *cells in summary_rows(proposal)]
    caption = (
        "Joints that move, with the proposed robot file: ‘dq slope’ is velocity from the position "
        "over the logged one, ‘gravity / model’ the measured gravity torque over that of the "
        "model, ‘friction’ the torque that goes with the velocity, in N.m, and how many standard "
        "errors it is from zero"
    )
    return table(ResultTable(caption=caption, head=("log: joint", *HEAD[2:]), rows=rows))


def _drawn(proposal: Proposal, pictures: Pictures) -> Markup:
    """Draw the longest part of the logs, and what all of them cover."""
    if not proposal.examination.parts:
        return paragraph("The stamps do not allow a picture.")
    if not (views := _views(proposal)):
        return paragraph("No joint moves.")
    return pictures.shown(
        "joints", joints(views),
        f"Log {_longest(proposal)[1].log.name}, joint by joint: velocity as logged and as it "
        "follows from the smoothed position; torque that the model does not explain over velocity, "
        "which is friction and rises from left to right; and how many rows of all logs there are "
        "at each velocity and at each gravity torque of the model, since friction is learned only "
        "where there are rows.",
        alt="For each joint velocity over time, friction over velocity, and two histograms.",
    )  # fmt: skip


def _longest(proposal: Proposal) -> tuple[int, Motionwise]:
    """Return the place and the longest of the parts of logs."""
    return max(enumerate(proposal.examination.parts), key=lambda part: np.ptp(part[1].t))


def _views(proposal: Proposal) -> list[JointView]:
    examination = proposal.examination
    if not examination.parts:
        return []
    k, part = _longest(proposal)
    return [
        JointView(
            name=proposal.robot.joints[j],
            # Without a model it is not known whether it slides.
            unit="m/s" if j in proposal.sliding else "rad/s",
            velocities=_velocities(part, int(j)),
            friction=_friction(examination, k, int(j)),
            covered=np.concatenate([each.v[:, j] for each in examination.parts]),
            loads=_loads(examination, int(j)),
        )
        for j in np.flatnonzero(part.moves)
    ]


def _loads(examination: Examination, j: int) -> Array | None:
    """Torque (N,) of the model's gravity at all rows, beside its mean; None without a model."""
    if not examination.torques:
        return None
    return np.concatenate([torques.gravity[:, j] for torques in examination.torques])


def _velocities(part: Motionwise, j: int) -> tuple[Line, ...]:
    raw = part.log
    step, of_raw = -(-len(part.t) // _POINTS), -(-len(raw.t) // _POINTS)
    own = Line(
        name="from the position", x=part.t[::step], y=part.v[::step, j],
        stroke=Stroke(colour=SERIES[1], width=0.9),
    )  # fmt: skip
    if raw.dq is None:
        return (own,)
    logged = Line(name="logged", x=raw.t[::of_raw], y=raw.dq[::of_raw, j], stroke=MEASURED)
    return (logged, own)


def _friction(examination: Examination, k: int, j: int) -> Line | None:
    if not examination.torques or j not in examination.explained[k]:
        return None
    part, of_model, fit = examination.parts[k], examination.torques[k], examination.explained[k][j]
    left = part.tau[:, j].copy()
    for estimate, torque in ((fit.gravity, of_model.gravity), (fit.inertia, of_model.inertial)):
        if np.isfinite(estimate.error):
            left -= estimate.value * torque[:, j]
    step = -(-len(left) // _POINTS)
    return Line(
        name="friction", x=part.v[::step, j], y=(left - left.mean())[::step],
        stroke=Stroke(colour=SERIES[0], width=0.6),
    )  # fmt: skip


def _unseen(proposal: Proposal) -> Markup:
    """List what no fit can learn from these logs, for want of motion."""
    by_word: dict[str, list[str]] = {}
    for joint, what in unseen(proposal.examination, proposal.robot.joints):
        by_word.setdefault(what, []).append(joint)
    if not by_word:
        return paragraph("The logs hold rests, reversals, slow motion and loads of every joint.")
    return listing(
        Markup("<strong>{}:</strong> {}.").format(", ".join(names), what)
        for what, names in by_word.items()
    )


def _file(proposal: Proposal, path: Path) -> Markup:
    if not proposal.robot.model.is_file():
        return paragraph("Without the robot's model (--robot) there is no robot file to propose.")
    return Markup('<pre style="white-space: pre-wrap">{}</pre>').format(robot_file(proposal, path))
