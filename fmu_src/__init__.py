"""FMUs from models: a model in, an FMU of FMI 2.0 out.

Every name is imported when it is first used, so `import fmu_src` takes no time.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fmu_src.friction.built_in import BUILT_IN, model_file
    from fmu_src.friction.friction_fmu import export_fmu

__all__ = ["BUILT_IN", "export_fmu", "model_file"]

_HOMES = {
    "BUILT_IN": "friction.built_in",
    "export_fmu": "friction.friction_fmu",
    "model_file": "friction.built_in",
}

if not TYPE_CHECKING:  # a checker knows the names above, and shall find others missing

    def __getattr__(name: str) -> object:
        """Import a public name where it is first used (PEP 562)."""
        if name not in _HOMES:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        """Names for completion."""
        return sorted(__all__)
