"""FMUs from models: a model in, an FMU of FMI 2.0 out."""

from fmu_src.friction.built_in import BUILT_IN, model_file
from fmu_src.friction.export import export_fmu

__all__ = ["BUILT_IN", "export_fmu", "model_file"]
