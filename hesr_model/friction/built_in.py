"""Published friction models that are shipped with HESR and can be exported by name."""

from collections.abc import Mapping
from pathlib import Path

from hesr_model.support.files import models_folder

BUILT_IN: Mapping[str, str] = {"uf850-table1": "uf850/table1.json"}


def model_file(name_or_path: str) -> Path:
    """Return the file of a built-in model, or the path itself if it is not such a name."""
    if name_or_path in BUILT_IN:
        return models_folder() / BUILT_IN[name_or_path]
    return Path(name_or_path)
