"""Export of models as FMUs."""

from typing import TYPE_CHECKING

from hesr_model.support.lazy import lazy

if TYPE_CHECKING:
    from fmu_src.friction.built_in import BUILT_IN, model_file
    from fmu_src.friction.friction_fmu import export_fmu

__all__ = ["BUILT_IN", "export_fmu", "model_file"]

_HOMES = {
    "BUILT_IN": "fmu_src.friction.built_in",
    "export_fmu": "fmu_src.friction.friction_fmu",
    "model_file": "fmu_src.friction.built_in",
}

if not TYPE_CHECKING:  # type checkers know the names above and must report others
    __getattr__, __dir__ = lazy(__name__, _HOMES)
