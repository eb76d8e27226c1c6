"""Tables of a fleet."""

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from cosim.report.tables.table import ResultTable, TableCell, fixed, number, row_of
from hesr.extras.fleet.result import BODY
from hesr_model.inference.deviation import ENOUGH

if TYPE_CHECKING:
    from hesr.extras.fleet.result import Fleet

_MOST = 30  # maximum rows per table; the Parquet file is complete


def all_tables(fleet: "Fleet") -> Iterator[ResultTable]:
    """Yield the non-empty tables."""
    yield types(fleet)
    for table in (deviants(fleet), changes(fleet), broken(fleet)):
        if table.rows:
            yield table


def types(fleet: "Fleet") -> ResultTable:
    """Return the counts by type."""
    type_of = {robot.robot: robot.type for robot in fleet.robots}
    columns = [
        {robot.robot for robot in fleet.robots},
        {d.robot for d in fleet.deviants},
        {c.robot for c in fleet.changes if c.worse},
        {robot.robot for robot in fleet.robots if robot.findings},
        {robot.robot for robot in fleet.broken},
    ]
    counts = [Counter(type_of[name] for name in names) for names in columns]
    few = [t for t in sorted(counts[0]) if counts[0][t] < ENOUGH]
    return ResultTable(
        caption=f"Fleet {fleet.name}",
        head=("type", "robots", "deviate", "got worse", "with findings", "not all used"),
        rows=[row_of(t, *(fixed(c[t], 0) for c in counts)) for t in sorted(counts[0])],
        note=f"Fewer than {ENOUGH} robots are not compared: {', '.join(few)}." if few else "",
    )


def deviants(fleet: "Fleet") -> ResultTable:
    """Return the deviating numbers."""
    rows = []
    for d in fleet.deviants[:_MOST]:
        law = "rigid body" if d.law == BODY else d.law
        numbers = (number(d.value, 4), number(d.median, 4), fixed(d.z, 1), _p(d.p))
        rows.append(row_of(d.robot, law, d.joint or "–", d.name, *numbers))
    return ResultTable(
        caption="Robots that deviate from their type",
        head=("robot", "law", "joint", "number", "value", "median", "z", "p"),
        rows=rows,
        words=(1, 2, 3),
        note=f"z in robust standard deviations, p adjusted for all numbers compared."
        f"{_more(len(fleet.deviants))}",
    )


def changes(fleet: "Fleet") -> ResultTable:
    """Return the changes, worse ones first."""
    rows = []
    for c in fleet.changes[:_MOST]:
        numbers = (_share(c.change, 1), _share(c.per_day, 2), _p(c.p))
        worse = "yes" if c.worse else "no"
        rows.append(row_of(c.robot, c.law, c.joint, c.kind, *numbers, worse, c.points_to))
    return ResultTable(
        caption="Robots that have changed",
        head=("robot", "law", "joint", "what", "change", "per day", "p", "worse", "points to"),
        rows=rows,
        words=(1, 2, 3, 7, 8),
        note=f"Shares of friction; p adjusted for all trends.{_more(len(fleet.changes))}",
    )


def broken(fleet: "Fleet") -> ResultTable:
    """Return omissions with their reasons."""
    rows = [row_of(robot.robot, text) for robot in fleet.broken for text in robot.sentences]
    return ResultTable(caption="Not used", head=("robot", "why"), rows=rows, numeric=False)


def _more(count: int) -> str:
    return f" {count - _MOST} more are in the Parquet file." if count > _MOST else ""


def _share(share: float, decimals: int) -> TableCell:
    return TableCell(text=f"{100.0 * share:+.{decimals}f} %".replace("-", "−"), value=share)


def _p(p: float) -> TableCell:
    return TableCell(text="< 0.001" if p < 1e-3 else f"{p:.3f}", value=p)
