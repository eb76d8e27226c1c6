"""The matrix of engines and cases as a table."""

from collections.abc import Iterator

from interop.case import Together
from interop.engine import describe
from interop.matrix import EngineMatrix, EngineResult

from cosim.report.tables.table import ResultTable, make_row


def table(matrix: EngineMatrix) -> ResultTable:
    """Return the deviations, engines by cases."""
    names = [case.name for case in matrix.cases]
    return ResultTable(
        caption="largest deviation, relative to the largest value of a signal",
        head=("engine", "version", *(f"{case.name} ({case.tolerance:g})" for case in matrix.cases)),
        words=(1,),
        rows=[
            make_row(
                row.engine.name,
                row.version or "-",
                *(_text(row.cells.get(name)) for name in names),
            )
            for row in matrix.rows
        ],
    )


def notes(matrix: EngineMatrix) -> Iterator[str]:
    """Yield one line for each exchange scheme, each cell without a number and each failure."""
    systems = [case.name for case in matrix.cases if isinstance(case, Together)]
    for row in matrix.rows:
        name = row.engine.name
        if row.missing:
            yield f"{name}: not run: {row.missing}."
            continue
        run = [row.cells[case] for case in systems if case in row.cells]
        if any(cell.deviation is not None for cell in run):
            yield f"{name}: systems are coupled by {describe(row.engine.coupling)}."
        reasons: dict[str, list[str]] = {}
        for case, cell in row.cells.items():
            if cell.skipped:
                reasons.setdefault(cell.skipped, []).append(case)
        for reason, cases in reasons.items():
            yield f"{name}: {', '.join(cases)} not run: {reason}."
        for case, cell in row.cells.items():
            if cell.harness:
                yield f"{name}: {case} not run: our harness fails on its control: {cell.harness}."
            elif cell.fails:
                yield f"{name}: {case} fails: {cell.failure or 'it gives something else'}."


def _text(cell: EngineResult | None) -> str:
    if cell is None or cell.skipped:
        return "-"
    if cell.harness:
        return "HARNESS"
    if cell.failure:
        return "FAILS"
    return f"{cell.deviation:.1e}{' FAILS' if cell.fails else ''}"
