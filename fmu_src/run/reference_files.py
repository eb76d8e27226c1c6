"""Reference results in the folder `extra/` of an FMU or SSP, and their manifest.

A friction FMU carries results of its law in Python (`friction.reference`), others those of their
binary on the exporting machine. The files follow the FMI cross-check, the manifest FMI-LS-REF
1.0.0-alpha.1; its paths are relative to its folder.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree as ET

import numpy as np

from fmu_src.export.description import to_bytes
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.instance import PLATFORM, SUFFIX, VERSIONS
from fmu_src.run.reference_results import FOLDER, MANIFEST, ReferenceExperiment, play
from hesr_model.errors import SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

EXPERIMENTS = f"{FOLDER}/experiments.xml"

ROWS = 100
"""Number of steps of the stimuli."""

WAYS: Mapping[str, str] = {
    "hold": "co-simulation: inputs hold over each step, outputs are read after it",
    "shown": "the same, outputs read once the inputs of the next step are set",
}
"""Order of setting inputs, stepping and reading outputs, by name of the experiment."""

TOLERANCE = 1e-9
"""Tolerance relative to the largest value of an output: differences between platforms."""

_DECIMALS = 6  # of stimuli, so that files hold the exact inputs
_PHASE = 0.35  # [rad] lead of each input over the one before it

_README = """\
Reference results, in the file style of the FMI cross-check; the manifest of FMI-LS-REF in
org.fmi-standard.fmi-ls-ref/ names them by their roles. They are what this FMU's binary for
{platform} answered when it was exported. Units are those of the variables.

co_simulation/{name}_in.csv, _ref.csv, _ref.opt
    Start with the inputs of row 0 set before the end of the initialisation, and before its
    beginning the parameters of {name}_parameters.csv, where there is such a file; row 0 of the
    reference is read after it. Then for each row k: set its inputs, step by {step:.9g} s, and
    compare with row k + 1 of the reference. Nothing is interpolated: inputs hold over the step.
    RelTol {tolerance:g} is of the largest value of an output.

co_simulation/{name}_shown.csv
    The same run as tools show it that read outputs once the inputs of the next step are set, or
    refresh them then: row k holds the outputs after step k with the inputs of row k.
"""

_LAYER = "http://fmi-standard.org/fmi-ls-manifest"
_ABOUT = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": (
        "Layered Standard providing information on related files included in an FMU."
    ),
}


@dataclass(frozen=True, kw_only=True)
class Stimuli:
    """Inputs (ROWS + 1,) and parameters of an FMU for its reference results, in their units.

    Others keep their start values.
    """

    step: float  # communication step [s]
    inputs: Mapping[str, Array] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """Times (ROWS + 1,) [s]."""
        return np.round(self.step * np.arange(ROWS + 1), 12)


def waves(amplitudes: Mapping[str, float], middle: float = 0.0) -> dict[str, Array]:
    """Return a sinusoid (ROWS + 1,) with 1 to 3 periods around `middle` for each name."""
    angle = 2.0 * np.pi * np.arange(ROWS + 1) / ROWS
    return {
        name: np.round(middle + size * np.sin((1 + j % 3) * angle + _PHASE * j), _DECIMALS)
        for j, (name, size) in enumerate(amplitudes.items())
    }


def result_files(members: Mapping[str, bytes], stimuli: Stimuli) -> dict[str, bytes]:
    """Return the members of the folder `extra/` of an FMU for co-simulation, which is run here.

    The result is empty without a binary for this machine, or if a run fails.
    """
    root = ET.fromstring(members["modelDescription.xml"])
    kind = root.find("CoSimulation")
    assert kind is not None, "no FMU for co-simulation"
    name = kind.get("modelIdentifier", "")
    own = VERSIONS[3 if root.get("fmiVersion") == "3.0" else 2].folder
    if f"{own}{name}{SUFFIX}" not in members:
        return {}
    inputs = dict(stimuli.inputs)
    found = {}
    with scratch_folder() as home:
        for member, content in members.items():
            if member.startswith((own, "resources/", "modelDescription.xml")):
                file = home / member
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        for way in WAYS:
            with FmuInstance(Path(name), unpacked=home) as instance:
                outputs = _outputs(instance)
                experiment = ReferenceExperiment(
                    name=way,
                    tolerance=TOLERANCE,
                    t=stimuli.t,
                    inputs=inputs,
                    outputs=dict.fromkeys(outputs, stimuli.t),
                    parameters=dict(stimuli.parameters),
                    step=stimuli.step,
                )
                try:
                    found[way] = play(instance, experiment, way)
                except SimulationError:
                    return {}
    if not all(np.all(np.isfinite(rows)) for rows in found.values()):
        return {}
    return _files(name, stimuli, outputs, found)


def _outputs(instance: FmuInstance) -> list[str]:
    """Return the Real outputs; those of FMI 2.0 must be continuous."""
    three = bool(instance.declared)
    return [
        v.name
        for v in instance.description.modelVariables
        if v.causality == "output" and v.type == "Real" and (three or v.variability != "discrete")
    ]


def _files(
    name: str, stimuli: Stimuli, outputs: Sequence[str], rows: Mapping[str, Array]
) -> dict[str, bytes]:
    stem, t = f"extra/co_simulation/{name}", stimuli.t
    text = _README.format(name=name, platform=PLATFORM, step=stimuli.step, tolerance=TOLERANCE)
    results = {
        way: {"time": t, **dict(zip(outputs, of_way.T, strict=True))}
        for way, of_way in rows.items()
    }
    files = {
        "extra/README.txt": text.encode(),
        f"{stem}_in.csv": table({"time": t, **stimuli.inputs}, 12),
        f"{stem}_ref.csv": table(results["hold"], 14),
        f"{stem}_ref.opt": options(t, stimuli.step, TOLERANCE),
        f"{stem}_shown.csv": table(results["shown"], 14),
    }
    if stimuli.parameters:
        one = {own: np.array([value]) for own, value in stimuli.parameters.items()}
        files[f"{stem}_parameters.csv"] = table(one, 17)
    experiments = [
        ExperimentFiles(
            name=way,
            description=WAYS[way],
            start=0.0,
            stop=float(t[-1]),
            step=stimuli.step,
            tolerance=TOLERANCE,
            stimuli=f"{stem}_in.csv",
            references=f"{stem}_{file}.csv",
            parameters=f"{stem}_parameters.csv" if stimuli.parameters else "",
        )
        for way, file in (("hold", "ref"), ("shown", "shown"))
    ]
    return files | manifest_files(experiments, files)


def table(columns: Mapping[str, Array], digits: int) -> bytes:
    """Return a CSV file with a quoted header and values of `digits` significant digits."""
    header = ",".join(f'"{name}"' for name in columns)
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    # Adding zero turns -0 into 0.
    lines = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    return "".join(f"{line}\n" for line in (header, *lines)).encode()


def options(t: Array, step: float, tolerance: float) -> bytes:
    """Return an .opt file of the FMI cross-check; a step [s] of 0 means a solver's."""
    values = {"StartTime": t[0], "StopTime": t[-1], "StepSize": step}
    if not step:
        values["OutputIntervalLength"] = t[1]
    lines = [f"{name}, {value:.12g}" for name, value in (values | {"RelTol": tolerance}).items()]
    return ("\n".join(lines) + "\n").encode()


@dataclass(frozen=True, kw_only=True)
class ExperimentFiles:
    """Members of an archive that make up an experiment."""

    name: str
    description: str  # order of calls
    start: float  # [s]
    stop: float  # [s]
    step: float  # communication step [s]; 0 if a solver chooses it
    tolerance: float  # relative to the largest value of each output
    stimuli: str  # CSV file
    references: str  # CSV file
    parameters: str = ""  # CSV file of a single row; empty if all have their start values


def manifest_files(
    experiments: Sequence[ExperimentFiles], members: Mapping[str, bytes]
) -> dict[str, bytes]:
    """Return the manifest and the experiments file by path.

    `members` are the files of the experiments and related ones, such as a README.
    """
    root = ET.Element("Experiments")
    for own in experiments:
        numbers = {"startTime": own.start, "stopTime": own.stop, "tolerance": own.tolerance}
        numbers |= {"stepSize": own.step} if own.step else {}
        texts = {name: f"{value:.12g}" for name, value in numbers.items()}
        about = {"name": own.name, "description": own.description}
        element = ET.SubElement(root, "Experiment", about | texts)
        files = {"Stimuli": own.stimuli, "Parameters": own.parameters}
        files["References"] = own.references
        for kind, file in files.items():
            if file:
                ET.SubElement(element, kind, source=_from_folder(file), type="text/csv")
    played = {e.stimuli: "stimuli" for e in experiments}
    played |= {e.parameters: "parameters of the experiments" for e in experiments if e.parameters}
    own_files = {EXPERIMENTS: to_bytes(root)}
    related = [("experiment/smoke-test", EXPERIMENTS, "application/xml", "how the stimuli are run")]
    for name in members:
        is_table = name.endswith(".csv")
        role = "result" if is_table and name not in played else "document"
        role = "testcase" if name in played else role
        text = played.get(name, "reference results" if is_table else "how to use these files")
        related.append((role, name, "text/csv" if is_table else "text/plain", text))
    return {MANIFEST: _manifest(related, {**members, **own_files}), **own_files}


def _manifest(related: Iterable[tuple[str, ...]], members: Mapping[str, bytes]) -> bytes:
    ET.register_namespace("fmi-ls", _LAYER)
    root = ET.Element("fmiReferences", {f"{{{_LAYER}}}{k}": text for k, text in _ABOUT.items()})
    for role, name, kind, text in related:
        ET.SubElement(
            root,
            "Related",
            type=kind,
            source=_from_folder(name),
            role=role,
            description=text,
            checksum=hashlib.sha3_256(members[name]).hexdigest(),
            checksumType="SHA3-256",
        )
    return to_bytes(root)


def _from_folder(member: str) -> str:
    """Return the path of a member relative to the folder of the manifest."""
    if member.startswith(f"{FOLDER}/"):
        return member.removeprefix(f"{FOLDER}/")
    up = len(PurePosixPath(FOLDER).parts) - 1
    return "../" * up + member.removeprefix("extra/")
