"""Manifest of reference results in the folder `extra/`, FMI-LS-REF 1.0.0-alpha.1."""

import posixpath
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from fmu_src.export.description import to_bytes
from hesr_model.support.arrays import Array

FOLDER = "extra/org.fmi-standard.fmi-ls-ref"
MANIFEST = f"{FOLDER}/fmi-ls-manifest.xml"
EXPERIMENTS = f"{FOLDER}/experiments.xml"

_LAYER = "http://fmi-standard.org/fmi-ls-manifest"
_ABOUT = {
    "fmi-ls-name": "org.fmi-standard.fmi-ls-ref",
    "fmi-ls-version": "1.0.0-alpha.1",
    "fmi-ls-description": (
        "Layered Standard providing information on related files included in an FMU."
    ),
}


@dataclass(frozen=True, kw_only=True)
class ExperimentFiles:
    """CSV files STEM_in, STEM_RESULTS and STEM_parameters of an experiment at times t [s]."""

    name: str
    description: str  # order of calls
    t: Array
    step: float  # communication step [s]; 0 if a solver chooses it
    tolerance: float  # relative to the largest value of each output
    stem: str
    results: str
    parameters: bool = False


def manifest_files(
    experiments: Sequence[ExperimentFiles], members: Iterable[str]
) -> dict[str, bytes]:
    """Return the manifest and the experiments file of the `members` of `extra/`."""
    root = ET.Element("Experiments")
    for own in experiments:
        numbers = {"startTime": own.t[0], "stopTime": own.t[-1], "tolerance": own.tolerance}
        numbers |= {"stepSize": own.step} if own.step else {}
        about = {"name": own.name, "description": own.description}
        about |= {name: f"{value:.12g}" for name, value in numbers.items()}
        element = ET.SubElement(root, "Experiment", about)
        files = {"Stimuli": "in"} | ({"Parameters": "parameters"} if own.parameters else {})
        for kind, end in (files | {"References": own.results}).items():
            source = posixpath.relpath(f"{own.stem}_{end}.csv", FOLDER)
            ET.SubElement(element, kind, source=source, type="text/csv")
    played = {f"{own.stem}_in.csv": "stimuli" for own in experiments}
    played |= {f"{own.stem}_parameters.csv": "parameters of the experiments" for own in experiments}
    own_files = {EXPERIMENTS: to_bytes(root)}
    related = [("experiment/smoke-test", EXPERIMENTS, "application/xml", "how the stimuli are run")]
    for name in members:
        if not name.endswith(".csv"):
            related.append(("document", name, "text/plain", "how to use these files"))
        elif name in played:
            related.append(("testcase", name, "text/csv", played[name]))
        else:
            related.append(("result", name, "text/csv", "reference results"))
    return {MANIFEST: _manifest(related), **own_files}


def _manifest(related: Iterable[tuple[str, ...]]) -> bytes:
    ET.register_namespace("fmi-ls", _LAYER)
    root = ET.Element("fmiReferences", {f"{{{_LAYER}}}{k}": text for k, text in _ABOUT.items()})
    for role, name, kind, text in related:
        ET.SubElement(
            root,
            "Related",
            type=kind,
            source=posixpath.relpath(name, FOLDER),
            role=role,
            description=text,
        )
    return to_bytes(root)
