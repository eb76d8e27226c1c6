"""fmi-sim, the simulator of the Rust library fmi."""

import re
from pathlib import Path

from interop.case import Alone, Run
from interop.engine import (
    SECONDS,
    Engine,
    SkippedError,
    Tools,
    arguments,
    read_signals,
    require_success,
    write_inputs,
)

from fmu_src.run.variables import model_description
from hesr_model.support.process import FailedError, run


def _find(tools: Tools) -> str:
    # It prints the version but still exits with an error.
    answer = run((str(tools.program("fmi-sim")), "--version"), Path.cwd(), SECONDS).stdout
    found = re.search(r"fmi-sim (\d[\w.]*)", answer)
    if found is None:
        raise FailedError(f"fmi-sim does not tell its version but says '{answer[:100]}'")
    return found[1]


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    if any(len(elements) > 1 for elements in case.arrays.values()):
        raise SkippedError("it takes no arrays of several elements")
    units = model_description(case.fmu).unitDefinitions
    if case.fmi == 3 and any(unit.baseUnit and unit.baseUnit.K for unit in units):
        # It expects the name k for kelvin in FMI 3.0.
        raise SkippedError("it reads no units with kelvin in FMI 3.0")
    stop, step, *start = arguments(case)
    command: list[str | Path] = [tools.program("fmi-sim"), "--model", case.fmu.resolve()]
    command += ["-o", "result.csv"]
    if case.inputs:
        write_inputs(case, folder / "inputs.csv")
        command += ["-i", "inputs.csv"]
    command += ["co-simulation", "--output-interval", step, "-f", stop]
    for pair in start:
        command += ["--init-values", pair]
    require_success(command, folder)
    return Run(signals=read_signals(folder / "result.csv", arrays=case.arrays))


FMI_SIM = Engine(
    name="fmi-sim",
    install="cargo install fmi-sim --locked, with the system's libclang",
    find=_find,
    alone=_alone,
)
