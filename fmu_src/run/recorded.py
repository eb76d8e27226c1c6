"""Reference results of FMUs that no second implementation computes: their own, as exported.

A friction FMU carries results of its law in Python (`friction.reference`). All others carry what
their binary for the exporting machine answers to stimuli, so that importers and other platforms can
be compared with it. The files follow the FMI cross-check, and FMI-LS-REF names them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

import numpy as np

from fmu_src.run.recording import Recording2, Recording3
from fmu_src.run.reference_manifest import Experiment, manifest_files
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

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
    members : of an FMU for co-simulation, which is run in this process.
    stimuli : for it.
    """
    import fmpy
    from fmpy.fmi1 import FMICallException

    root = ET.fromstring(members["modelDescription.xml"])
    kind = root.find("CoSimulation")
    assert kind is not None, "no FMU for co-simulation"
    name = kind.get("modelIdentifier", "")
    three = root.get("fmiVersion") == "3.0"
    own = f"binaries/{fmpy.platform_tuple if three else fmpy.platform}/"
    if f"{own}{name}{fmpy.sharedLibraryExtension}" not in members:
        return {}
    kind_of = Recording3 if three else Recording2
    with scratch_folder() as home:
        for member, content in members.items():
            if member.startswith((own, "resources/")):
                file = home / member
                file.parent.mkdir(parents=True, exist_ok=True)
                file.write_bytes(content)
        try:
            rows = {}
            for way in WAYS:
                instance = kind_of((root, name, home))
                outputs, rows[way] = instance.outputs, _run(instance, stimuli, way)
        except FMICallException:
            return {}
    if not all(np.all(np.isfinite(found)) for found in rows.values()):
        return {}
    return _files(name, fmpy.platform, stimuli, outputs, rows)


def _run(instance: Recording2 | Recording3, stimuli: Stimuli, way: str) -> Array:
    """Return the outputs (ROWS + 1, outputs) of a fresh instance, which is freed."""
    rows = [
        dict(zip(stimuli.inputs, map(float, row), strict=True))
        for row in zip(*stimuli.inputs.values(), strict=True)
    ] or [{}] * (ROWS + 1)
    names = instance.outputs
    found = np.empty((ROWS + 1, len(names)))
    try:
        instance.begin(stimuli.parameters)
        instance.put(rows[0])
        instance.initialised()
        found[0] = instance.read(names)
        for k, t in enumerate(stimuli.t[:-1].tolist()):
            instance.put(rows[k])
            instance.step(t, stimuli.step)
            if way == "shown":
                instance.put(rows[k + 1])
            found[k + 1] = instance.read(names)
        instance.end()
    finally:
        instance.free()
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
    header = ",".join(f'"{name}"' for name in columns)
    rows = zip(*(c.tolist() for c in columns.values()), strict=True)
    # Adding zero turns a negative zero into a plain one.
    lines = (",".join(f"{value + 0.0:.{digits}g}" for value in row) for row in rows)
    return "".join(f"{line}\n" for line in (header, *lines)).encode()


def options(t: Array, step: float, tolerance: float) -> bytes:
    """Return the text of an .opt file of the FMI cross-check; a step of 0 is that of a solver."""
    values = {"StartTime": t[0], "StopTime": t[-1], "StepSize": step}
    if not step:
        values["OutputIntervalLength"] = t[1]
    lines = [f"{name}, {value:.12g}" for name, value in (values | {"RelTol": tolerance}).items()]
    return ("\n".join(lines) + "\n").encode()
