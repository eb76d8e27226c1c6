"""PyFMI, by its calls for one FMU and its Master for several; no registry has binaries of it."""

from pathlib import Path

from interop.case import Alone, Run, Together
from interop.engine import Engine, Tools, given_alone, given_together, host, require_fmi_2

from fmu_src.run.master import ExchangeScheme

_HOST = "run_pyfmi.py"


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    require_fmi_2(case)
    return host(tools.python("pyfmi")[0], _HOST, given_alone(case), folder)


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    python, wiring = tools.python("pyfmi")[0], case.wiring()
    system = {
        "components": {
            c.name: [str(c.fmu.resolve()), wiring.start[c.name]] for c in case.spec.components
        },
        "connections": [[*out, *into] for into, out in wiring.sources.items()],
    }
    return host(python, _HOST, given_together(case) | system, folder)


PYFMI = Engine(
    name="PyFMI",
    install="conda install -c conda-forge pyfmi",
    find=lambda tools: tools.python("pyfmi")[1],
    alone=_alone,
    together=_together,
    coupling=ExchangeScheme(refreshed="shown"),
)
