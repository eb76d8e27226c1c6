"""libcosim, the engine of the Open Simulation Platform, by its Python interface."""

from pathlib import Path

from interop.case import Run, Together
from interop.engine import Engine, Tools, given_together, host


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    return host(tools.python("libcosimpy")[0], "run_libcosim.py", given_together(case), folder)


LIBCOSIM = Engine(
    name="libcosim",
    install="pip install libcosimpy",
    find=lambda tools: tools.python("libcosimpy")[1],
    together=_together,
)
