"""Engines, one adapter each."""

from interop.engines.casadi import CASADI
from interop.engines.ecos import ECOS
from interop.engines.fmi4j import FMI4J
from interop.engines.fmi_rs import FMI_RS
from interop.engines.fmi_sim import FMI_SIM
from interop.engines.fmpy import FMPY
from interop.engines.libcosim import LIBCOSIM
from interop.engines.maestro import MAESTRO
from interop.engines.omsimulator import OMSIMULATOR
from interop.engines.pyfmi import PYFMI

ENGINES = (FMPY, FMI_SIM, FMI_RS, FMI4J, CASADI, LIBCOSIM, ECOS, MAESTRO, OMSIMULATOR, PYFMI)
