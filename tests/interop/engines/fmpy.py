"""FMPy: one FMU by its simulator, a system by its SSP runner."""

from dataclasses import replace
from pathlib import Path

from interop.case import Alone, Run, Together
from interop.engine import Engine, Tools, given_alone, given_together, host

from fmu_src.run.master import ExchangeScheme


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    return host(tools.python("fmpy")[0], "run_fmpy.py", given_alone(case), folder)


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    run = host(tools.python("fmpy")[0], "run_fmpy_ssp.py", given_together(case), folder)
    return replace(run, first=1)  # it records nothing before the first step


FMPY = Engine(
    name="FMPy",
    install="pip install fmpy",
    find=lambda tools: tools.python("fmpy")[1],
    alone=_alone,
    together=_together,
    coupling=ExchangeScheme(first="zero"),
)
