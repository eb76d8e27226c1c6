"""Physics checks of laws of known behaviour, run once."""

from pathlib import Path

import pytest
from subjects import INERTIA, bristle, law, model, slip

from fmu_src import model_file
from hesr.extras.properties.battery import Subject, measure
from hesr_model.audit.properties import Properties
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel


def put_to_test(name: str, *laws: FrictionLaw) -> Properties:
    """Run the checks in this process."""
    return measure(Subject(name=name, model=model(*laws), inertia=(INERTIA,)))


@pytest.fixture(scope="session")
def bristles() -> Properties:
    """LuGre with constant level, no viscous friction; LuGre with a level that falls with speed."""
    return put_to_test("lugre", bristle(), bristle(static=12.0, sigma_1=50.0, sigma_2=1.0))


@pytest.fixture(scope="session")
def maps() -> Properties:
    """A torque that jumps with the sign of velocity; a purely viscous one."""
    jumps = law("stribeck", F_c=8.0, F_s=12.0, v_s=0.05, sigma_2=1.0)
    return put_to_test("stribeck", jumps, law("stribeck", v_s=0.1, sigma_2=100.0))


@pytest.fixture(scope="session")
def table_1() -> Properties:
    """The paper's law with the paper's numbers."""
    return measure(Subject(name="table 1", model=FrictionModel.read(model_file("uf850-table1"))))


@pytest.fixture(scope="session")
def slip_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A friction FMU without a law."""
    return slip(tmp_path_factory.mktemp("slip"))
