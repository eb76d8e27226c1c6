"""Runs of a system whose FMUs stay loaded between runs, and their results by chunk."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, Value
from fmu_src.run.fmu import POOL
from hesr.extras.sweep.study import Measure, Measured
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.logs.tables import import_arrow
from hesr_model.support.arrays import Array
from hesr_model.support.files import folder_made, written_whole
from hesr_model.support.typed_files import read_json, write_json

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
            scaled_values = tuple(number * base_value for base_value in self.base)
            if len(scaled_values) == 1:
                return scaled_values[0]
            return scaled_values
        if self.integer:
            return int(number)
        return number


@dataclass(frozen=True, kw_only=True)
class Task:
    """System, varied variables and outputs of all runs; `key` hashes them all."""

    key: str
    system: SystemSpec
    targets: tuple[VariedVariable, ...]
    outputs: tuple[Measured, ...]

    def start(self, row: Array) -> Start:
        """Return the start values of a run (d,)."""
        start: Start = {}
        for target in self.targets:
            start.setdefault(target.component, {})[target.variable] = target.value(row)
        return start

    def measure_outputs(self, signals: Signals) -> Array:
        """Return the measured numbers of a run (m,); NaN if it failed."""
        if signals.failure:
            return np.full(len(self.outputs), np.nan)
        measurements = []
        for output in self.outputs:
            values = signals.vector(output.signal)
            if output.reference:
                values = values - signals.vector(output.reference)
            measurements.append(_MEASURES[output.measure](values[signals.t >= output.start]))
        return np.array(measurements)


@dataclass(frozen=True, kw_only=True, eq=False)
class RunOutputs:
    """Outputs (n, m) of some runs, NaN for failures, and their reasons."""

    outputs: Array
    failures: tuple[str, ...]


_LOCK = Lock()
_loaded: tuple[str, Master] | None = None  # system of the last task, loaded


def run_rows(task: Task, values: Array) -> RunOutputs:
    """Do the runs with these varied numbers (n, d)."""
    outputs = np.empty((len(values), len(task.outputs)))
    failures = []
    with _LOCK:  # a worker of a cluster may have several threads
        global _loaded
        if _loaded is None or _loaded[0] != task.key:
            release()
            _loaded = task.key, Master(task.system, loaded=POOL).__enter__()
        master = _loaded[1]
        for run, row in enumerate(values):
            signals = master.run(start=task.start(row))
            outputs[run] = task.measure_outputs(signals)
            failures.append(str(signals.failure or ""))
    return RunOutputs(outputs=outputs, failures=tuple(failures))


def release() -> None:
    """Free the FMUs of the last task."""
    global _loaded
    if _loaded is not None:
        loaded = _loaded
        _loaded = None
        loaded[1].__exit__(None, None, None)
    POOL.clear()


ABOUT = "sweep.json"
RUNS = "runs"  # folder of the Parquet files, which form one data set


@dataclass(frozen=True, kw_only=True, eq=False)
class RunTable(RunOutputs):
    """All runs with their inputs (runs, d)."""

    inputs: Array


class Store:
    """The folder of a sweep, once it is locked by `lock_folder`."""

    def __init__(self, folder: Path, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> None:
        self._arrow = import_arrow()
        self._folder = folder
        self._inputs = inputs
        self._outputs = outputs

    def find_file(self, chunk_start: int) -> Path:
        """Return the file of the chunk from a run."""
        return self._folder / RUNS / f"part-{chunk_start:08d}.parquet"

    def write(self, chunk_start: int, values: Array, rows: RunOutputs) -> None:
        """Write a chunk; the same runs give the same bytes."""
        columns: dict[str, Any] = {
            "run": np.arange(chunk_start, chunk_start + len(values), dtype=np.int64)
        }
        columns |= dict(zip(self._inputs, values.T, strict=True))
        columns |= dict(zip(self._outputs, rows.outputs.T, strict=True))
        columns["failure"] = self._arrow.array(rows.failures, self._arrow.string())
        table = self._arrow.table(columns)
        with written_whole(self.find_file(chunk_start)) as temporary:
            self._arrow.parquet.write_table(table, temporary, compression="zstd")

    def has(self, chunk_start: int, values: Array) -> bool:
        """Whether a chunk exists, is readable and has these inputs."""
        try:
            return np.array_equal(self.read([chunk_start]).inputs, values)
        except (OSError, ValueError, KeyError, self._arrow.ArrowException):
            return False

    def read(self, chunk_starts: list[int]) -> RunTable:
        """Read chunks in the given order."""
        files = [self.find_file(chunk_start) for chunk_start in chunk_starts]
        chunks = [self._arrow.parquet.read_table(file) for file in files]
        arrow_table = self._arrow.concat_tables(chunks)

        def read_columns(names: tuple[str, ...]) -> Array:
            return np.column_stack([arrow_table.column(name).to_numpy() for name in names])

        return RunTable(
            inputs=read_columns(self._inputs),
            outputs=read_columns(self._outputs),
            failures=tuple(arrow_table.column("failure").to_pylist()),
        )


@contextmanager
def lock_folder(
    folder: Path, parts_folder: str, description_file: str, description: Mapping[str, Any]
) -> Iterator[None]:
    """Lock a folder with parts in `parts_folder`; `description` is that of its results."""
    kind = Path(description_file).stem
    with ExitStack() as cleanup:
        try:
            cleanup.enter_context(folder_made(folder / parts_folder))
            lock = FileLock(folder / f".{kind}-lock", timeout=0)
            lock.acquire()
        except Timeout as error:
            raise ArtifactError(
                f"{folder}: another {kind} is writing here; wait for it, or give another folder."
            ) from error
        except OSError as error:
            raise ArtifactError(f"{folder}: cannot be written there ({error.strerror}).") from error
        cleanup.callback((folder / f".{kind}-lock").unlink, missing_ok=True)
        cleanup.callback(lock.release)
        if not (folder / description_file).is_file():
            write_json(folder / description_file, description)
        elif read_json(folder / description_file).get("key") != description["key"]:
            raise ConfigError(
                f"{folder}: holds results of another {kind}; give another folder or remove it."
            )
        for partial_file in (folder / parts_folder).glob(".part-*"):  # left by a killed run
            partial_file.unlink(missing_ok=True)
        yield
