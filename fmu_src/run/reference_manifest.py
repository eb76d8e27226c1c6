"""The manifest of FMI-LS-REF 1.0.0-alpha.1: which files of an FMU are stimuli and their results.

The layered standard names related files and their roles in `fmi-ls-manifest.xml`; how the stimuli
are to be played says an experiments file beside it. Places in both are relative to their folder.
"""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from xml.etree import ElementTree as ET

from fmu_src.export.description import to_bytes

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
class Experiment:
    """Stimuli of an FMU and what it answers.

    Attributes
    ----------
    name, description : for people; the description says how inputs are handed over.
    start, stop : of the experiment [s].
    step : communication step [s]; 0 where a solver chooses.
    tolerance : of the largest value of each output.
    stimuli, references : members of the archive, CSV.
    parameters : one of a single row, values by name; empty where all are at their start values.
    """

    name: str
    description: str
    start: float
    stop: float
    step: float
    tolerance: float
    stimuli: str
    references: str
    parameters: str = ""


def manifest_files(
    experiments: Sequence[Experiment], members: Mapping[str, bytes]
) -> dict[str, bytes]:
    """Return manifest and experiments file, by their paths in the archive.

    Parameters
    ----------
    experiments : one at least.
    members : content of their files, and of others that belong to them, as a text about them.
    """
    root = ET.Element("Experiments")
    for own in experiments:
        numbers = {"startTime": own.start, "stopTime": own.stop, "tolerance": own.tolerance}
        numbers |= {"stepSize": own.step} if own.step else {}
        texts = {name: f"{value:.12g}" for name, value in numbers.items()}
        about = {"name": own.name, "description": own.description}
        element = ET.SubElement(root, "Experiment", about | texts)
        files = {
            "Stimuli": own.stimuli, "Parameters": own.parameters, "References": own.references,
        }  # fmt: skip
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
    """Return a member's place relative to the manifest's folder."""
    if member.startswith(f"{FOLDER}/"):
        return member.removeprefix(f"{FOLDER}/")
    up = len(PurePosixPath(FOLDER).parts) - 1
    return "../" * up + member.removeprefix("extra/")
