"""Chapter of a run's report: external torque in its logs, if there is any."""

from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import INK, SERIES, Stroke
from cosim.report.page import Chapter
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, make_row, number
from hesr.extras.observer.observer_fmu import BANDWIDTH, HERE, ObserverLimits, law_limits
from hesr_model.equations.low_pass import low_pass_signals
from hesr_model.errors import ArgumentError
from hesr_model.friction.band import shapes
from hesr_model.friction.model import FrictionModel, mix_models
from hesr_model.support.arrays import Array

_MAX_PAUSE = 0.3  # [s] within an event
_MAX_TABLE_ROWS = 30


def _estimate_external(
    trace: dict[str, Array], model: FrictionModel, limits: ObserverLimits
) -> tuple[Array, Array, Array]:
    """Return time, unexplained torques behind the observer's low pass, and thresholds, (N, n)."""
    t = trace["t"].astype(float)
    numbers = range(1, len(model.joints) + 1)
    names = ("tau", "q", "dq", "tau_rb")
    tau, q, dq, tau_load = (
        np.stack([trace[f"{column}{number}"] for number in numbers], axis=1) for column in names
    )
    unexplained = tau_load + model.predict(t=t, dq=dq, q=q, tau_load=tau_load) - tau
    squares = []
    for j, (floor_size, slow_size, speed, *other_sizes) in enumerate(
        zip(*limits.numbers, strict=True)
    ):
        sizes = np.array([floor_size, slow_size, *other_sizes])
        squares.append(np.stack(shapes(dq[:, j], tau_load[:, j], speed), axis=1) @ sizes**2)
    half_widths = np.sqrt(low_pass_signals(t, np.stack(squares, axis=1), BANDWIDTH))
    return t, low_pass_signals(t, unexplained, BANDWIDTH), limits.factor * half_widths


def find_events(t: Array, external: Array, threshold: Array) -> list[tuple[int, int, int, int]]:
    """Return when external torques (N, n) exceed thresholds (N, n), by first row.

    Events are first and last row, joint from 0, and the row of the largest excess.
    """
    events = []
    excess = np.abs(external) / threshold
    for j, relative_excess in enumerate(excess.T):
        exceeding_rows = np.flatnonzero(relative_excess > 1.0)
        groups = np.split(
            exceeding_rows, np.flatnonzero(np.diff(t[exceeding_rows]) > _MAX_PAUSE) + 1
        )
        events += [
            (rows[0], rows[-1], j, rows[np.argmax(relative_excess[rows])])
            for rows in groups
            if len(rows)
        ]
    return sorted(events)


def external_torque(results: Results) -> dict[str, Any] | None:
    """Return the events in saved torques under the recommended laws; None without any."""
    model = mix_models([results.models[law_name] for law_name in results.recommended])
    try:
        limits = law_limits(model)
    except ArgumentError:
        return None
    rows = []
    largest_excess = 0.0
    worst_log = None
    for log in filter(lambda log: log.trace, results.run.logs):
        t, external, threshold = _estimate_external(results.torques(log), model, limits)
        for first, last, j, peak in find_events(t, external, threshold):
            values = (t[first], t[last] - t[first], external[peak, j], threshold[peak, j])
            rows.append(make_row(log.name, results.joints[j], *(number(x, 3) for x in values)))
            relative_excess = abs(values[2]) / values[3]
            if relative_excess > largest_excess:
                largest_excess = relative_excess
                worst_log = (log.name, t, external, threshold)
    if worst_log is None:
        return None
    name, *curves = worst_log
    unit = results.unit("N.m")
    table = ResultTable(
        caption="External torque beyond the threshold",
        words=(1,),
        head=("log", "joint", "at [s]", "for [s]", f"largest [{unit}]", f"threshold [{unit}]"),
        rows=rows[:_MAX_TABLE_ROWS],
    )
    return {
        "events": table,
        "count": len(rows),
        "log": name,
        "torques": _build_chart(results, *curves),
    }


def _build_chart(results: Results, t: Array, external: Array, threshold: Array) -> Chart:
    edge = Stroke(colour=SERIES[1], dash=(4.0, 2.0))
    lines = [("external", external, Stroke(colour=INK))]
    lines += [("threshold", sign * threshold, edge) for sign in (1.0, -1.0)]
    panels = [
        Panel(
            title=f"{short_name}: {name}",
            y=f"torque [{results.unit('N.m', number - 1)}]",
            lines=tuple(
                Line(name=label, x=t, y=y[:, number - 1], stroke=stroke)
                for label, y, stroke in lines
            ),
        )
        for number, short_name, name in results.numbered
    ]
    return Chart(x="t [s]", rows=tuple((panel,) for panel in panels), height=1.35)


EXTERNAL = Chapter("external", "External torque", external_torque, HERE / "templates")
