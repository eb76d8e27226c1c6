"""Chapter of a run's report: external torque in its logs, if there is any."""

from typing import Any

import numpy as np

from cosim.report.figures.chart import Chart, Line, Panel
from cosim.report.figures.style import INK, SERIES, Stroke
from cosim.report.page import Chapter
from cosim.report.results import Results
from cosim.report.tables.table import ResultTable, number, row_of
from hesr.extras.observer.observer_fmu import BANDWIDTH, HERE, ObserverLimits, law_limits
from hesr_model.equations.low_pass import low_pass_signals
from hesr_model.errors import ExportError
from hesr_model.friction.band import shapes
from hesr_model.friction.model import FrictionModel, mixed
from hesr_model.support.arrays import Array

_APART = 0.3  # shorter pauses within an event [s]
_MOST = 30  # rows of the table


def _external(
    trace: dict[str, Array], model: FrictionModel, limits: ObserverLimits
) -> tuple[Array, Array, Array]:
    """Return time, unexplained torques behind the observer's low pass, and thresholds, (N, n)."""
    t = trace["t"].astype(float)
    each = range(1, len(model.joints) + 1)
    columns = ("tau", "q", "dq", "tau_rb")
    tau, q, dq, load = (np.stack([trace[f"{c}{k}"] for k in each], axis=1) for c in columns)
    rest = load + model.predict(t=t, dq=dq, q=q, tau_load=load) - tau
    squares = []
    for j, (floor, slow, speed, *others) in enumerate(zip(*limits.numbers, strict=True)):
        sizes = np.array([floor, slow, *others])
        squares.append(np.stack(shapes(dq[:, j], load[:, j], speed), axis=1) @ sizes**2)
    half = np.sqrt(low_pass_signals(t, np.stack(squares, axis=1), BANDWIDTH))
    return t, low_pass_signals(t, rest, BANDWIDTH), limits.factor * half


def events_of(t: Array, external: Array, threshold: Array) -> list[tuple[int, int, int, int]]:
    """Return when external torques (N, n) exceed thresholds (N, n), by first row.

    Events are first and last row, joint from 0, and the row of the largest excess.
    """
    found = []
    excess = np.abs(external) / threshold
    for j, size in enumerate(excess.T):
        beyond = np.flatnonzero(size > 1.0)
        each = np.split(beyond, np.flatnonzero(np.diff(t[beyond]) > _APART) + 1)
        found += [(r[0], r[-1], j, r[np.argmax(size[r])]) for r in each if len(r)]
    return sorted(found)


def external_torque(results: Results) -> dict[str, Any] | None:
    """Return the events in saved torques under the recommended laws; None without any."""
    model = mixed([results.models[law] for law in results.recommended])
    try:
        limits = law_limits(model)
    except ExportError:
        return None
    rows = []
    largest = 0.0
    shown = None
    for log in filter(lambda log: log.trace, results.run.logs):
        t, external, threshold = _external(results.torques(log), model, limits)
        for first, last, j, peak in events_of(t, external, threshold):
            values = (t[first], t[last] - t[first], external[peak, j], threshold[peak, j])
            rows.append(row_of(log.name, results.joints[j], *(number(x, 3) for x in values)))
            size = abs(values[2]) / values[3]
            if size > largest:
                largest = size
                shown = (log.name, t, external, threshold)
    if shown is None:
        return None
    name, *curves = shown
    unit = results.unit("N.m")
    table = ResultTable(
        caption="External torque beyond the threshold",
        words=(1,),
        head=("log", "joint", "at [s]", "for [s]", f"largest [{unit}]", f"threshold [{unit}]"),
        rows=rows[:_MOST],
    )
    return {"events": table, "count": len(rows), "log": name, "torques": _chart(results, *curves)}


def _chart(results: Results, t: Array, external: Array, threshold: Array) -> Chart:
    edge = Stroke(colour=SERIES[1], dash=(4.0, 2.0))
    lines = [("external", external, Stroke(colour=INK))]
    lines += [("threshold", sign * threshold, edge) for sign in (1.0, -1.0)]
    panels = [
        Panel(
            title=f"{short}: {name}",
            y=f"torque [{results.unit('N.m', k - 1)}]",
            lines=tuple(Line(name=of, x=t, y=y[:, k - 1], stroke=own) for of, y, own in lines),
        )
        for k, short, name in results.numbered
    ]
    return Chart(x="t [s]", rows=tuple((panel,) for panel in panels), height=1.35)


EXTERNAL = Chapter("external", "External torque", external_torque, HERE / "templates")
