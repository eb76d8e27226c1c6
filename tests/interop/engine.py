"""Engines: definition, search on this machine, and processes."""

import csv
import json
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from interop.case import Alone, Run, Together

from fmu_src.run.master import ExchangeScheme
from hesr_model.support.arrays import Array
from hesr_model.support.process import FailedError, run

DEFAULT_TOOLS = Path(".tools/interop")
"""Folder of the engines installed by `.ci/interop`, below the current one."""

SECONDS = 300.0
"""Time limit of an engine."""

HOSTS = Path(__file__).with_name("hosts")
_LONGEST = 300  # characters of an engine's output
_VERSIONS = """
import importlib.metadata as m, json
print(json.dumps({d.metadata["Name"].lower(): d.version for d in m.distributions()}))
"""


class SkippedError(Exception):
    """An engine does not run a case; the text gives the reason without a full stop."""


@dataclass(frozen=True, kw_only=True)
class Tools:
    """The machine's engines: in this interpreter, on the path, or in a folder.

    Attributes
    ----------
    folder : in the layout of `.ci/interop`.
    """

    folder: Path = DEFAULT_TOOLS

    def python(self, package: str) -> tuple[Path, str]:
        """Return an interpreter that has a Python package, and the package's version."""
        try:
            return Path(sys.executable), version(package)
        except PackageNotFoundError:
            pass
        if package in self._installed:
            return self._python, self._installed[package]
        raise SkippedError(f"there is no Python package {package}")

    def program(self, name: str) -> Path:
        """Return a program."""
        own = self.folder / "bin" / name
        found = str(own.resolve()) if own.is_file() else shutil.which(name)
        if found is None:
            raise SkippedError(f"there is no program {name}")
        return Path(found)

    def java(self, name: str) -> tuple[Path, Path]:
        """Return Java and the folder of an engine's jars."""
        folder = self.folder / name
        if not (folder / "version").is_file():
            raise SkippedError(f"there is no {folder}")
        return self.program("java"), folder.resolve()

    def java_version(self, name: str) -> str:
        """Return the version of an engine's jars."""
        return (self.java(name)[1] / "version").read_text(encoding="utf-8").strip()

    @property
    def _python(self) -> Path:
        return (self.folder / "python/bin/python").absolute()

    @cached_property
    def _installed(self) -> Mapping[str, str]:
        if not self._python.is_file():
            return {}
        ended = run((str(self._python), "-E", "-s", "-c", _VERSIONS), self.folder, SECONDS)
        found: dict[str, str] = json.loads(ended.stdout) if ended.returncode == 0 else {}
        return found


@dataclass(frozen=True, kw_only=True)
class Engine:
    """A third-party engine.

    Attributes
    ----------
    name : label in tables.
    install : how to get it.
    find : its version on this machine, or `SkippedError`.
    alone, together : run a case in an empty folder; raise `SkippedError`, or `FailedError` if the
        engine fails. None if unsupported.
    coupling : its exchange scheme.
    """

    name: str
    install: str
    find: Callable[[Tools], str]
    alone: Callable[[Tools, Alone, Path], Run] | None = None
    together: Callable[[Tools, Together, Path], Run] | None = None
    coupling: ExchangeScheme = field(default_factory=ExchangeScheme)


def describe(scheme: ExchangeScheme) -> str:
    """Return an engine's exchange scheme for tables."""
    parts = ["Jacobi"]
    if scheme.first == "zero":
        parts.append("first inputs zero")
    if scheme.refreshed != "none":
        parts.append("outputs of new inputs" + " shown" * (scheme.refreshed == "shown"))
    return ", ".join(parts)


def require_success(command: Sequence[str | Path], folder: Path) -> str:
    """Run a program in a folder and return its output.

    Raises
    ------
    FailedError
        If it ends with an error or takes too long, with the end of its output.
    """
    ended = run([str(part) for part in command], folder, SECONDS)
    if ended.returncode != 0:
        said = " ".join(ended.stdout.split())[-_LONGEST:]
        raise FailedError(f"it ended with code {ended.returncode} and said '{said}'")
    return ended.stdout


def host(python: Path, name: str, given: Mapping[str, Any], folder: Path) -> Run:
    """Run a Python host, which needs only the engine's package, on a case."""
    (folder / "case.json").write_text(json.dumps(given), encoding="utf-8")
    require_success((python, "-E", "-s", HOSTS / name, "case.json"), folder)
    seconds = folder / "seconds"
    return Run(
        signals=read_signals(folder / "result.csv"),
        seconds=float(seconds.read_text(encoding="utf-8")) if seconds.is_file() else None,
    )


def given_alone(case: Alone) -> dict[str, Any]:
    """Return one FMU in the format of the Python hosts."""
    return {
        "fmu": str(case.fmu.resolve()),
        "step": case.step,
        "stop": case.stop,
        "times": case.times.tolist(),
        "inputs": {name: values.tolist() for name, values in case.inputs.items()},
        "outputs": list(case.outputs),
        "start": dict(case.start),
        "arrays": {name: list(elements) for name, elements in case.arrays.items()},
    }


def given_together(case: Together) -> dict[str, Any]:
    """Return a system in the format of the Python hosts."""
    return {
        "ssp": str(case.ssp.resolve()),
        "step": case.spec.step,
        "steps": case.spec.steps,
        "signals": list(case.signals),
    }


def require_fmi_2(case: Alone) -> None:
    """Skip an FMU of FMI 3.0."""
    if case.fmi != 2:
        raise SkippedError("it is run with FMI 2.0 only")


def arguments(case: Alone) -> list[str]:
    """Return stop time, step and start values as arguments of the hosts in other languages."""
    columns = _columns(case, case.start)
    start = [
        f"{name}={' '.join(_literal(case.start[element]) for element in elements)}"
        for name, elements in columns.items()
    ]
    return [repr(case.stop), repr(case.step), *start]


def _columns(case: Alone, names: Iterable[str]) -> dict[str, Sequence[str]]:
    """Return the variables of a file's columns by name, the elements of an array in one column."""
    owner = {element: name for name, elements in case.arrays.items() for element in elements}
    return {owner.get(name, name): case.arrays.get(owner.get(name, ""), (name,)) for name in names}


def _literal(value: float) -> str:
    """Return a number as text, without decimals if it is an integer."""
    return str(int(value)) if value == int(value) else repr(value)


def write_inputs(case: Alone, path: Path, delimiter: str = ",") -> None:
    """Write the inputs as a table with all digits; spaces separate the elements of an array."""
    columns = _columns(case, case.inputs)
    values = [np.column_stack([case.inputs[name] for name in names]) for names in columns.values()]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, delimiter=delimiter)
        table.writerow(["time", *columns])
        for k, time in enumerate(case.times.tolist()):
            table.writerow([repr(time), *(" ".join(map(repr, v[k].tolist())) for v in values)])


def read_signals(
    path: Path, delimiter: str = ",", arrays: Mapping[str, Sequence[str]] | None = None
) -> dict[str, Array]:
    """Read a table of times [s] and signals, (N,) each in their units.

    Spaces separate the elements of an array in one column.

    Raises
    ------
    FailedError
        If it is missing or its content is not numeric.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            header, *lines = csv.reader(file, delimiter=delimiter)
        names = [element for name in header for element in (arrays or {}).get(name, (name,))]
        truth = {"false": "0", "true": "1"}
        rows = [[truth.get(x, x) for cell in line for x in cell.split()] for line in lines]
        columns = np.array(rows, dtype=float).reshape(-1, len(names)).T
    except (OSError, ValueError) as error:
        raise FailedError(f"it left no result that can be read ({error})") from error
    return {name: column for name, column in zip(names, columns, strict=True) if name != "time"}
