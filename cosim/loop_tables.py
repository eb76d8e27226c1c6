"""Tables of the closed loop for the terminal."""

from collections.abc import Sequence

import numpy as np
from rich import box
from rich.markup import escape
from rich.table import Table

from cosim.studies.robustness import Overcompensation
from cosim.studies.tracking import Tracked
from cosim.studies.whole_loop import LoopOutcome
from cosim.tables import title

_SIDE_BY_SIDE = 4  # joints whose errors and spreads fit side by side into 80 columns


def outcome(found: LoopOutcome) -> list[Table]:
    """Return all tables of a closed loop."""
    return [
        tracking("Tracking: RMSE [mrad], mean (spread) over motions", found.tables),
        tracking("One long motion: RMSE [mrad] (mean error of its last tenth)", found.long),
        *sweeps(found.sweeps),
        overcompensation(found.overcompensation),
    ]


def tracking(heading: str, rows: Sequence[Tracked]) -> Table:
    """Return the errors of rows in mrad by scheme: their spread or, of one motion, its end."""
    joints = rows[0].mean.size
    table = _table(heading)
    table.add_column("", no_wrap=True)
    for joint in range(1, joints + 1):
        table.add_column(f"J{joint}", justify="right", no_wrap=True)
    gap = " " if joints <= _SIDE_BY_SIDE else "\n"
    for scheme in dict.fromkeys(row.scheme for row in rows):
        table.add_row(f"[italic]{_short(scheme)}[/]", *[""] * joints)
        for row in rows:
            if row.scheme == scheme:
                beside = row.spread if len(row.rmse) > 1 else row.last[0]
                cells = [
                    f"{_mrad(m)}{gap}({_mrad(b)})" if np.isfinite(m) else "stopped"
                    for m, b in zip(row.mean, beside, strict=True)
                ]
                table.add_row(f" {title(row.law)}", *cells)
        table.add_section()
    return table


def sweeps(rows: Sequence[Tracked]) -> list[Table]:
    """Return one table for each scheme: changes by laws, the error of the worst joint in mrad."""
    parted = [(row.scheme.split(": "), row) for row in rows]
    tables = []
    for scheme in dict.fromkeys(parts[0] for parts, _ in parted):
        of_scheme = [(parts[1], row) for parts, row in parted if parts[0] == scheme]
        laws = list(dict.fromkeys(row.law for _, row in of_scheme))
        table = _table(f"{scheme}: RMSE of the worst joint [mrad] when the arm changes")
        table.add_column("")
        for law in laws:
            table.add_column(title(law).removeprefix("(").removesuffix(")"), justify="right")
        for change in dict.fromkeys(change for change, _ in of_scheme):
            errors = {row.law: row.mean.max() for c, row in of_scheme if c == change}
            cells = [_mrad(errors[law]) if np.isfinite(errors[law]) else "stopped" for law in laws]
            table.add_row(change, *cells)
        tables.append(table)
    return tables


def overcompensation(found: Sequence[Overcompensation]) -> Table:
    """Return from which factor on friction an arm at rest begins to cycle."""
    table = _table("Factor on the friction torque at which the arm at rest begins to cycle")
    for name in ("law", "scheme", "factor"):
        table.add_column(name)
    for one in found:
        factor = "none up to 3" if one.factor is None else f"{one.factor:g}"
        table.add_row(title(one.law), one.scheme, factor)
    return table


def _mrad(angle: float) -> str:
    """Return an angle [rad] in mrad; beyond 100 mrad, where runs go astray, no fractions."""
    return f"{1e3 * angle:.2f}" if abs(angle) < 0.1 else f"{1e3 * angle:.0f}"


def _short(scheme: str) -> str:
    """Return the name of a scheme so that it stands in one line."""
    return scheme.replace("friction of measured velocity", "measured dq").replace(
        "friction of filtered velocity", "filtered dq"
    )


def _table(heading: str) -> Table:
    return Table(
        title=escape(heading), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
