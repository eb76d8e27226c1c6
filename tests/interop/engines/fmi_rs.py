"""fmi-rs, a Rust library, in our own host."""

from pathlib import Path

from interop.case import Alone, Run
from interop.engine import (
    Engine,
    Tools,
    arguments,
    read_signals,
    require_success,
    write_inputs,
)

_HOST = "hesr-fmi-rs"


def _find(tools: Tools) -> str:
    return require_success((tools.program(_HOST), "--version"), Path.cwd()).split()[-1]


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    write_inputs(case, folder / "inputs.csv")
    files = (case.fmu.resolve(), "inputs.csv", "result.csv")
    require_success((tools.program(_HOST), str(case.fmi), *files, *arguments(case)), folder)
    return Run(signals=read_signals(folder / "result.csv", arrays=case.arrays))


FMI_RS = Engine(name="fmi-rs", install="make interop, with cargo", find=_find, alone=_alone)
