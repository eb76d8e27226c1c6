"""FMUs to run, alone and as a system."""

from collections.abc import Callable
from pathlib import Path

import fakes as stand_ins
import pytest
from closed_loop import Bench, build
from small_fmus import lag

from cosim.system import SystemSpec
from fmu_src import export_fmu, model_file
from hesr_model.artifacts import read_model


@pytest.fixture(scope="session")
def friction_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Friction FMU of Table I."""
    folder = tmp_path_factory.mktemp("friction")
    return export_fmu(read_model(model_file("uf850-table1")), folder / "Friction.fmu")


@pytest.fixture(scope="session")
def lag_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A first-order lag from u to y, which refuses steps past a time."""
    return lag(tmp_path_factory.mktemp("lag"))


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """The closed loop of the UF850 with the friction of Table I."""
    friction = read_model(model_file("uf850-table1"))
    return build(tmp_path_factory.mktemp("loop"), friction)


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Callable[..., SystemSpec]:
    """Masters make slaves in Python; gives what describes a system of them."""
    stand_ins.install(monkeypatch)
    return stand_ins.system
