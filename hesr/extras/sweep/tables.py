"""Result of a sweep and its tables."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.tables.table import ResultTable, TableCell, row_of
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.sweep.plan import Plan, Sensitivity
from hesr.extras.sweep.work import RunTable
from hesr_model.support.arrays import Array

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SweepResult(Answer):
    """Runs of a sweep file, `reused` of them from before; sensitivities only for ``"sobol"``."""

    format = "hesr-sweep-1"
    plan: Plan
    table: RunTable
    sensitivities: list[Sensitivity]
    reused: int
    path: Path
    files: Sequence[Path] = ()

    def worst(self, output: int, most: int = 5) -> list[int]:
        """Return runs with the largest magnitudes of an output, failed ones first."""
        values = np.abs(self.table.outputs[:, output])
        order = np.argsort(np.where(np.isnan(values), -np.inf, -values), kind="stable")
        return [int(run) for run in order[:most]]

    def summary(self) -> str:
        """Return the numbers of runs and failures, and the worst runs."""
        failures = self.table.failures
        lines = [f"{len(failures)} runs, {sum(map(bool, failures))} failed."]
        if self.reused:
            lines.append(f"Complete before: {self.reused} runs.")
        for k, one in enumerate(self.plan.study.outputs):
            command = replay_command(self.path, self.worst(k)[0])
            lines.append(f"Worst run by {one.name}: {command}")
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return distributions and sensitivities."""
        return [outputs(self), *sensitivities(self)]

    def result(self) -> Any:
        """Return worst runs and sensitivities by output."""
        return {
            "runs": len(self.table.failures),
            "reused": self.reused,
            "failed": sum(map(bool, self.table.failures)),
            "worst": {o.name: self.worst(k) for k, o in enumerate(self.plan.study.outputs)},
            "sensitivities": {
                one.output: {"first": one.first.tolist(), "total": one.total.tolist()}
                for one in self.sensitivities
            },
        }


def outputs(swept: SweepResult) -> ResultTable:
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


def worst(swept: SweepResult, k: int) -> ResultTable:
    """Return the worst runs of output k, and commands to repeat them."""
    name = swept.plan.study.outputs[k].name
    study = swept.plan.study
    rows = []
    for run in swept.worst(k):
        inputs = [_cell(value) for value in swept.table.inputs[run]]
        value = swept.table.failures[run] or _cell(swept.table.outputs[run, k])
        rows.append(row_of(f"{run}", value, *inputs, replay_command(Path(swept.path.name), run)))
    return ResultTable(
        caption=f"Worst runs by {name}",
        head=("run", name, *study.names, "again by"),
        rows=rows,
        words=(2 + len(study.names),),
    )


def replay_command(path: Path, run: int) -> str:
    """Return the command that repeats one run."""
    return f"hesr simulate {shlex.quote(str(path))} --only {run} -o run{run}.csv"


def sensitivities(swept: SweepResult) -> Iterator[ResultTable]:
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
