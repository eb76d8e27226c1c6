"""The friction model in an FMU of HESR, as data next to its code."""

import json
from pathlib import Path

from fmu_src.run.archive import MAX_TEXT_BYTES, Archive
from hesr_model.errors import ArtifactError
from hesr_model.friction.model import FrictionModel
from hesr_model.support.text import parse_json

EMBEDDED_MODEL = "resources/friction_model.json"
"""Name of the model in the archive; the FMU itself does not read it."""


def embed_model(model: FrictionModel) -> dict[str, bytes]:
    """Return the archive member that contains the model, by its name."""
    return {EMBEDDED_MODEL: (json.dumps(model.to_json(), indent=2) + "\n").encode()}


def read_embedded_model(fmu: Path) -> FrictionModel | None:
    """Return the friction model in an FMU, or None; ArtifactError if it is damaged."""
    with Archive(fmu) as archive:
        if EMBEDDED_MODEL not in archive.names:
            return None
        text = archive.read(EMBEDDED_MODEL, MAX_TEXT_BYTES)
    try:
        data = parse_json(text)
    except ValueError as error:
        raise ArtifactError(f"{fmu}: its {EMBEDDED_MODEL} is damaged ({error}).") from error
    return FrictionModel.from_json(data, fmu)
