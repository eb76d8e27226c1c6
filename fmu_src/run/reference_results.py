"""Whether an FMU gives the reference results that it carries, as FMI-LS-REF names them.

The standard does not say how inputs are handed over. Ways are tried until one gives the results; an
experiment that is called as one of them is run in this way alone.
"""

import csv
import hashlib
import posixpath
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from fmu_src.run.archive import MOST_TEXT, Archive
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.reference_manifest import FOLDER, MANIFEST
from hesr_model.errors import HesrError
from hesr_model.support.arrays import Array
from hesr_model.support.text import plain

WAYS: Mapping[str, str] = {
    "hold": "inputs hold over each step, outputs are read after it",
    "shown": "the same, outputs read once the inputs of the next step are set",
    "direct": "inputs of the end of each step, set before it",
}
"""How inputs may be handed over, by name."""

_TOLERANCE = 1e-3  # of the largest value, where an experiment says nothing
_MOST_ROWS = 100_000


@dataclass(frozen=True)
class Verified:
    """What came of the reference results of an FMU.

    Attributes
    ----------
    problems, skipped : sentences.
    passed : for each experiment that agrees the way in which it was run.
    """

    problems: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    passed: dict[str, str] = field(default_factory=dict)


def verify(fmu: Path) -> Verified:
    """Play the experiments that an FMU carries and compare with its reference results.

    Parameters
    ----------
    fmu : of FMI 2.0 for co-simulation; its code is run.

    Raises
    ------
    ArtifactError
        If the file cannot be read at all.
    """
    found = Verified()
    with Archive(fmu) as archive:
        stored = experiments(archive, found)
    for experiment in stored:
        own = experiment.name
        ways = [own] if own in WAYS else list(WAYS)
        judged(experiment, ways, partial(_played, fmu, experiment), found)
    return found


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """Stimuli and results that were read.

    Attributes
    ----------
    name : that of a way of handing values over, or any other.
    tolerance : of the largest value of each output.
    t : (N,) [s].
    inputs, outputs : (N,) each, by name.
    parameters : values by name.
    """

    name: str
    tolerance: float
    t: Array
    inputs: dict[str, Array]
    outputs: dict[str, Array]
    parameters: dict[str, float]


def experiments(archive: Archive, found: Verified) -> list[Experiment]:
    """Return the experiments for co-simulation that an archive carries; tell what is wrong."""
    if MANIFEST not in archive.names:
        found.skipped.append(f"Reference results: there is no {MANIFEST}.")
        return []
    try:
        return list(_Members(archive).experiments(found))
    except (ValueError, LookupError, csv.Error, ET.ParseError, HesrError) as error:
        found.problems.append(f"its reference results cannot be read: {_one_line(error)}.")
        return []


class _Members:
    """The files that a manifest names."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive

    def experiments(self, found: Verified) -> Iterator[Experiment]:
        """Yield the experiments for co-simulation; say what is wrong with files, what is left."""
        for related in self._xml(MANIFEST).iter("Related"):
            place = _resolved(FOLDER, related.get("source", ""))
            if place not in self._archive.names:
                found.problems.append(f"{MANIFEST} names '{plain(place)}', which is not there.")
                continue
            if not self._sound(place, related):
                found.problems.append(f"'{plain(place)}' is not what its checksum says.")
            if related.get("role", "").partition("/")[0] == "experiment":
                for element in self._xml(place).iter("Experiment"):
                    yield from self._experiment(element, posixpath.dirname(place), found)

    def _experiment(
        self, element: ET.Element, folder: str, found: Verified
    ) -> Iterator[Experiment]:
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
        yield Experiment(
            name=name,
            tolerance=float(element.get("tolerance", _TOLERANCE)),
            t=t,
            inputs=stimuli,
            outputs=references,
            parameters=self._parameters(folder, parts.get("Parameters")),
        )

    def _parameters(self, folder: str, source: str | None) -> dict[str, float]:
        """Return the values of a table's only row."""
        if source is None:
            return {}
        columns = self._columns(_resolved(folder, source))
        return {name: float(value[0]) for name, value in columns.items()}

    def _xml(self, name: str) -> ET.Element:
        return ET.fromstring(self._archive.read(name, MOST_TEXT))

    def _table(self, name: str) -> dict[str, Array]:
        found = self._columns(name)
        if "time" not in found:
            raise ValueError(f"'{name}' is no table over 'time'")
        return found

    def _columns(self, name: str) -> dict[str, Array]:
        lines = self._archive.read(name, MOST_TEXT).decode("utf-8").splitlines()
        head, *rows = csv.reader(lines[: _MOST_ROWS + 1], skipinitialspace=True)
        columns = np.array([[float(cell) for cell in row] for row in rows]).T
        if columns.shape[:1] != (len(head),):
            raise ValueError(f"'{name}' is no table over 'time'")
        return dict(zip(head, columns, strict=True))

    def _sound(self, place: str, related: ET.Element) -> bool:
        digest, kind = related.get("checksum"), related.get("checksumType", "SHA3-256")
        algorithm = kind.lower().replace("sha-", "sha").replace("sha3-", "sha3_")
        unknown = algorithm not in hashlib.algorithms_available or algorithm.startswith("shake")
        if digest is None or unknown:  # or one whose sums have no length of their own
            return True
        content = self._archive.read(place)
        return hashlib.new(algorithm, content).hexdigest() == digest.lower()


def judged(
    experiment: Experiment, ways: Sequence[str], played: Callable[[str], Array], found: Verified
) -> None:
    """Tell whether an experiment gives its results in one of several ways.

    Parameters
    ----------
    experiment : with its results.
    ways : to try.
    played : returns the (N, outputs) values of a way.
    found : what is told.
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


def _played(fmu: Path, experiment: Experiment, way: str) -> Array:
    """Return the (N, outputs) values that the FMU gives."""
    t = experiment.t
    rows = np.column_stack([*experiment.inputs.values(), t])[:, :-1]
    answers = np.empty((len(t), len(experiment.outputs)))
    with FmuInstance(fmu) as component:
        inputs = component.buffer(list(experiment.inputs))
        outputs = component.buffer(list(experiment.outputs))

        def set_row(k: int) -> None:
            inputs.values[:] = rows[k]
            inputs.write()

        inputs.values[:] = rows[0]
        component.initialise(time=float(t[0]), start=experiment.parameters, inputs=inputs)
        answers[0] = outputs.read()
        for k in range(1, len(t)):
            set_row(k if way == "direct" else k - 1)
            component.step(float(t[k - 1]), float(t[k] - t[k - 1]))
            if way == "shown":
                set_row(k)
            answers[k] = outputs.read()
    return answers


def _difference(experiment: Experiment, rows: Array) -> tuple[float, str]:
    """Return the largest difference, of the largest value of its output, and where it is."""
    expected = np.column_stack(list(experiment.outputs.values()))
    size = np.maximum(np.abs(expected).max(axis=0), np.finfo(float).tiny)
    off = np.nan_to_num(np.abs(rows - expected) / size, nan=np.inf)
    k, j = np.unravel_index(int(np.argmax(off)), off.shape)
    name = plain(list(experiment.outputs)[j])
    text = f"{name} is {rows[k, j]:g} in place of {expected[k, j]:g} at {experiment.t[k]:g} s"
    return float(off[k, j]), text


def _resolved(folder: str, source: str) -> str:
    """Return the member that a place relative to a folder of the archive stands for."""
    return posixpath.normpath(posixpath.join(folder, source))


def _one_line(error: Exception) -> str:
    return plain(" ".join(str(error).split()).rstrip("."), 400)
