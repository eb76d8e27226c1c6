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
    joint_count = len(model.joints)
    tau = _stack_joints(trace, "tau", joint_count)
    q = _stack_joints(trace, "q", joint_count)
    dq = _stack_joints(trace, "dq", joint_count)
    tau_load = _stack_joints(trace, "tau_rb", joint_count)
    unexplained = tau_load + model.predict(t=t, dq=dq, q=q, tau_load=tau_load) - tau
    numbers_by_joint = zip(*limits.numbers, strict=True)
    squares = []
    for j, (floor_size, slow_size, speed, *other_sizes) in enumerate(numbers_by_joint):
        sizes = np.array([floor_size, slow_size, *other_sizes])
        joint_shapes = np.stack(shapes(dq[:, j], tau_load[:, j], speed), axis=1)
        squares.append(joint_shapes @ sizes**2)
    half_widths = np.sqrt(low_pass_signals(t, np.stack(squares, axis=1), BANDWIDTH))
    return t, low_pass_signals(t, unexplained, BANDWIDTH), limits.factor * half_widths


def _stack_joints(trace: dict[str, Array], column: str, joint_count: int) -> Array:
    """Return the columns (N, n) of all joints, which are numbered from 1."""
    return np.stack([trace[f"{column}{j + 1}"] for j in range(joint_count)], axis=1)


def find_events(t: Array, external: Array, threshold: Array) -> list[tuple[int, int, int, int]]:
    """Return when external torques (N, n) exceed thresholds (N, n), by first row.

    Events are first and last row, joint from 0, and the row of the largest excess.
    """
    events = []
    excess = np.abs(external) / threshold
    for j, relative_excess in enumerate(excess.T):
        exceeding_rows = np.flatnonzero(relative_excess > 1.0)
        if not len(exceeding_rows):
            continue
        pauses = np.flatnonzero(np.diff(t[exceeding_rows]) > _MAX_PAUSE)
        for rows in np.split(exceeding_rows, pauses + 1):
            peak = rows[np.argmax(relative_excess[rows])]
            events.append((rows[0], rows[-1], j, peak))
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
            peak_torque = external[peak, j]
            peak_threshold = threshold[peak, j]
            row = make_row(
                log.name,
                results.joints[j],
                number(t[first], 3),
                number(t[last] - t[first], 3),
                number(peak_torque, 3),
                number(peak_threshold, 3),
            )
            rows.append(row)
            relative_excess = abs(peak_torque) / peak_threshold
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
    """Draw the external torque of each joint between its thresholds, (N, n) [N.m]."""
    curve = Stroke(colour=INK)
    edge = Stroke(colour=SERIES[1], dash=(4.0, 2.0))
    panels = []
    for joint_number, short_name, name in results.numbered:
        j = joint_number - 1
        lines = (
            Line(name="external", x=t, y=external[:, j], stroke=curve),
            Line(name="threshold", x=t, y=threshold[:, j], stroke=edge),
            Line(name="threshold", x=t, y=-threshold[:, j], stroke=edge),
        )
        title = f"{short_name}: {name}"
        panels.append(Panel(title=title, y=f"torque [{results.unit('N.m', j)}]", lines=lines))
    return Chart(x="t [s]", rows=tuple((panel,) for panel in panels), height=1.35)


EXTERNAL = Chapter("external", "External torque", external_torque, HERE / "templates")
