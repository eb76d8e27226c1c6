"""Tables of the closed loop, and Tables II and III of the paper."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from cosim.loop.closed_loop import StandIn
from cosim.loop.traces import Following, LoopOutcome, Overcompensation, Tracked
from cosim.report.tables import table
from cosim.report.tables.table import ResultTable, make_row, number, title
from hesr_model.units import unit_of_joints

ROBOT = "uf850"

TABLE_II = {
    "lugre": (6.3703, 5.9744, 2.4627),
    "stribeck": (6.4110, 6.1804, 3.2741),
    "rbfnn_h": (5.1865, 7.7713, 2.3954),
    "parfam_v": (6.0660, 5.2261, 2.6997),
    "parfam_h": (4.2823, 5.1197, 1.9257),
}
"""RMSE of the predicted torque by law and joint [N.m]."""

TABLE_III = {
    StandIn.BODY_ONLY: (0.0417, 0.0744, 0.0324),
    "lugre": (0.0202, 0.0612, 0.0336),
    "rbfnn_h": (0.0204, 0.0477, 0.0267),
    "parfam_h": (0.0177, 0.0377, 0.0233),
}
"""RMSE of tracking by law and joint [rad]."""


def table_ii(joints: Sequence[str]) -> ResultTable:
    """Return Table II."""
    rows = []
    for law_name, errors in TABLE_II.items():
        cells = [number(error, 4) for error in errors]
        rows.append(make_row(title(law_name), *cells))
    return ResultTable(
        caption="Table II of the paper: RMSE of the predicted torque [N.m] on the measured robot",
        head=("law", *joints),
        rows=rows,
    )


def table_iii(joints: Sequence[str]) -> ResultTable:
    """Return Table III."""
    rows = []
    for law_name, errors in TABLE_III.items():
        cells = [mrad(error, 1) for error in errors]
        rows.append(make_row(title(law_name), *cells))
    return ResultTable(
        caption="Table III of the paper: RMSE of tracking [mrad] on the measured robot",
        head=("torque model", *joints),
        rows=rows,
    )


def outcome(loop_outcome: LoopOutcome) -> list[table.ResultTable]:
    """Return all tables of a closed loop."""
    tables = [tracking("Tracking: RMSE [mrad], mean over the motions", loop_outcome.tracking)]
    if loop_outcome.long:
        tables.append(tracking("One long motion: RMSE [mrad]", loop_outcome.long))
    tables += sweeps(loop_outcome.sweeps)
    if loop_outcome.overcompensation:
        tables.append(overcompensation(loop_outcome.overcompensation))
    return tables


def tracking(caption: str, rows: Sequence[Tracked]) -> table.ResultTable:
    """Return errors by scheme and law; notes are their spread, or the end of a single motion."""
    is_single = all(len(row.rmse) == 1 for row in rows)
    table_rows = []
    digits = places(rows)
    for scheme in dict.fromkeys(row.scheme for row in rows):
        table_rows.append(table.make_row(scheme.title))
        for row in rows:
            if row.scheme == scheme:
                notes = row.last[0] if is_single else row.spread
                cells = [mrad(*values) for values in zip(row.mean, digits, notes, strict=True)]
                table_rows.append(table.make_row(table.title(row.law), *cells))
    small = "spread over the motions"
    if is_single:
        small = "mean error of its last tenth"
    return table.ResultTable(
        caption=f"{caption}; small: {small}",
        head=("torque model", *table.joints(len(rows[0].mean))),
        rows=table_rows,
    )


def sweeps(rows: Sequence[Tracked]) -> list[table.ResultTable]:
    """Return a table per scheme: error of the worst joint by change and law."""
    tables = []
    for scheme in dict.fromkeys(replace(row.scheme, change="") for row in rows):
        worst_errors = {
            (row.scheme.change, row.law): row.mean.max()
            for row in rows
            if replace(row.scheme, change="") == scheme
        }
        laws = list(dict.fromkeys(law for _, law in worst_errors))
        table_rows = []
        for change in dict.fromkeys(change for change, _ in worst_errors):
            cells = [mrad(worst_errors[change, law], 2) for law in laws]
            table_rows.append(table.make_row(change, *cells))
        tables.append(
            table.ResultTable(
                caption=f"{scheme.title}: RMSE of the worst joint [mrad] under changes",
                head=("change", *map(table.title, laws)),
                rows=table_rows,
            )
        )
    return tables


def following(errors: Following, sliding: Sequence[bool]) -> table.ResultTable | None:
    """Return predicted following errors with half-widths of their intervals; None without any."""
    if not errors.rows:
        return None
    rows = []
    for row in errors.rows:
        cells = []
        for error, low, high in 1e3 * np.array([row.error, row.low, row.high]).T:
            interval = f"{table.format_significant(low, 2)} to {table.format_significant(high, 2)}"
            cells.append(table.number(error, 2, notes=(interval,)))
        rows.append(table.make_row(table.title(row.command), *cells))
    return table.ResultTable(
        caption=f"Following error on {errors.log}, RMS [m{unit_of_joints('rad', sliding)}]; small: "
        "interval",
        head=("command", *table.joints(len(errors.rows[0].error))),
        rows=rows,
    )


def benefit(following_errors: Following, sliding: Sequence[bool]) -> str:
    """Return how the recommended law reduces the following error where it does most, or why not."""
    if not following_errors.rows and not following_errors.missing:
        return ""
    if not following_errors.rows:
        return f"The following error was not predicted: {following_errors.missing}."
    first = following_errors.rows[0]
    last = following_errors.rows[-1]
    ratios = [new / old for new, old in zip(last.error, first.error, strict=True)]
    if min(ratios) >= 1.0:
        return "Feed-forward would not reduce the following error."
    k = int(np.argmin(ratios))
    unit = "m" if any(sliding[k : k + 1]) else "rad"
    errors = (first.error, last.error, last.low, last.high)
    old, new, low, high = (table.format_significant(1e3 * e[k], 2) for e in errors)
    return (
        f"Feed-forward of {table.title(last.command)} would reduce the following error on "
        f"{table.joints(k + 1)[k]} from {old} to {new} m{unit} ({low} to {high})."
    )


def overcompensation(overcompensations: Sequence[Overcompensation]) -> table.ResultTable:
    """Return the friction factor above which an arm at rest cycles."""
    rows = []
    for case in overcompensations:
        cell = table.TableCell(text="none up to 3")
        if case.factor is not None:
            cell = table.number(case.factor, 2)
        rows.append(table.make_row(f"{table.title(case.law)}: {case.scheme.title}", cell))
    return table.ResultTable(
        caption="Minimum factor on the friction torque at which the arm at rest begins to cycle",
        head=("law and scheme", "factor"),
        rows=rows,
    )


def mrad(angle: float, digits: int, note: float | None = None) -> table.TableCell:
    """Return the cell of an angle [rad] in mrad; "stopped" if the run failed."""
    if not np.isfinite(angle):
        return table.TableCell(text="stopped")
    notes = () if note is None else (f"{1e3 * note:.3g}",)
    return table.fixed_cell(1e3 * angle, digits, notes=notes)


def places(rows: Iterable[Tracked]) -> list[int]:
    """Return the decimals of each column of angles."""
    laws = [row.mean for row in rows if row.law != StandIn.ORACLE]
    return [table.decimals(1e3 * np.array(column), 2) for column in zip(*laws, strict=True)]
