"""FMUs from models: a model in, an FMI 2.0 co-simulation FMU out."""

from fmu_src.built_in import BUILT_IN, model_file
from fmu_src.package import export_fmu

__all__ = ["BUILT_IN", "export_fmu", "model_file"]
