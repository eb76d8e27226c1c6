"""Tables of a sweep."""

import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from cosim.report.tables.table import ResultTable, TableCell, row_of
from hesr.extras.sweep.plan import SweepRuns
from hesr_model.support.arrays import Array

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def outputs(swept: SweepRuns) -> ResultTable:
    """Return the distributions of the outputs."""
    rows = []
    for output, values in zip(swept.plan.study.outputs, swept.table.outputs.T, strict=True):
        found = values[np.isfinite(values)]
        numbers = (found.mean(), found.std(), *np.quantile(found, _QUANTILES), found.max())
        rows.append(row_of(output.name, *(_cell(value) for value in numbers)))
    failed = sum(map(bool, swept.table.failures))
    note = f"{failed} of {len(swept.table.failures)} runs failed." if failed else ""
    head = ("output", "mean", "std", *(f"{100 * q:.0f} %" for q in _QUANTILES), "largest")
    return ResultTable(caption="Outputs over all runs", head=head, rows=rows, note=note)


def worst(swept: SweepRuns, k: int, path: Path) -> ResultTable:
    """Return the worst runs of output k, and commands to repeat them."""
    name, study = swept.plan.study.outputs[k].name, swept.plan.study
    rows = []
    for run in swept.worst(k):
        inputs = [_cell(value) for value in swept.table.inputs[run]]
        value = swept.table.failures[run] or _cell(swept.table.outputs[run, k])
        rows.append(row_of(f"{run}", value, *inputs, replay_command(Path(path.name), run)))
    return ResultTable(
        caption=f"Worst runs by {name}",
        head=("run", name, *study.names, "again by"),
        rows=rows,
        words=(2 + len(study.names),),
    )


def replay_command(path: Path, run: int) -> str:
    """Return the command that repeats one run."""
    return f"hesr simulate {shlex.quote(str(path))} --only {run} -o run{run}.csv"


def sensitivities(swept: SweepRuns) -> Iterator[ResultTable]:
    """Yield the sensitivities of each output."""
    for one in swept.sensitivities:
        rows = [
            row_of(
                name,
                _with(one.first[i], one.intervals[0, i]),
                _with(one.total[i], one.intervals[1, i]),
            )
            for i, name in enumerate(swept.plan.study.names)
        ]
        yield ResultTable(
            caption=f"Shares of the variance of {one.output}, with 95 % bootstrap intervals",
            head=("input", "first order", "total"),
            rows=rows,
        )


def _cell(value: float) -> TableCell:
    return TableCell(text=f"{value:.4g}", value=float(value))


def _with(value: float, interval: Array) -> TableCell:
    low, high = interval
    return TableCell(text=f"{value:.3f}", value=float(value), notes=(f"{low:.3f} to {high:.3f}",))
