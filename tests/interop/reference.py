"""Expected results of an engine: our run of the same FMUs with the engine's exchange scheme."""

from dataclasses import replace

import numpy as np
from interop.case import Alone, Together

from cosim.systems.simulation import Master
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.master import ExchangeScheme
from fmu_src.run.native import step_rows
from hesr_model.support.arrays import Array


def alone(case: Alone) -> dict[str, Array]:
    """Return the outputs of one FMU, (steps + 1,) each in its unit."""
    found = np.empty((case.steps + 1, len(case.outputs)))
    with FmuInstance(case.fmu) as component:
        inputs, outputs = component.buffer(list(case.inputs)), component.buffer(list(case.outputs))
        rows = np.column_stack([*case.inputs.values(), np.zeros(case.steps + 1)])[:, :-1]
        inputs.values[:] = rows[0]
        component.initialise(stop=case.stop, start=case.start, inputs=inputs)
        found[0] = outputs.read()
        times, sizes = case.times[:-1], np.full(case.steps, case.step)
        found[1:] = step_rows(component, inputs, outputs, times, sizes, rows[:-1])
    return dict(zip(case.outputs, found.T, strict=True))


def together(case: Together, scheme: ExchangeScheme) -> dict[str, Array]:
    """Return the signals of a system, (steps + 1,) each in its unit.

    All engines step all FMUs with the inputs at the start of the step (Jacobi).
    """
    spec = case.spec.model_copy(update={"observe": tuple(case.signals), "limits": {}})
    with Master(spec, scheme=replace(scheme, order="jacobi")) as master:
        return master.run().require_success().signals
