"""The friction model that an FMU of ours carries beside its code, for whoever wants to know it."""

import json
import zipfile
from pathlib import Path

from hesr_model.artifacts import model_from_json
from hesr_model.errors import ArtifactError
from hesr_model.friction.model import FrictionModel

EMBEDDED_MODEL = "resources/friction_model.json"
"""Where the model stands in the archive; the FMU itself does not read it."""


def embedded_model(fmu: Path) -> FrictionModel | None:
    """Return the friction model that an FMU carries, or None where it carries none.

    Raises
    ------
    ArtifactError
        If the FMU cannot be read, or the model in it is damaged.
    """
    try:
        with zipfile.ZipFile(fmu) as archive:
            if EMBEDDED_MODEL not in archive.namelist():
                return None
            data = json.loads(archive.read(EMBEDDED_MODEL))
    except FileNotFoundError as error:
        raise ArtifactError(f"{fmu}: no such file.") from error
    except (OSError, zipfile.BadZipFile, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ArtifactError(f"{fmu}: not a readable FMU ({error}).") from error
    return model_from_json(fmu, data)
