"""The engines, one adapter each."""

from cosim.interop.engines.casadi import CASADI
from cosim.interop.engines.ecos import ECOS
from cosim.interop.engines.fmi4j import FMI4J
from cosim.interop.engines.fmi_rs import FMI_RS
from cosim.interop.engines.fmi_sim import FMI_SIM
from cosim.interop.engines.fmpy import FMPY
from cosim.interop.engines.libcosim import LIBCOSIM
from cosim.interop.engines.maestro import MAESTRO
from cosim.interop.engines.omsimulator import OMSIMULATOR
from cosim.interop.engines.pyfmi import PYFMI

ENGINES = (FMPY, FMI_SIM, FMI_RS, FMI4J, CASADI, LIBCOSIM, ECOS, MAESTRO, OMSIMULATOR, PYFMI)
