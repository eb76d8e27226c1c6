"""Tables of the closed loop."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosim.loop.closed_loop import StandIn
from cosim.report.tables.table import (
    ResultTable,
    TableCell,
    decimals,
    fixed,
    joints,
    named,
    number,
    row_of,
    title,
)

if TYPE_CHECKING:  # studies load MuJoCo, which a report does not need
    from cosim.loop.robustness import Overcompensation
    from cosim.loop.run import LoopOutcome
    from cosim.loop.tracking import Tracked


def outcome(found: "LoopOutcome") -> list[ResultTable]:
    """Return all tables of a closed loop."""
    return [
        tracking("Tracking: RMSE [mrad], mean over the motions", found.tracking),
        tracking("One long motion: RMSE [mrad]", found.long),
        *sweeps(found.sweeps),
        overcompensation(found.overcompensation),
    ]


def tracking(caption: str, rows: "Sequence[Tracked]") -> ResultTable:
    """Return the errors of rows by scheme: beside their spread or, of one motion, its end."""
    one = all(len(row.rmse) == 1 for row in rows)
    table_rows, digits = [], places(rows)
    for scheme in dict.fromkeys(row.scheme for row in rows):
        table_rows.append(row_of(scheme.title))
        for row in rows:
            if row.scheme == scheme:
                beside = row.last[0] if one else row.spread
                cells = [mrad(*part) for part in zip(row.mean, digits, beside, strict=True)]
                table_rows.append(row_of(named(row.law), *cells))
    small = "mean error of its last tenth" if one else "spread over the motions"
    return ResultTable(
        caption=f"{caption}; small: {small}",
        head=("torque model", *joints(len(rows[0].mean))),
        rows=table_rows,
    )


def sweeps(rows: "Sequence[Tracked]") -> list[ResultTable]:
    """Return one table for each scheme: changes by laws, the error of the worst joint."""
    tables = []
    for scheme in dict.fromkeys(replace(row.scheme, change="") for row in rows):
        found = {
            (row.scheme.change, row.law): row.mean.max()
            for row in rows
            if replace(row.scheme, change="") == scheme
        }
        laws = list(dict.fromkeys(law for _, law in found))
        tables.append(
            ResultTable(
                caption=f"{scheme.title}: RMSE of the worst joint [mrad] under changes",
                head=("change", *map(named, laws)),
                rows=[
                    row_of(change, *(mrad(found[change, law], 2) for law in laws))
                    for change in dict.fromkeys(change for change, _ in found)
                ],
            )
        )
    return tables


def overcompensation(found: "Sequence[Overcompensation]") -> ResultTable:
    """Return from which factor on friction an arm at rest begins to cycle."""
    return ResultTable(
        caption="Factor on the friction torque from which the arm at rest begins to cycle",
        head=("law and scheme", "factor"),
        rows=[
            row_of(
                f"{title(one.law)}: {one.scheme.title}",
                TableCell(text="none up to 3") if one.factor is None else number(one.factor, 2),
            )
            for one in found
        ],
    )


def mrad(
    angle: float, digits: int, beside: float | None = None, *, best: bool = False
) -> TableCell:
    """Return the cell of an angle [rad] in mrad; a run that failed has none."""
    if not np.isfinite(angle):
        return TableCell(text="stopped")
    notes = () if beside is None else (f"{1e3 * beside:.3g}",)
    return fixed(1e3 * angle, digits, best=best, notes=notes)


def places(rows: "Iterable[Tracked]") -> list[int]:
    """Return the decimals of each column of angles."""
    laws = [row.mean for row in rows if row.law != StandIn.ORACLE]
    return [decimals(1e3 * np.array(column), 2) for column in zip(*laws, strict=True)]
