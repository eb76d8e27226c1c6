"""Exported packages and the compilers that read them."""

from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from modelica_laws import EVERY, shapes
from modelica_truth import open_compilers
from test_model_exchange import parfam_hx

from hesr.extras.modelica.modelica_package import export_modelica
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel


@pytest.fixture(scope="session")
def compilers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], ModuleType]]:
    """Import a compiler with its cache in a temporary folder."""
    with open_compilers(tmp_path_factory.mktemp("cache")) as import_compiler:
        yield import_compiler


@pytest.fixture(scope="session")
def rumoca(compilers: Callable[[str], ModuleType]) -> Any:
    return compilers("rumoca")


@pytest.fixture(scope="session")
def laws(fitted: dict[str, FrictionLaw], make_law: Callable[[str], FrictionLaw]) -> FrictionModel:
    """A robot whose joints have all laws of `EVERY`."""
    more = {"ripple": parfam_hx(), "shapes": shapes()}
    more |= {"gaussians": make_law("gaussians"), "start": make_law("elements")}
    return FrictionModel(
        law="every",
        robot='a "bench" of C:\\ü',
        joints=EVERY,
        laws=tuple((fitted | more)[name] for name in EVERY),
        sample_time=0.005,
    )


@pytest.fixture(scope="session")
def package(laws: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_modelica(laws, tmp_path_factory.mktemp("modelica") / "Every.mo")
