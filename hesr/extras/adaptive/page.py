"""Answer and page of `hesr monitor` for the logs of one robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from cosim.report.figures.chart import Chart, Line, Panel, drawn
from cosim.report.figures.style import SERIES, Stroke
from cosim.report.markup import Pictures, Section, joined, paragraph, table, write_sections
from cosim.report.tables.table import ResultTable, row_of
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.adaptive.monitor import FollowedLogs
from hesr_model.findings import Finding
from hesr_model.support.typed_files import to_json

_MOST_ALARMS = 12


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Monitoring(Answer, FollowedLogs):
    """Alarms and states over logs."""

    format = "hesr-monitoring-1"
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the alarms and the last state of each joint."""
        count = len(self.alarms)
        lines = [f"{count} change{'s' * (count != 1)} of friction found."]
        lines += [
            f"{one.log}, {one.joint}, {one.time:.1f} s: {one.change} than known ({one.kind}); "
            f"likely cause: {one.points_to}"
            for one in self.alarms[:_MOST_ALARMS]
        ]
        if count > _MOST_ALARMS:
            lines.append(f"{count - _MOST_ALARMS} more alarms: --verbose lists them.")
        for one in self.states[-len(self.model.joints) :]:
            level, viscosity, offset = one.intervals()
            lines.append(f"{one.joint}: level {level}, viscous factor {viscosity}, offset {offset}")
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return alarms and states."""
        return [alarm_table(self), state_table(self)]

    def result(self) -> Any:
        """Return states and alarms."""
        return {
            "states": [to_json(one) for one in self.states],
            "alarms": [to_json(one) | {"points_to": one.points_to} for one in self.alarms],
        }


_TRENDS = {"level": "level", "viscosity": "viscous factor", "offset": "offset [N.m; N]"}


def write_monitor(path: Path, watched: FollowedLogs) -> None:
    """Write the page."""
    pictures = Pictures(folder=path.parent)  # figures are embedded
    count = len(watched.alarms)
    alarms = table(alarm_table(watched)) if count else paragraph("None.")
    said = f"{count} change{'s' if count != 1 else ''} found." if count else "No change was found."
    robot = watched.model.robot
    write_sections(
        path,
        title=f"HESR: friction of {robot}",
        heading=f"Friction of {robot} over {len(watched.followed)} logs",
        summary=paragraph(f"{said} Law: {watched.model.law}."),
        sections=[
            Section(key="alarms", title="Alarms", html=alarms),
            Section(key="trends", title="Trends", html=_trends(watched, pictures)),
            Section(key="states", title="After each log", html=table(state_table(watched))),
        ],
    )


def alarm_table(watched: FollowedLogs) -> ResultTable:
    """Return the alarms."""
    rows = [
        row_of(f"{a.log}: {a.joint}", f"{a.time:.1f}", a.kind, a.change, a.points_to)
        for a in watched.alarms
    ]
    head = ("log: joint", "time in s", "alarm", "torque", "points to")
    return ResultTable(caption="Changes of friction", head=head, rows=rows)


def _trends(watched: FollowedLogs, pictures: Pictures) -> Markup:
    ends = np.cumsum([float(np.ptp(log[0].record.t)) for log in watched.followed])
    begins = np.concatenate([[0.0], ends[:-1]])
    names = (log[0].record.log for log in watched.followed)
    marks = tuple(zip(begins.tolist(), names, strict=True))
    drawings = []
    for j, joint in enumerate(watched.model.joints):
        logs = [log[j] for log in watched.followed]
        times = (at + one.record.t - one.record.t[0] for at, one in zip(begins, logs, strict=True))
        t = np.concatenate(list(times))
        rows: list[tuple[Panel, ...]] = []
        for name, title in _TRENDS.items():
            value, sd = (
                np.concatenate([one.outputs[key] for one in logs]) for key in (name, f"{name}_sd")
            )
            edge = Stroke(colour=SERIES[1], width=0.7, dash=(3.0, 2.0))
            lines = (
                Line(name="followed", x=t, y=value, stroke=Stroke(colour=SERIES[0])),
                Line(name="two standard deviations", x=t, y=value - 2.0 * sd, stroke=edge),
                Line(name="two standard deviations", x=t, y=value + 2.0 * sd, stroke=edge),
            )
            rows.append((Panel(title=title, y="", lines=lines, marks=marks if not rows else ()),))
        chart = Chart(x="t [s] over all logs", rows=tuple(rows), height=1.2)
        text = f"Joint {joint}: factors on its Coulomb and viscous friction, and its offset."
        alt = f"Level, viscous factor and offset of {joint} over time, with bands."
        drawings.append(pictures.shown(f"trend-{j + 1}", drawn(chart), text, alt=alt))
    return joined(*drawings)


def state_table(watched: FollowedLogs) -> ResultTable:
    """Return the states after each log."""
    rows = [
        row_of(
            f"{s.log}: {s.joint}",
            *s.intervals(),
            f"{s.rmse_fixed:.3g}",
            f"{s.rmse:.3g}",
            f"{100 * s.learning:.0f}",
        )
        for s in watched.states
    ]
    factors = ("level", "viscous factor", "offset")
    head = ("log: joint", *factors, "error of the law", "followed", "learning in %")
    caption = "Factors with two standard deviations, and errors (RMSE) in N.m, or N"
    return ResultTable(caption=caption, head=head, rows=rows)
