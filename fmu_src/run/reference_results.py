"""Reference results in an FMU or SSP, named by FMI-LS-REF: read, played and compared.

The standard does not fix the order of setting inputs, stepping and reading outputs. All known
orders are tried until one gives the results, unless the experiment is named after one.
"""

import csv
import hashlib
import posixpath
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from fmu_src.run.archive import MOST_TEXT, Archive
from fmu_src.run.fmu import FmuInstance
from hesr_model.errors import HesrError
from hesr_model.support.arrays import Array
from hesr_model.support.text import plain

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"

WAYS = ("hold", "shown", "direct")
"""Orders of calls: inputs of the start of a step are set, outputs are read after it; the same with
outputs read once the inputs of the next step are set; inputs of its end are set before a step.
"""

_TOLERANCE = 1e-3  # relative to the largest value, by default
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class Verified:
    """Problems and skipped experiments in sentences; order of calls of each that agrees."""

    problems: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    passed: dict[str, str] = field(default_factory=dict)


def verify(fmu: Path) -> Verified:
    """Run the experiments in an FMU and compare with its reference results.

    Raises ArtifactError if the file cannot be read at all.
    """
    found = Verified()
    with Archive(fmu) as archive:
        stored = experiments(archive, found)
    for experiment in stored:
        own = experiment.name
        ways = [own] if own in WAYS else WAYS

        def played(way: str, experiment: ReferenceExperiment = experiment) -> Array:
            with FmuInstance(fmu) as instance:
                return play(instance, experiment, way)

        judged(experiment, ways, played, found)
    return found


@dataclass(frozen=True, kw_only=True)
class ReferenceExperiment:
    """Inputs and results (N,) by name at the times t (N,) [s], and parameters."""

    name: str  # may be that of an order of calls
    tolerance: float  # relative to the largest value of each output
    t: Array
    inputs: dict[str, Array]
    outputs: dict[str, Array]
    parameters: dict[str, float]
    step: float = 0.0  # [s]; by default the difference of two times


def experiments(archive: Archive, found: Verified) -> list[ReferenceExperiment]:
    """Return the experiments for co-simulation in an archive; note problems."""
    if MANIFEST not in archive.names:
        found.skipped.append(f"Reference results: there is no {MANIFEST}.")
        return []
    try:
        return list(_Members(archive).experiments(found))
    except (ValueError, LookupError, csv.Error, ET.ParseError, HesrError) as error:
        found.problems.append(f"its reference results cannot be read: {_one_line(error)}.")
        return []


class _Members:
    """Files that a manifest names."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive

    def experiments(self, found: Verified) -> Iterator[ReferenceExperiment]:
        """Yield the experiments for co-simulation; note wrong files and skipped experiments."""
        for related in self._xml(MANIFEST).iter("Related"):
            place = _resolved(FOLDER, related.get("source", ""))
            if place not in self._archive.names:
                found.problems.append(f"{MANIFEST} names '{plain(place)}', which is missing.")
                continue
            if not self._sound(place, related):
                found.problems.append(f"'{plain(place)}' does not match its checksum.")
            if related.get("role", "").partition("/")[0] == "experiment":
                for element in self._xml(place).iter("Experiment"):
                    yield from self._experiment(element, posixpath.dirname(place), found)

    def _experiment(
        self, element: ET.Element, folder: str, found: Verified
    ) -> Iterator[ReferenceExperiment]:
        name = plain(element.get("name", ""))
        parts = {part.tag: part.get("source", "") for part in element}
        why = None
        if not {"Stimuli", "References"} <= parts.keys():
            why = "it has no stimuli with references"
        elif element.get("stepSize") is None:
            why = "it has no step size, so that it is for a solver"
        if why:
            found.skipped.append(f"Experiment '{name}': {why}; co-simulation is run here.")
            return
        stimuli, references = (
            self._table(_resolved(folder, parts[kind])) for kind in ("Stimuli", "References")
        )
        t, same = stimuli.pop("time"), references.pop("time")
        if t.shape != same.shape or np.any(np.abs(t - same) > 1e-9 * max(1.0, abs(t[-1]))):
            found.skipped.append(f"Experiment '{name}': its results are at other times.")
            return
        yield ReferenceExperiment(
            name=name,
            tolerance=float(element.get("tolerance", _TOLERANCE)),
            t=t,
            inputs=stimuli,
            outputs=references,
            parameters=self._parameters(folder, parts.get("Parameters")),
        )

    def _parameters(self, folder: str, source: str | None) -> dict[str, float]:
        if source is None:
            return {}
        columns = self._columns(_resolved(folder, source))
        return {name: float(value[0]) for name, value in columns.items()}

    def _xml(self, name: str) -> ET.Element:
        return ET.fromstring(self._archive.read(name, MOST_TEXT))

    def _table(self, name: str) -> dict[str, Array]:
        found = self._columns(name)
        if "time" not in found:
            raise ValueError(f"'{name}' is not a table over 'time'")
        return found

    def _columns(self, name: str) -> dict[str, Array]:
        lines = self._archive.read(name, MOST_TEXT).decode("utf-8").splitlines()
        head, *rows = csv.reader(lines[: _MOST_ROWS + 1], skipinitialspace=True)
        columns = np.array([[float(cell) for cell in row] for row in rows]).T
        if columns.shape[:1] != (len(head),):
            raise ValueError(f"'{name}' is not a table over 'time'")
        return dict(zip(head, columns, strict=True))

    def _sound(self, place: str, related: ET.Element) -> bool:
        digest, kind = related.get("checksum"), related.get("checksumType", "SHA3-256")
        algorithm = kind.lower().replace("sha-", "sha").replace("sha3-", "sha3_")
        unknown = algorithm not in hashlib.algorithms_available or algorithm.startswith("shake")
        if digest is None or unknown:  # SHAKE has no fixed length
            return True
        content = self._archive.read(place)
        return hashlib.new(algorithm, content).hexdigest() == digest.lower()


def judged(
    experiment: ReferenceExperiment,
    ways: Sequence[str],
    played: Callable[[str], Array],
    found: Verified,
) -> None:
    """Note whether one of several orders of calls gives the results of an experiment.

    `played` returns the values (N, outputs) of an order.
    """
    own = experiment.name
    worst: list[tuple[float, str]] = []
    for way in ways:
        try:
            rows = played(way)
        except HesrError as error:
            found.problems.append(f"experiment '{own}': {_one_line(error)}.")
            return
        off, text = _difference(experiment, rows)
        if off <= experiment.tolerance:
            found.passed[own] = way
            return
        worst.append((off, text))
    found.problems.append(
        f"experiment '{own}': {min(worst)[1]}, more than its tolerance of "
        f"{experiment.tolerance:g} of the largest value."
    )


def play(instance: FmuInstance, experiment: ReferenceExperiment, way: str) -> Array:
    """Initialise an FMU, run an experiment, and return its outputs (N, outputs)."""
    t = experiment.t
    rows = np.column_stack([*experiment.inputs.values(), t])[:, :-1]
    inputs = instance.buffer(list(experiment.inputs))
    outputs = instance.buffer(list(experiment.outputs))
    found = np.empty((len(t), len(experiment.outputs)))

    def set_row(k: int) -> None:
        inputs.values[:] = rows[k]
        inputs.write()

    inputs.values[:] = rows[0]
    instance.initialise(time=float(t[0]), start=experiment.parameters, inputs=inputs)
    found[0] = outputs.read()
    for k in range(1, len(t)):
        set_row(k if way == "direct" else k - 1)
        instance.step(float(t[k - 1]), experiment.step or float(t[k] - t[k - 1]))
        if way == "shown":
            set_row(k)
        found[k] = outputs.read()
    return found


def _difference(experiment: ReferenceExperiment, rows: Array) -> tuple[float, str]:
    """Return the largest relative difference and its location."""
    expected = np.column_stack(list(experiment.outputs.values()))
    size = np.maximum(np.abs(expected).max(axis=0), np.finfo(float).tiny)
    off = np.nan_to_num(np.abs(rows - expected) / size, nan=np.inf)
    k, j = np.unravel_index(int(np.argmax(off)), off.shape)
    name = plain(list(experiment.outputs)[j])
    text = f"{name} is {rows[k, j]:g} in place of {expected[k, j]:g} at {experiment.t[k]:g} s"
    return float(off[k, j]), text


def _resolved(folder: str, source: str) -> str:
    return posixpath.normpath(posixpath.join(folder, source))


def _one_line(error: Exception) -> str:
    return plain(" ".join(str(error).split()).rstrip("."), 400)
