"""OMSimulator, which no package registry has: named here so that nobody has to wonder."""

from cosim.interop.engine import Engine, SkippedError, Tools


def _find(_tools: Tools) -> str:
    raise SkippedError(
        "not tested: its package on PyPI fetches the program from its project's server at "
        "installation, and no registry has it"
    )


OMSIMULATOR = Engine(name="OMSimulator", install="from its project's pages", find=_find)
