from fmu_src.friction.built_in import BUILT_IN as BUILT_IN
from fmu_src.friction.built_in import model_file as model_file
from fmu_src.friction.friction_fmu import export_fmu as export_fmu
