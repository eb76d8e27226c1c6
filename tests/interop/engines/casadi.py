"""CasADi: model exchange."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from interop.case import Alone, Run
from interop.engine import Engine, SkippedError, Tools, given_alone, host, require_fmi_2

from fmu_src.run.fmu import FmuInstance


def _alone(tools: Tools, case: Alone, folder: Path) -> Run:
    require_fmi_2(case)
    python = tools.python("casadi")[0]
    with FmuInstance(case.fmu) as component:
        about = component.description
    if about.modelExchange is None:
        raise SkippedError("it is for model exchange, the FMU is not")
    if about.numberOfEventIndicators:
        raise SkippedError("it evaluates between events, where the FMU holds its signs")
    if about.derivatives and not _exact(case, about):
        raise SkippedError("the FMU's co-simulation integrates in a way of its own")
    continuous = {u.variable.name for u in about.outputs if u.variable.variability == "continuous"}
    given = given_alone(case)
    given["outputs"] = [name for name in case.outputs if name in continuous]
    run = host(python, "run_casadi.py", given, folder)
    return replace(run, without=set(case.outputs) - continuous)


def _exact(case: Alone, about: Any) -> bool:
    """Whether co-simulation is the exact solution for held inputs, an option of our laws."""
    (choice,) = [v for v in about.modelVariables if v.name == "discretisation"] or [None]
    ours = (about.generationTool or "").startswith("HESR")
    return ours and choice is not None and case.start.get(choice.name, int(choice.start)) == 1


CASADI = Engine(
    name="CasADi",
    install="pip install casadi",
    find=lambda tools: tools.python("casadi")[1],
    alone=_alone,
)
