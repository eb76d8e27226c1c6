"""Result of a sweep and its tables."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cosim.report.markup import ResultFigure
from cosim.report.tables.table import ResultTable, TableCell, make_row
from cosim.workflow.answer import Answer, shorten_lines
from hesr.extras.sweep.plan import Plan, Sensitivity
from hesr.extras.sweep.work import RunTable
from hesr_model.support.arrays import Array

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_DESIGNS = {
    "grid": "a grid",
    "latin_hypercube": "a Latin hypercube",
    "monte_carlo": "random points",
    "sobol": "Saltelli's design of Sobol points",
}
_OUTPUTS = "Outputs"
_WORST_RUNS = "Worst runs"
_SENSITIVITIES = "Sensitivities"
"""Sections of the page."""
_SENSITIVITY_TERMS = (
    "First order: share of an input alone; total: with all of its interactions. Shares of "
    "correlated inputs are those of their independent normal numbers."
)


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

    def find_worst_runs(self, output: int, run_count: int = 5) -> list[int]:
        """Return runs with the largest magnitudes of an output, failed ones first."""
        values = np.abs(self.table.outputs[:, output])
        order = np.argsort(np.where(np.isnan(values), -np.inf, -values), kind="stable")
        return [int(run) for run in order[:run_count]]

    def heading(self) -> str:
        """Return the name of the sweep."""
        return f"Sweep ‘{self.plan.study.name}’"

    def introduction(self) -> str:
        """Return the design and the folder of the runs."""
        plan = self.plan
        return (
            f"{len(plan.values)} runs of {plan.task.system.stop:g} s, "
            f"{_DESIGNS[plan.study.design]} over {len(plan.study.names)} inputs, seed "
            f"{plan.study.seed}. The Parquet data set runs/ has inputs and outputs of each run."
        )

    def summary(self) -> str:
        """Return the numbers of runs and failures, and the worst runs."""
        failures = self.table.failures
        lines = [f"{len(failures)} runs, {sum(map(bool, failures))} failed."]
        if self.reused:
            lines.append(f"Complete before: {self.reused} runs.")
        for k, output in enumerate(self.plan.study.outputs):
            command = replay_command(self.path, self.find_worst_runs(k)[0])
            lines.append(f"Worst run by {output.name}: {command}")
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return distributions, worst runs and sensitivities."""
        tables: list[ResultTable | str] = [build_output_table(self)]
        tables.append("Largest magnitude first, failed runs before all others.")
        tables += [build_worst_table(self, k) for k in range(len(self.plan.study.outputs))]
        if self.sensitivities:
            tables.append(_SENSITIVITY_TERMS)
            tables += build_sensitivity_tables(self)
        return tables

    def figures(self) -> Sequence[ResultFigure]:
        """Return histograms of the outputs, and bars of their sensitivities."""
        from hesr.extras.sweep.figures import draw_distributions, draw_shares  # slow import

        names = [output.name for output in self.plan.study.outputs]
        histograms = ResultFigure(
            section=_OUTPUTS,
            key="distributions",
            drawing=draw_distributions(names, self.table.outputs),
            caption="Distribution of each output over the runs; dashed: 5, 50 and 95 % quantiles.",
            alt="A histogram of each output.",
        )
        bars = [
            ResultFigure(
                section=_SENSITIVITIES,
                key=f"shares-{k}",
                drawing=draw_shares(
                    self.plan.study.names,
                    sensitivity.first,
                    sensitivity.total,
                    sensitivity.intervals,
                ),
                caption=f"Shares of the variance of {sensitivity.output}.",
                alt="Two bars for each input.",
            )
            for k, sensitivity in enumerate(self.sensitivities)
        ]
        return [histograms, *bars]

    def result(self) -> Any:
        """Return worst runs and sensitivities by output."""
        worst_runs = {
            output.name: self.find_worst_runs(k) for k, output in enumerate(self.plan.study.outputs)
        }
        sensitivities = {}
        for sensitivity in self.sensitivities:
            sensitivities[sensitivity.output] = {
                "first": sensitivity.first.tolist(),
                "total": sensitivity.total.tolist(),
            }
        return {
            "runs": len(self.table.failures),
            "reused": self.reused,
            "failed": sum(map(bool, self.table.failures)),
            "worst": worst_runs,
            "sensitivities": sensitivities,
        }


def build_output_table(sweep_result: SweepResult) -> ResultTable:
    """Return the distributions of the outputs."""
    rows = []
    for k, output in enumerate(sweep_result.plan.study.outputs):
        values = sweep_result.table.outputs[:, k]
        finite_values = values[np.isfinite(values)]
        numbers = (
            finite_values.mean(),
            finite_values.std(),
            *np.quantile(finite_values, _QUANTILES),
            finite_values.max(),
        )
        rows.append(make_row(output.name, *(_format_cell(value) for value in numbers)))
    failures = sweep_result.table.failures
    failure_count = sum(map(bool, failures))
    note = ""
    if failure_count:
        note = f"{failure_count} of {len(failures)} runs failed."
    head = ("output", "mean", "std", *(f"{100 * q:.0f} %" for q in _QUANTILES), "largest")
    return ResultTable(
        caption="Outputs over all runs", head=head, rows=rows, note=note, section=_OUTPUTS
    )


def build_worst_table(sweep_result: SweepResult, k: int) -> ResultTable:
    """Return the worst runs of output k, and commands to repeat them."""
    name = sweep_result.plan.study.outputs[k].name
    study = sweep_result.plan.study
    rows = []
    for run in sweep_result.find_worst_runs(k):
        inputs = [_format_cell(value) for value in sweep_result.table.inputs[run]]
        value = sweep_result.table.failures[run] or _format_cell(sweep_result.table.outputs[run, k])
        rows.append(make_row(f"{run}", value, *inputs, replay_command(sweep_result.path, run)))
    return ResultTable(
        caption=f"Worst runs by {name}",
        head=("run", name, *study.names, "again by"),
        rows=rows,
        words=(2 + len(study.names),),
        section=_WORST_RUNS,
    )


def replay_command(path: Path, run: int) -> str:
    """Return the command that repeats one run."""
    return f"hesr simulate {shlex.quote(str(path))} --only {run} -o run{run}.csv"


def build_sensitivity_tables(sweep_result: SweepResult) -> Iterator[ResultTable]:
    """Yield the sensitivities of each output."""
    for sensitivity in sweep_result.sensitivities:
        rows = [
            make_row(
                name,
                _interval_cell(sensitivity.first[i], sensitivity.intervals[0, i]),
                _interval_cell(sensitivity.total[i], sensitivity.intervals[1, i]),
            )
            for i, name in enumerate(sweep_result.plan.study.names)
        ]
        yield ResultTable(
            caption=f"Shares of the variance of {sensitivity.output}, with 95 % bootstrap "
            "intervals",
            head=("input", "first order", "total"),
            rows=rows,
            section=_SENSITIVITIES,
        )


def _format_cell(value: float) -> TableCell:
    return TableCell(text=f"{value:.4g}", value=float(value))


def _interval_cell(value: float, interval: Array) -> TableCell:
    lowest, highest = interval
    return TableCell(
        text=f"{value:.3f}", value=float(value), notes=(f"{lowest:.3f} to {highest:.3f}",)
    )
