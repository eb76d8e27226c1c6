"""Answer and page of `hesr monitor` for the logs of one robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel, draw_chart
from cosim.report.figures.style import SERIES, Stroke
from cosim.report.markup import ResultFigure
from cosim.report.tables.table import ResultTable, make_row
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.adaptive.monitor import FollowedLogs
from hesr_model.findings import Finding
from hesr_model.support.arrays import Array
from hesr_model.support.text import count_noun
from hesr_model.support.typed_files import to_json

_MAX_LISTED_ALARMS = 12


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Monitoring(Answer, FollowedLogs):
    """Alarms and states over logs."""

    format = "hesr-monitoring-1"
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    def heading(self) -> str:
        """Return the robot and the number of logs."""
        return f"Friction of {self.model.robot} over {len(self.followed)} logs"

    def introduction(self) -> str:
        """Return the law that is adapted."""
        return f"Law: {self.model.law}."

    def summary(self) -> str:
        """Return the alarms and the last state of each joint."""
        alarm_count = len(self.alarms)
        lines = [f"{count_noun(alarm_count, 'change')} of friction found."]
        lines += [
            f"{alarm.log}, {alarm.joint}, {alarm.time:.1f} s: {alarm.change} than known "
            f"({alarm.kind}); likely cause: {alarm.points_to}"
            for alarm in self.alarms[:_MAX_LISTED_ALARMS]
        ]
        if alarm_count > _MAX_LISTED_ALARMS:
            lines.append(f"{alarm_count - _MAX_LISTED_ALARMS} more alarms: --verbose lists them.")
        for state in self.states[-len(self.model.joints) :]:
            level, viscosity, offset = state.intervals()
            lines.append(
                f"{state.joint}: level {level}, viscous factor {viscosity}, offset {offset}"
            )
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return alarms and states."""
        return [alarm_table(self), state_table(self)]

    def figures(self) -> Sequence[ResultFigure]:
        """Return the trends."""
        return draw_trends(self)

    def result(self) -> Any:
        """Return states and alarms."""
        return {
            "states": [to_json(state) for state in self.states],
            "alarms": [to_json(alarm) | {"points_to": alarm.points_to} for alarm in self.alarms],
        }


_TREND_SECTION = "Trends"
_TRENDS = {"level": "level", "viscosity": "viscous factor", "offset": "offset [N.m; N]"}


def alarm_table(followed_logs: FollowedLogs) -> ResultTable:
    """Return the alarms."""
    rows = [
        make_row(
            f"{alarm.log}: {alarm.joint}",
            f"{alarm.time:.1f}",
            alarm.kind,
            alarm.change,
            alarm.points_to,
        )
        for alarm in followed_logs.alarms
    ]
    head = ("log: joint", "time in s", "alarm", "torque", "points to")
    return ResultTable(caption="Changes of friction", head=head, rows=rows, section="Alarms")


def draw_trends(followed_logs: FollowedLogs) -> list[ResultFigure]:
    """Draw level, viscous factor and offset over all logs, a figure for each joint."""
    durations = [
        float(np.ptp(log_estimates[0].record.t)) for log_estimates in followed_logs.followed
    ]
    starts = np.concatenate([[0.0], np.cumsum(durations)[:-1]])
    names = [log_estimates[0].record.log for log_estimates in followed_logs.followed]
    marks = tuple(zip(starts.tolist(), names, strict=True))
    figures = []
    for j, joint in enumerate(followed_logs.model.joints):
        joint_estimates = [log_estimates[j] for log_estimates in followed_logs.followed]
        times = []
        for start, estimates in zip(starts, joint_estimates, strict=True):
            times.append(start + estimates.record.t - estimates.record.t[0])
        t = np.concatenate(times)
        panels: list[Panel] = []
        for name, title in _TRENDS.items():
            values = np.concatenate([estimates.outputs[name] for estimates in joint_estimates])
            deviation = np.concatenate(
                [estimates.outputs[f"{name}_sd"] for estimates in joint_estimates]
            )
            lines = _trend_lines(t, values, 2.0 * deviation)
            panel_marks: tuple[tuple[float, str], ...] = ()
            if not panels:  # the names of the logs stand above all panels
                panel_marks = marks
            panels.append(Panel(title=title, y="", lines=lines, marks=panel_marks))
        rows = tuple((panel,) for panel in panels)
        chart = Chart(x="t [s] over all logs", rows=rows, height=1.2)
        figures.append(
            ResultFigure(
                section=_TREND_SECTION,
                key=f"trend-{j + 1}",
                drawing=draw_chart(chart),
                caption=f"Joint {joint}: factors on its Coulomb and viscous friction, and its "
                "offset.",
                alt=f"Level, viscous factor and offset of {joint} over time, with bands.",
            )
        )
    return figures


def _trend_lines(t: Array, values: Array, half_width: Array) -> tuple[Line, ...]:
    """Return followed values (N,) and both edges of their band."""
    edge = Stroke(colour=SERIES[1], width=0.7, dash=(3.0, 2.0))
    return (
        Line(name="followed", x=t, y=values, stroke=Stroke(colour=SERIES[0])),
        Line(name="two standard deviations", x=t, y=values - half_width, stroke=edge),
        Line(name="two standard deviations", x=t, y=values + half_width, stroke=edge),
    )


def state_table(followed_logs: FollowedLogs) -> ResultTable:
    """Return the states after each log."""
    rows = [
        make_row(
            f"{state.log}: {state.joint}",
            *state.intervals(),
            f"{state.rmse_fixed:.3g}",
            f"{state.rmse:.3g}",
            f"{100 * state.learning:.0f}",
        )
        for state in followed_logs.states
    ]
    factors = ("level", "viscous factor", "offset")
    head = ("log: joint", *factors, "error of the law", "followed", "learning in %")
    caption = "After each log: factors with two standard deviations, and errors (RMSE) in N.m, or N"
    return ResultTable(caption=caption, head=head, rows=rows, section=_TREND_SECTION)
