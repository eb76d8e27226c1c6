"""Exported packages and the compilers that read them."""

import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from modelica_laws import EVERY, shapes
from test_model_exchange import parfam_hx

from hesr.extras.modelica.modelica_package import export_modelica
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

COMPILERS = Path(__file__).parents[3] / ".tools/modelica"


@pytest.fixture(scope="session")
def compilers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], ModuleType]]:
    """Import a compiler with its cache in a temporary folder."""
    if not (COMPILERS / "version").exists():
        pytest.skip(
            "the Modelica compilers are not there: run `.ci/modelica .tools/modelica` first"
        )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        patch.syspath_prepend(str(COMPILERS))
        yield importlib.import_module


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
