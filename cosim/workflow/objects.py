"""Methods of objects that need more than the models: files of FMUs, and figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hesr_model.support.files import PathArg

if TYPE_CHECKING:
    from cosim.report.figures.chart import Panel
    from hesr_model.friction.model import FrictionModel
    from hesr_model.logs.robot_log import Log
    from hesr_model.rigid_body.friction_record import FrictionRecord
    from hesr_model.support.arrays import Array


def write_fmu(model: FrictionModel, path: PathArg, **options: Any) -> Path:
    """Write a model as an FMU; `options` are those of `hesr.export`."""
    from cosim.workflow.export import export

    return export(model, path, **options)


def plot_friction(
    model: FrictionModel, records: Sequence[FrictionRecord], tau_predicted: Array
) -> Any:
    """Draw measured and predicted friction (N, n) [N.m]; return an axis for each joint."""
    from cosim.report.tables.table import title

    measured = np.column_stack([record.tau for record in records])
    signals = {"measured": measured, title(model.law): tau_predicted}
    return plot_torques(model.joints, model.slides, records[0].t, signals, "friction")


def plot_body(
    joints: Sequence[str], slides: Sequence[bool], t: Array, tau: Array, tau_body: Array
) -> Any:
    """Draw measured torque and that of the rigid body (N, n) [N.m]; return an axis per joint."""
    return plot_torques(joints, slides, t, {"measured": tau, "rigid body": tau_body}, "torque")


def plot_torques(
    joints: Sequence[str],
    slides: Sequence[bool],
    t: Array,
    signals: dict[str, Array],
    quantity: str,
) -> Any:
    """Draw torques (N, n) [N.m] by name over time; return an axis for each joint."""
    from cosim.report.figures.chart import Line, Panel
    from cosim.report.figures.style import MEASURED, strokes

    styles = strokes([name for name in signals if name != "measured"]) | {"measured": MEASURED}
    rows = []
    for j, joint in enumerate(joints):
        lines = tuple(
            Line(name=name, x=t, y=torque[:, j], stroke=styles[name])
            for name, torque in signals.items()
        )
        unit = "N" if slides[j] else "N.m"
        rows.append((Panel(title=joint, y=f"{quantity} [{unit}]", lines=lines),))
    return _draw(rows)[:, 0]


def plot_log(log: Log) -> Any:
    """Draw position, velocity and torque of a log; return axes (joints, 3)."""
    from cosim.report.figures.chart import Line, Panel
    from cosim.report.figures.style import MEASURED

    velocity = np.gradient(log.q, log.t, axis=0) if log.dq is None else log.dq
    columns = {"q [rad]": log.q, "dq [rad/s]": velocity, "tau [N.m]": log.tau}
    rows = []
    for j, joint in enumerate(log.joints):
        panels = []
        for label, values in columns.items():
            line = Line(name="measured", x=log.t, y=values[:, j], stroke=MEASURED)
            panels.append(Panel(title=joint, y=label, lines=(line,)))
        rows.append(tuple(panels))
    return _draw(rows)


def _draw(rows: Sequence[tuple[Panel, ...]]) -> Any:
    """Draw panels over time with pyplot, which shows them in a notebook; return the axes."""
    from cosim.report.figures.chart import Chart, draw_chart, show_figure

    figure = draw_chart(Chart(x="t [s]", rows=tuple(rows)), make_figure=show_figure)
    return np.reshape(np.array(figure.axes, dtype=object), (len(rows), len(rows[0])))
