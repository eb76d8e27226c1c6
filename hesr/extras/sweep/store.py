"""Results of a sweep: one Parquet file per chunk of runs."""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from hesr.extras.sweep.work import RunOutputs
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.logs.tables import arrow
from hesr_model.support.arrays import Array
from hesr_model.support.files import folder_made, written_whole
from hesr_model.support.typed_json import read_json, write_json

ABOUT = "sweep.json"
RUNS = "runs"  # folder of the Parquet files, which form one data set


@dataclass(frozen=True, kw_only=True, eq=False)
class RunTable:
    """All runs: inputs (runs, d), outputs (runs, m), NaN for failures, and reasons."""

    inputs: Array
    outputs: Array
    failures: tuple[str, ...]


class Store:
    """The folder of a sweep, once it is `taken`."""

    def __init__(self, folder: Path, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> None:
        self._arrow = arrow()
        self._folder, self._inputs, self._outputs = folder, inputs, outputs

    def file(self, first: int) -> Path:
        """Return the file of the chunk from a run."""
        return self._folder / RUNS / f"part-{first:08d}.parquet"

    def write(self, first: int, values: Array, rows: RunOutputs) -> None:
        """Write a chunk; the same runs give the same bytes."""
        columns: dict[str, Any] = {"run": np.arange(first, first + len(values), dtype=np.int64)}
        columns |= dict(zip(self._inputs, values.T, strict=True))
        columns |= dict(zip(self._outputs, rows.outputs.T, strict=True))
        columns["failure"] = self._arrow.array(rows.failures, self._arrow.string())
        table = self._arrow.table(columns)
        with written_whole(self.file(first)) as temporary:
            self._arrow.parquet.write_table(table, temporary, compression="zstd")

    def has(self, first: int, values: Array) -> bool:
        """Whether a chunk exists, is readable and has these inputs."""
        try:
            return np.array_equal(self._read(first).inputs, values)
        except (OSError, ValueError, KeyError, self._arrow.ArrowException):
            return False

    def read(self, firsts: list[int]) -> RunTable:
        """Read chunks in the given order."""
        parts = [self._read(first) for first in firsts]
        return RunTable(
            inputs=np.concatenate([part.inputs for part in parts]),
            outputs=np.concatenate([part.outputs for part in parts]),
            failures=tuple(text for part in parts for text in part.failures),
        )

    def _read(self, first: int) -> RunTable:
        found = self._arrow.parquet.read_table(self.file(first))

        def numbers(names: tuple[str, ...]) -> Array:
            return np.column_stack([found.column(name).to_numpy() for name in names])

        return RunTable(
            inputs=numbers(self._inputs),
            outputs=numbers(self._outputs),
            failures=tuple(found.column("failure").to_pylist()),
        )


@contextmanager
def taken(folder: Path, within: str, file: str, about: Mapping[str, Any]) -> Iterator[None]:
    """Lock a folder with the parts in `within` and the description `about` in `file`."""
    what = Path(file).stem
    with ExitStack() as cleanup:
        try:
            cleanup.enter_context(folder_made(folder / within))
            lock = FileLock(folder / f".{what}-lock", timeout=0)
            lock.acquire()
        except Timeout as error:
            raise ArtifactError(
                f"{folder}: another {what} is writing here; wait for it, or give another folder."
            ) from error
        except OSError as error:
            raise ArtifactError(f"{folder}: cannot be written there ({error.strerror}).") from error
        cleanup.callback((folder / f".{what}-lock").unlink, missing_ok=True)
        cleanup.callback(lock.release)
        if not (folder / file).is_file():
            write_json(folder / file, json.loads(json.dumps(about)))
        elif read_json(folder / file).get("key") != about["key"]:
            raise ConfigError(
                f"{folder}: holds results of another {what}; give another folder or remove it."
            )
        for left in (folder / within).glob(".part-*"):  # left by a killed run
            left.unlink(missing_ok=True)
        yield
