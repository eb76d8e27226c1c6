"""The matrix of engines and cases for a terminal."""

from collections.abc import Iterator

from rich.table import Table

from cosim.interop.case import Together
from cosim.interop.matrix import Cell, Matrix


def table(matrix: Matrix) -> Table:
    """Return the deviations, engine by case."""
    shown = Table(title="largest deviation, relative to the largest value of a signal")
    shown.add_column("engine")
    shown.add_column("version")
    for case in matrix.cases:
        shown.add_column(f"{case.name}\n({case.tolerance:g})", justify="right")
    for row in matrix.rows:
        cells = [_text(row.cells.get(case.name)) for case in matrix.cases]
        shown.add_row(row.engine.name, row.version or "-", *cells)
    return shown


def notes(matrix: Matrix) -> Iterator[str]:
    """Yield one line for each way of coupling, each cell without a number and each failure."""
    systems = [case.name for case in matrix.cases if isinstance(case, Together)]
    for row in matrix.rows:
        name = row.engine.name
        if row.missing:
            yield f"{name}: not run: {row.missing}."
            continue
        run = [row.cells[case] for case in systems if case in row.cells]
        if any(cell.deviation is not None for cell in run):
            yield f"{name}: systems are coupled by {row.engine.coupling}."
        reasons: dict[str, list[str]] = {}
        for case, cell in row.cells.items():
            if cell.skipped:
                reasons.setdefault(cell.skipped, []).append(case)
        for reason, cases in reasons.items():
            yield f"{name}: {', '.join(cases)} not run: {reason}."
        for case, cell in row.cells.items():
            if cell.fails:
                yield f"{name}: {case} fails: {cell.failure or 'it gives something else'}."


def _text(cell: Cell | None) -> str:
    if cell is None or cell.skipped:
        return "-"
    if cell.failure:
        return "FAILS"
    return f"{cell.deviation:.1e}{' FAILS' if cell.fails else ''}"
