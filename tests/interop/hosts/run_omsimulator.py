"""A system packaged as SSP, run by the library of an installed OMSimulator.

run_omsimulator.py CASE.json         run it
run_omsimulator.py version LIBRARY   print the library's version
"""

import ctypes
import sys
import time
from typing import Any

from files import case, leave

Text = ctypes.c_char_p
_FAILED = 2  # statuses below are "ok" and "warning"


def loaded(path: str) -> ctypes.CDLL:
    """Return the library with its functions declared."""
    library = ctypes.CDLL(path)
    library.oms_getVersion.restype = Text
    library.oms_importFile.argtypes = [Text, ctypes.POINTER(Text)]
    for name in ("setStopTime", "setFixedStepSize"):
        getattr(library, f"oms_{name}").argtypes = [Text, ctypes.c_double]
    for name in ("getReal", "getTime"):
        getattr(library, f"oms_{name}").argtypes = [Text, ctypes.POINTER(ctypes.c_double)]
    library.oms_setResultFile.argtypes = [Text, Text, ctypes.c_int]
    for name in ("setTempDirectory", "instantiate", "initialize", "doStep", "terminate", "delete"):
        getattr(library, f"oms_{name}").argtypes = [Text]
    return library


class Model:
    """A model in OMSimulator; every failing call ends the program."""

    def __init__(self, library: ctypes.CDLL, ssp: str) -> None:
        self._library = library
        name = Text()
        self._require("importFile", ssp.encode(), ctypes.byref(name))
        self.name: bytes = name.value or b""

    def _require(self, function: str, *arguments: Any) -> None:
        status = getattr(self._library, f"oms_{function}")(*arguments)
        if status >= _FAILED:
            raise SystemExit(f"oms_{function} ended with status {status}")

    def do(self, function: str, *arguments: Any) -> None:
        """Call a function of the model."""
        self._require(function, self.name, *arguments)

    def within(self, system: str, function: str, *arguments: Any) -> None:
        """Call a function of one of its systems."""
        self._require(function, self.name + b"." + system.encode(), *arguments)

    def step_to(self, time: float, step: float) -> None:
        """Take one step, which must end at this time [s].

        `oms_stepUntil` would take another one where round-off leaves the sum of all steps below
        the requested time, or a tiny one in older versions.
        """
        self.do("doStep")
        reached = ctypes.c_double()
        self.do("getTime", ctypes.byref(reached))
        if abs(reached.value - time) > 1e-6 * step:
            raise SystemExit(f"oms_doStep ended at {reached.value!r} s instead of {time!r} s")

    def real(self, signal: str) -> float:
        """Return the value of `system.component.variable`."""
        value = ctypes.c_double()
        self.within(signal, "getReal", ctypes.byref(value))
        return value.value


def main() -> None:
    """Run a case."""
    given = case()
    library = loaded(given["library"])
    library.oms_setTempDirectory(b".")
    model = Model(library, given["ssp"])
    system, step, steps = given["system"], given["step"], given["steps"]
    signals = [f"{system}.{signal}" for signal in given["signals"]]
    model.do("setResultFile", b"", 1)
    model.do("setStopTime", step * steps)
    # OMSimulator reads its own annotation only with this way of importing.
    model.within(system, "setFixedStepSize", step)
    model.do("instantiate")
    model.do("initialize")
    rows = [[0.0, *map(model.real, signals)]]
    begin = time.perf_counter()
    for k in range(1, steps + 1):
        model.step_to(k * step, step)
        rows.append([k * step, *map(model.real, signals)])
    seconds = time.perf_counter() - begin
    model.do("terminate")
    model.do("delete")
    leave(given["signals"], rows, seconds)


if __name__ == "__main__":
    if sys.argv[1] == "version":
        sys.stdout.write((loaded(sys.argv[2]).oms_getVersion() or b"").decode())
    else:
        main()
