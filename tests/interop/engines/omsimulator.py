"""OMSimulator, by the C interface of its library; it is in no package registry."""

import sys
from ctypes.util import find_library
from pathlib import Path

from interop.case import Run, Together
from interop.engine import (
    HOSTS,
    Engine,
    SkippedError,
    Tools,
    given_together,
    host,
    require_success,
)

from fmu_src.run.master import ExchangeScheme

_HOST = "run_omsimulator.py"


def _library(tools: Tools) -> str:
    own = tools.folder / "lib" / "libOMSimulator.so"
    found = str(own.resolve()) if own.is_file() else find_library("OMSimulator")
    if found is None:
        raise SkippedError("there is no library OMSimulator")
    return found


def _find(tools: Tools) -> str:
    library = _library(tools)
    command = (sys.executable, "-E", "-s", HOSTS / _HOST, "version", library)
    return require_success(command, Path.cwd()).strip()


def _together(tools: Tools, case: Together, folder: Path) -> Run:
    given = given_together(case) | {"library": _library(tools), "system": case.spec.name}
    return host(Path(sys.executable), _HOST, given, folder)


OMSIMULATOR = Engine(
    name="OMSimulator",
    install="build it from its project's sources; its library belongs into FOLDER/lib, or to where "
    "the system's loader looks",
    find=_find,
    together=_together,
    coupling=ExchangeScheme(refreshed="all"),
)
