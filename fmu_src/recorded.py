"""Reference results of FMUs that no second implementation computes: their own, as exported.

A friction FMU carries results of its law in Python (`friction.reference`). All others carry what
their binary for the exporting machine answers to stimuli, so that importers and other platforms can
be compared with it. The files follow the FMI cross-check, and FMI-LS-REF names them.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from fmu_src.layered import Experiment, manifest_files
from hesr_model.support.files import scratch_folder

Array = NDArray[np.float64]

ROWS = 100
"""Steps of the stimuli."""

WAYS: Mapping[str, str] = {
    "hold": "co-simulation: inputs hold over each step, outputs are read after it",
    "shown": "the same, outputs read once the inputs of the next step are set",
}
"""How inputs are handed over and outputs read, by the name of the experiment."""

TOLERANCE = 1e-9
"""Of the largest value of an output: what the libraries of platforms leave between them."""

_DECIMALS = 6  # of stimuli, so that a file holds what was run
_PHASE = 0.35  # [rad] by which each input leads the one before it

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


@dataclass(frozen=True, kw_only=True)
class Stimuli:
    """What an FMU is run with for its reference results.

    Attributes
    ----------
    step : communication step [s].
    inputs : (ROWS + 1,) each, by name and in its unit; others stay at their start values.
    parameters : that are not at their start values, an Integer as its number.
    """

    step: float
    inputs: Mapping[str, Array] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def t(self) -> Array:
        """Times (ROWS + 1,) [s]."""
        return np.round(self.step * np.arange(ROWS + 1), 12)


def waves(amplitudes: Mapping[str, float], middle: float = 0.0) -> dict[str, Array]:
    """Return a sinusoid (ROWS + 1,) around `middle` for each name, one period of it or more."""
    angle = 2.0 * np.pi * np.arange(ROWS + 1) / ROWS
    return {
        name: np.round(middle + size * np.sin((1 + j % 3) * angle + _PHASE * j), _DECIMALS)
        for j, (name, size) in enumerate(amplitudes.items())
    }


def result_files(members: Mapping[str, bytes], stimuli: Stimuli) -> dict[str, bytes]:
    """Return the members of an FMU's folder `extra/`.

    There are none without a binary for this machine, or where a run fails.

    Parameters
    ----------
    members : of an FMU of FMI 2.0 for co-simulation, which is run in this process.
    stimuli : for it.
    """
    import fmpy
    from fmpy.fmi1 import FMICallException

    root = ET.fromstring(members["modelDescription.xml"])
    kind = root.find("CoSimulation")
    assert kind is not None, "no FMU for co-simulation"
    name = kind.get("modelIdentifier", "")
    own = f"binaries/{fmpy.platform}/"
    if f"{own}{name}{fmpy.sharedLibraryExtension}" not in members:
        return {}
    outputs = [
        v.get("name", "")
        for v in root.iter("ScalarVariable")
        if v.get("causality") == "output" and v.get("variability") != "discrete"
    ]
    with scratch_folder() as home:
        for member, content in members.items():
            if member.startswith((own, "resources/")):
                file = home / member
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        try:
            rows = {way: _run(home, root, name, stimuli, outputs, way) for way in WAYS}
        except FMICallException:
            return {}
    if not all(np.all(np.isfinite(found)) for found in rows.values()):
        return {}
    return _files(name, fmpy.platform, stimuli, outputs, rows)


def _run(
    home: Path, root: ET.Element, identifier: str, stimuli: Stimuli, outputs: Sequence[str],
    way: str,
) -> Array:  # fmt: skip
    """Return the outputs (ROWS + 1, outputs) of an FMU that is unpacked in a folder."""
    from fmpy.fmi2 import (
        FMU2Slave,
        defaultCallbacks,
        fmi2CallbackFunctions,
        fmi2CallbackLoggerTYPE,
    )

    variables = {v.get("name", ""): v for v in root.iter("ScalarVariable")}

    def references(names: Sequence[str]) -> list[int]:
        return [int(variables[n].get("valueReference", "")) for n in names]

    with chdir(home):  # FMPy changes it, and leaves it so where loading fails
        slave: Any = FMU2Slave(
            guid=root.get("guid"),
            modelIdentifier=identifier,
            unzipDirectory=str(home),
            instanceName=identifier,
        )
    inputs, read = references([*stimuli.inputs]), references(outputs)
    columns = np.column_stack([*stimuli.inputs.values(), stimuli.t])[:, :-1]
    found = np.empty((ROWS + 1, len(outputs)))
    callbacks = fmi2CallbackFunctions()
    callbacks.logger = fmi2CallbackLoggerTYPE(lambda *_: None)
    callbacks.allocateMemory = defaultCallbacks.allocateMemory
    callbacks.freeMemory = defaultCallbacks.freeMemory
    slave.instantiate(callbacks=callbacks)
    try:
        for name, value in stimuli.parameters.items():
            integer = variables[name].find("Integer") is not None
            put = slave.setInteger if integer else slave.setReal
            put(references([name]), [int(value) if integer else value])
        slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.setReal(inputs, columns[0].tolist())
        slave.exitInitializationMode()
        found[0] = slave.getReal(read)
        for k, t in enumerate(stimuli.t[:-1].tolist()):
            slave.setReal(inputs, columns[k].tolist())
            slave.doStep(currentCommunicationPoint=t, communicationStepSize=stimuli.step)
            if way == "shown":
                slave.setReal(inputs, columns[k + 1].tolist())
            found[k + 1] = slave.getReal(read)
        slave.terminate()
    finally:
        slave.freeInstance()
    return found


def _files(
    name: str, platform: str, stimuli: Stimuli, outputs: Sequence[str], rows: Mapping[str, Array]
) -> dict[str, bytes]:
    stem, t = f"extra/co_simulation/{name}", stimuli.t
    text = _README.format(name=name, platform=platform, step=stimuli.step, tolerance=TOLERANCE)
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
        Experiment(
            name=way, description=WAYS[way], start=0.0, stop=float(t[-1]), step=stimuli.step,
            tolerance=TOLERANCE, stimuli=f"{stem}_in.csv", references=f"{stem}_{file}.csv",
            parameters=f"{stem}_parameters.csv" if stimuli.parameters else "",
        )
        for way, file in (("hold", "ref"), ("shown", "shown"))
    ]  # fmt: skip
    return files | manifest_files(experiments, files)


def table(columns: Mapping[str, Array], digits: int) -> bytes:
    """Return a CSV with a header in quotes, each value with so many significant digits."""
    return "".join(f"{line}\n" for line in _lines(columns, digits)).encode()


def _lines(columns: Mapping[str, Array], digits: int) -> Iterator[str]:
    yield ",".join(f'"{name}"' for name in columns)
    for row in zip(*(c.tolist() for c in columns.values()), strict=True):
        # Adding zero turns a negative zero into a plain one.
        yield ",".join(f"{value + 0.0:.{digits}g}" for value in row)


def options(t: Array, step: float, tolerance: float) -> bytes:
    """Return the text of an .opt file of the FMI cross-check; a step of 0 is that of a solver."""
    values = {"StartTime": t[0], "StopTime": t[-1], "StepSize": step}
    if not step:
        values["OutputIntervalLength"] = t[1]
    lines = [f"{name}, {value:.12g}" for name, value in (values | {"RelTol": tolerance}).items()]
    return ("\n".join(lines) + "\n").encode()
