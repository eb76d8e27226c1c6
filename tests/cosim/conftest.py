"""An FMU to run."""

from pathlib import Path

import pytest

from fmu_src import export_fmu, model_file
from hesr_model.artifacts import read_model


@pytest.fixture(scope="session")
def friction_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Friction FMU of Table I."""
    folder = tmp_path_factory.mktemp("friction")
    return export_fmu(read_model(model_file("uf850-table1")), folder / "Friction.fmu")
