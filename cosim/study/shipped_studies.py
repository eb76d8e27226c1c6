"""Studies that ship with HESR: of measured robots and of the digital twin."""

from pathlib import Path

from hesr_model.support.files import models_folder

DEFAULT = "default"  # of `hesr run` without a study


def find_shipped_studies() -> dict[str, Path]:
    """Return the files of the studies by name: `hesr run NAME`."""
    models = models_folder()
    studies = {path.stem: path for path in sorted((models / "studies").glob("*.toml"))}
    return studies | {path.parent.name: path for path in sorted(models.glob("*/study.toml"))}


def find_measured_studies() -> dict[str, Path]:
    """Return the shipped studies with measured logs by name, which is that of their folder."""
    return {name: path for name, path in find_shipped_studies().items() if path.parent.name == name}
