"""A robot whose joints have all laws, and its FMU, as reference for code files."""

from pathlib import Path

import pytest
from one_file_laws import maxwell_slip

from fmu_src.friction.friction_fmu import export_bare
from hesr_model.friction.model import FrictionModel


@pytest.fixture(scope="session")
def every_model(every_law, make_model) -> FrictionModel:
    """A robot with a joint for every law, including relaxations and stops."""
    return make_model(*every_law.values(), maxwell_slip())


@pytest.fixture(scope="session")
def every_fmu(every_model, shared) -> Path:
    return shared("every_fmu", lambda to: export_bare(every_model, to / "F.fmu")) / "F.fmu"
