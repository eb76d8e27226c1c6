"""Reference results in the folder `extra/` of an FMU or SSP, written and verified.

The files follow the FMI cross-check, the manifest FMI-LS-REF 1.0.0-alpha.1. It leaves the order of
calls open, so all known orders are tried.
"""

import csv
import posixpath
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np

from fmu_src.run.archive import MAX_TEXT_BYTES, Archive
from hesr_model.errors import HesrError, SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.text import sanitise
from hesr_model.support.xml_files import to_bytes

if TYPE_CHECKING:
    from fmu_src.run.fmu import FmuInstance

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
EXPERIMENTS = f"{FOLDER}/experiments.xml"

_LAYER = "http://fmi-standard.org/fmi-ls-manifest"
_MANIFEST_ATTRIBUTES = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": (
        "Layered Standard providing information on related files included in an FMU."
    ),
}

ROWS = 100  # steps of the stimuli
ORDERS: Mapping[str, str] = {
    "hold": "co-simulation: inputs hold over each step, outputs are read after it",
    "shown": "the same, outputs read once the inputs of the next step are set",
    "direct": "inputs of its end are set before a step",
}
"""Orders of setting inputs, stepping and reading outputs; our files use the first two."""

RUNS = (("hold", ORDERS["hold"], "ref"), ("shown", ORDERS["shown"], "shown"))
"""Names, orders and ends of the file names of our runs for co-simulation."""

TOLERANCE = 1e-9  # relative to the largest value: differences between platforms
_DEFAULT_TOLERANCE = 1e-3  # of results that name none
_MAX_ROWS = 100_000
_DECIMALS = 6  # of stimuli
_PHASE = 0.35  # [rad] lead of each input over the one before it

_README = """\
Reference results in the files of the FMI cross-check and FMI-LS-REF: outputs of this FMU's binary
for {platform} at the export, in the units of the variables.

co_simulation/{name}_in.csv, _ref.csv, _ref.opt
    Initialise with the inputs of row 0 and the parameters of {name}_parameters.csv, if present, and
    compare with row 0 of the reference. Then for each row k: set its inputs, step by {step:.9g} s,
    and compare with row k + 1. Inputs hold over the step, without interpolation. RelTol
    {tolerance:g} is relative to the largest value of an output.

co_simulation/{name}_shown.csv
    The same run for tools that read outputs once the inputs of the next step are set: row k holds
    the outputs after step k with the inputs of row k.
"""


@dataclass(frozen=True, kw_only=True)
class ExperimentFiles:
    """CSV files STEM_in and STEM_parameters of experiments at times t [s], and their results.

    Each run has a name, a description of its order of calls, and END in STEM_END, its results.
    """

    runs: Sequence[tuple[str, str, str]]
    t: Array
    step: float  # communication step [s]; 0 if a solver chooses it
    tolerance: float  # relative to the largest value of each output
    stem: str
    parameters: bool = False


@dataclass(frozen=True, kw_only=True)
class Stimuli:
    """Inputs (ROWS + 1,) and parameters of an FMU; others keep their start values."""

    step: float  # communication step [s]
    inputs: Mapping[str, Array] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """Times (ROWS + 1,) [s]."""
        return np.round(self.step * np.arange(ROWS + 1), 12)


def round_stimulus(rows: Array) -> Array:
    """Return inputs with so few digits that files have them exactly."""
    return np.round(rows, _DECIMALS)


def waves(amplitudes: Mapping[str, float], middle: float = 0.0) -> dict[str, Array]:
    """Return a sinusoid (ROWS + 1,) with 1 to 3 periods around `middle` for each name."""
    angle = 2.0 * np.pi * np.arange(ROWS + 1) / ROWS
    return {
        name: round_stimulus(middle + size * np.sin((1 + j % 3) * angle + _PHASE * j))
        for j, (name, size) in enumerate(amplitudes.items())
    }


def result_files(members: Mapping[str, bytes], stimuli: Stimuli) -> dict[str, bytes]:
    """Run an FMU and return its folder `extra/`, empty if it cannot be run."""
    from fmu_src.run.instance import PLATFORM, SUFFIX, VERSIONS  # slow to import

    root = ET.fromstring(members["modelDescription.xml"])
    kind = root.find("CoSimulation")
    assert kind is not None, "no FMU for co-simulation"
    name = kind.get("modelIdentifier", "")
    version = 2
    if root.get("fmiVersion") == "3.0":
        version = 3
    binary_folder = VERSIONS[version].folder
    if f"{binary_folder}{name}{SUFFIX}" not in members:
        return {}
    needed = (binary_folder, "resources/", "modelDescription.xml")
    outputs_by_order: list[dict[str, Array]] = []
    with scratch_folder() as home:
        _write_members(members, needed, home)
        for order, *_ in RUNS:
            outputs = _run(Path(name), home, order, stimuli)
            if outputs is None:
                return {}
            outputs_by_order.append(outputs)
    stem = f"extra/co_simulation/{name}"
    text = _README.format(name=name, platform=PLATFORM, step=stimuli.step, tolerance=TOLERANCE)
    experiment = ExperimentFiles(
        runs=RUNS,
        t=stimuli.t,
        step=stimuli.step,
        tolerance=TOLERANCE,
        stem=stem,
        parameters=bool(stimuli.parameters),
    )
    files = {
        "extra/README.txt": text.encode(),
        **experiment_files(experiment, stimuli.inputs, outputs_by_order),
    }
    if stimuli.parameters:
        row = {parameter: np.array([value]) for parameter, value in stimuli.parameters.items()}
        files[f"{stem}_parameters.csv"] = table(row, 17)
    return files | manifest_files([experiment], files)


def _write_members(members: Mapping[str, bytes], prefixes: tuple[str, ...], home: Path) -> None:
    """Write the members of an FMU whose names begin in one of these ways into a folder."""
    for member, content in members.items():
        if member.startswith(prefixes):
            file = home / member
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content)


def _run(fmu: Path, home: Path, order: str, stimuli: Stimuli) -> dict[str, Array] | None:
    """Return the outputs of an FMU that is unpacked in `home`; None if it fails."""
    from fmu_src.run.fmu import FmuInstance

    try:
        with FmuInstance(fmu, unpacked=home) as instance:
            outputs = _list_outputs(instance)
            rows = play(instance, order, outputs, stimuli.t, **vars(stimuli))
    except SimulationError:
        return None
    if not np.all(np.isfinite(rows)):
        return None
    return dict(zip(outputs, rows.T, strict=True))


def _list_outputs(instance: "FmuInstance") -> list[str]:
    """Return the real outputs of an FMU; those of FMI 2.0 must be continuous."""
    names = []
    for variable in instance.description.modelVariables:
        is_discrete = variable.variability == "discrete" and not instance.declared
        if variable.causality == "output" and variable.type == "Real" and not is_discrete:
            names.append(variable.name)
    return names


def experiment_files(
    experiment: ExperimentFiles,
    inputs: Mapping[str, Array],
    outputs: Iterable[Mapping[str, Array]],
    digits: int = 14,
) -> dict[str, bytes]:
    """Return the files of inputs (N,) and of the outputs (N,) of each run, and the .opt file."""
    files = {
        f"{experiment.stem}_in.csv": table({"time": experiment.t, **inputs}, 12),
        f"{experiment.stem}_ref.opt": _options(experiment),
    }
    for (*_, end), columns in zip(experiment.runs, outputs, strict=True):
        files[f"{experiment.stem}_{end}.csv"] = table({"time": experiment.t, **columns}, digits)
    return dict(sorted(files.items()))


def table(columns: Mapping[str, Array], digits: int) -> bytes:
    """Return a CSV file with `digits` significant digits."""

    def join_numbers(row: Iterable[float]) -> str:
        # Adding zero turns -0 into 0.
        return ",".join(f"{value + 0.0:.{digits}g}" for value in row)

    header = ",".join(f'"{name}"' for name in columns)
    lines = [header]
    lines += map(join_numbers, zip(*(column.tolist() for column in columns.values()), strict=True))
    return "".join(f"{line}\n" for line in lines).encode()


def _options(experiment: ExperimentFiles) -> bytes:
    """Return the .opt file of the FMI cross-check."""
    values = {
        "StartTime": experiment.t[0],
        "StopTime": experiment.t[-1],
        "StepSize": experiment.step,
    }
    if not experiment.step:
        values["OutputIntervalLength"] = experiment.t[1]
    values["RelTol"] = experiment.tolerance
    return "".join(f"{name}, {value:.12g}\n" for name, value in values.items()).encode()


def manifest_files(
    experiments: Sequence[ExperimentFiles], members: Iterable[str]
) -> dict[str, bytes]:
    """Return the manifest and the experiments file of the `members` of `extra/`."""
    root = ET.Element("Experiments")
    for experiment in experiments:
        _add_experiment(root, experiment)
    stimulus_texts = {f"{experiment.stem}_in.csv": "stimuli" for experiment in experiments}
    for experiment in experiments:
        stimulus_texts[f"{experiment.stem}_parameters.csv"] = "parameters of the experiments"
    related = [("experiment/smoke-test", EXPERIMENTS, "application/xml", "how the stimuli are run")]
    for name in members:
        if not name.endswith(".csv"):
            related.append(("document", name, "text/plain", "how to use these files"))
        elif name in stimulus_texts:
            related.append(("testcase", name, "text/csv", stimulus_texts[name]))
        else:
            related.append(("result", name, "text/csv", "reference results"))
    ET.register_namespace("fmi-ls", _LAYER)
    manifest = ET.Element(
        "fmiReferences", {f"{{{_LAYER}}}{k}": text for k, text in _MANIFEST_ATTRIBUTES.items()}
    )
    for role, name, kind, text in related:
        attributes = {"type": kind, "source": posixpath.relpath(name, FOLDER), "role": role}
        ET.SubElement(manifest, "Related", attributes, description=text)
    return {MANIFEST: to_bytes(manifest), EXPERIMENTS: to_bytes(root)}


def _add_experiment(root: ET.Element, experiment: ExperimentFiles) -> None:
    """Add an experiment per run, with the files of its stimuli, parameters and results."""
    numbers = {
        "startTime": experiment.t[0],
        "stopTime": experiment.t[-1],
        "tolerance": experiment.tolerance,
    }
    if experiment.step:
        numbers["stepSize"] = experiment.step
    texts = {name: f"{value:.12g}" for name, value in numbers.items()}
    files = {"Stimuli": "in"}
    if experiment.parameters:
        files["Parameters"] = "parameters"
    for name, description, results in experiment.runs:
        attributes = {"name": name, "description": description} | texts
        element = ET.SubElement(root, "Experiment", attributes)
        for kind, end in (files | {"References": results}).items():
            source = posixpath.relpath(f"{experiment.stem}_{end}.csv", FOLDER)
            ET.SubElement(element, kind, source=source, type="text/csv")


@dataclass(frozen=True)
class Verified:
    """Problems and skipped experiments in sentences; order of calls of each that agrees."""

    problems: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    passed: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class ReferenceExperiment:
    """Inputs and results (N,) at times t (N,) [s], and parameters."""

    name: str  # may be that of an order of calls
    tolerance: float  # relative to the largest value of each output
    t: Array
    inputs: dict[str, Array]
    outputs: dict[str, Array]
    parameters: dict[str, float]


def verify(fmu: Path) -> Verified:
    """Run the experiments in an FMU and compare with its reference results."""
    from fmu_src.run.fmu import FmuInstance

    verification = Verified()
    with Archive(fmu) as archive:
        stored = experiments(archive, verification)
    for experiment in stored:

        def replay(order: str, experiment: ReferenceExperiment = experiment) -> Array:
            with FmuInstance(fmu) as instance:
                return play(
                    instance,
                    order,
                    experiment.outputs,
                    experiment.t,
                    experiment.inputs,
                    experiment.parameters,
                )

        judge_experiment(experiment, ORDERS, replay, verification)
    return verification


def play(
    instance: "FmuInstance",
    order: str,
    outputs: Iterable[str],
    t: Array,
    inputs: Mapping[str, Array],
    parameters: Mapping[str, float],
    step: float | None = None,
) -> Array:
    """Initialise an FMU, run an experiment, and return its outputs (N, outputs).

    The order is one of `ORDERS`, or "linear", as "hold" with the slopes of the inputs. Raises
    SimulationError if the FMU fails.
    """
    rows = np.column_stack([*inputs.values(), t])[:, :-1]
    input_buffer = instance.buffer(list(inputs))
    output_buffer = instance.buffer(list(outputs))
    set_slopes = instance.slopes(list(inputs))
    output_rows = np.empty((len(t), output_buffer.values.size))

    def set_row(k: int) -> None:
        input_buffer.values[:] = rows[k]
        input_buffer.write()

    input_buffer.values[:] = rows[0]
    instance.initialise(time=float(t[0]), start=parameters, inputs=input_buffer)
    output_rows[0] = output_buffer.read()
    for k in range(1, len(t)):
        if order == "direct":
            set_row(k)
        else:
            set_row(k - 1)
        if order == "linear":
            set_slopes((rows[k] - rows[k - 1]) / (t[k] - t[k - 1]))
        instance.step(float(t[k - 1]), step or float(t[k] - t[k - 1]))
        if order == "shown":
            set_row(k)
        output_rows[k] = output_buffer.read()
    return output_rows


def judge_experiment(
    experiment: ReferenceExperiment,
    orders: Iterable[str],
    replay: Callable[[str], Array],
    verification: Verified,
) -> None:
    """Note whether `replay` (N, outputs) gives the results in one order, or the one of its name."""
    name = experiment.name
    worst: list[tuple[float, str]] = []
    if name in orders:
        orders = [name]
    for order in orders:
        try:
            rows = replay(order)
        except HesrError as error:
            verification.problems.append(f"experiment '{name}': {_one_line(error)}.")
            return
        deviation, text = _difference(experiment, rows)
        if deviation <= experiment.tolerance:
            verification.passed[name] = order
            return
        worst.append((deviation, text))
    verification.problems.append(
        f"experiment '{name}': {min(worst)[1]}, more than its tolerance of "
        f"{experiment.tolerance:g} of the largest value."
    )


def _difference(experiment: ReferenceExperiment, rows: Array) -> tuple[float, str]:
    expected = np.column_stack(list(experiment.outputs.values()))
    size = np.maximum(np.abs(expected).max(axis=0), np.finfo(float).tiny)
    deviations = np.nan_to_num(np.abs(rows - expected) / size, nan=np.inf)
    k, j = np.unravel_index(int(np.argmax(deviations)), deviations.shape)
    name = sanitise(list(experiment.outputs)[j])
    text = f"{name} is {rows[k, j]:g} in place of {expected[k, j]:g} at {experiment.t[k]:g} s"
    return float(deviations[k, j]), text


def experiments(archive: Archive, verification: Verified) -> list[ReferenceExperiment]:
    """Return the experiments for co-simulation in an archive; note problems."""
    if MANIFEST not in archive.names:
        verification.skipped.append(f"Reference results: {MANIFEST} is missing.")
        return []
    try:
        return list(_experiments(archive, verification))
    except (ValueError, LookupError, csv.Error, ET.ParseError, HesrError) as error:
        verification.problems.append(f"its reference results cannot be read: {_one_line(error)}.")
        return []


def _experiments(archive: Archive, verification: Verified) -> Iterator[ReferenceExperiment]:
    for related in _xml(archive, MANIFEST).iter("Related"):
        place = _resolve_path(FOLDER, related.get("source", ""))
        if place not in archive.names:
            verification.problems.append(f"{MANIFEST} names '{sanitise(place)}', which is missing.")
            continue
        if related.get("role", "").partition("/")[0] == "experiment":
            for element in _xml(archive, place).iter("Experiment"):
                yield from _experiment(archive, element, posixpath.dirname(place), verification)


def _experiment(
    archive: Archive, element: ET.Element, folder: str, verification: Verified
) -> Iterator[ReferenceExperiment]:
    name = sanitise(element.get("name", ""))
    parts = {part.tag: _resolve_path(folder, part.get("source", "")) for part in element}
    if not {"Stimuli", "References"} <= parts.keys():
        verification.skipped.append(f"Experiment '{name}': it has no stimuli with references.")
        return
    if element.get("stepSize") is None:
        verification.skipped.append(
            f"Experiment '{name}': it has no step size, so it is for a solver."
        )
        return
    stimuli = _table(archive, parts["Stimuli"], needed="time")
    references = _table(archive, parts["References"], needed="time")
    t = stimuli.pop("time")
    if not _are_same_times(t, references.pop("time")):
        verification.skipped.append(f"Experiment '{name}': its results are at other times.")
        return
    row: dict[str, Array] = {}
    if "Parameters" in parts:
        row = _table(archive, parts["Parameters"])
    yield ReferenceExperiment(
        name=name,
        tolerance=float(element.get("tolerance", _DEFAULT_TOLERANCE)),
        t=t,
        inputs=stimuli,
        outputs=references,
        parameters={name: float(value[0]) for name, value in row.items()},
    )


def _are_same_times(t: Array, result_times: Array) -> bool:
    """Return whether times (N,) [s] agree up to the digits of files."""
    if t.shape != result_times.shape:
        return False
    tolerance = 1e-9 * max(1.0, abs(t[-1]))
    return not np.any(np.abs(t - result_times) > tolerance)


def _xml(archive: Archive, name: str) -> ET.Element:
    return ET.fromstring(archive.read(name, MAX_TEXT_BYTES))


def _table(archive: Archive, name: str, needed: str | None = None) -> dict[str, Array]:
    lines = archive.read(name, MAX_TEXT_BYTES).decode("utf-8").splitlines()
    head, *rows = csv.reader(lines[: _MAX_ROWS + 1], skipinitialspace=True)
    columns = np.array([list(map(float, row)) for row in rows]).T
    if columns.shape[:1] != (len(head),) or needed not in (None, *head):
        raise ValueError(f"'{name}' is not a table over 'time'")
    return dict(zip(head, columns, strict=True))


def _resolve_path(folder: str, source: str) -> str:
    return posixpath.normpath(posixpath.join(folder, source))


def _one_line(error: Exception) -> str:
    return sanitise(" ".join(str(error).split()).rstrip("."), 400)
