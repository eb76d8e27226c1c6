from fmu_src.friction.friction_fmu import export_fmu as export_fmu
from hesr_model.friction.built_in import BUILT_IN as BUILT_IN
from hesr_model.friction.built_in import model_file as model_file
