"""Runs of a system whose FMUs stay loaded between runs."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Lock

import numpy as np

from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, Value
from fmu_src.run.fmu import POOL
from hesr.extras.sweep.study import Measure, Measured
from hesr_model.support.arrays import Array

Start = dict[str, dict[str, Value]]

_MEASURES: Mapping[Measure, Callable[[Array], float]] = {
    "rms": lambda values: float(np.sqrt(np.mean(values**2))),
    "max": lambda values: float(np.abs(values).max()),
    "mean": lambda values: float(np.mean(values)),
    "final": lambda values: float(np.abs(values[-1]).mean()),
}


@dataclass(frozen=True, kw_only=True)
class VariedVariable:
    """A variable set by the varied number in `column`, as a factor on `base` if given."""

    component: str
    variable: str
    column: int
    base: tuple[float, ...] | None = None
    integer: bool = False

    def value(self, row: Array) -> Value:
        """Return the start value in a run."""
        number = float(row[self.column])
        if self.base is not None:
            scaled = tuple(number * part for part in self.base)
            return scaled if len(scaled) > 1 else scaled[0]
        return int(number) if self.integer else number


@dataclass(frozen=True, kw_only=True)
class Task:
    """System, varied variables and outputs of all runs; `key` hashes them all."""

    key: str
    spec: SystemSpec
    targets: tuple[VariedVariable, ...]
    outputs: tuple[Measured, ...]

    def start(self, row: Array) -> Start:
        """Return the start values of a run (d,)."""
        start: Start = {}
        for target in self.targets:
            start.setdefault(target.component, {})[target.variable] = target.value(row)
        return start

    def measured(self, result: Signals) -> Array:
        """Return the measured numbers of a run (m,); NaN if it failed."""
        if result.failure:
            return np.full(len(self.outputs), np.nan)
        found = []
        for output in self.outputs:
            values = result.vector(output.signal)
            if output.reference:
                values = values - result.vector(output.reference)
            found.append(_MEASURES[output.measure](values[result.t >= output.start]))
        return np.array(found)


@dataclass(frozen=True, kw_only=True, eq=False)
class RunOutputs:
    """Outputs (n, m) of some runs, NaN for failures, and their reasons."""

    outputs: Array
    failures: tuple[str, ...]


_LOCK = Lock()
_held: tuple[str, Master] | None = None  # system of the last task, loaded


def run_rows(task: Task, values: Array) -> RunOutputs:
    """Do the runs with these varied numbers (n, d)."""
    outputs, failures = np.empty((len(values), len(task.outputs))), []
    with _LOCK:  # a worker of a cluster may have several threads
        global _held
        if _held is None or _held[0] != task.key:
            release()
            _held = task.key, Master(task.spec, loaded=POOL).__enter__()
        master = _held[1]
        for k, row in enumerate(values):
            result = master.run(start=task.start(row))
            outputs[k] = task.measured(result)
            failures.append(str(result.failure or ""))
    return RunOutputs(outputs=outputs, failures=tuple(failures))


def release() -> None:
    """Free the FMUs of the last task."""
    global _held
    if _held is not None:
        held, _held = _held, None
        held[1].__exit__(None, None, None)
    POOL.clear()
