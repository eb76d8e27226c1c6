"""A system packaged as SSP, run by FMPy's SSP runner."""

import time

from files import case, leave
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import ParameterSet, read_ssd

given = case()
# FMPy reads the parameter sets that an SSP binds to its components but applies none: it expects one
# for the whole system.
everything = ParameterSet()
for component in read_ssd(given["ssp"]).system.elements:
    for binding in component.parameterBindings:
        for parameter_set in binding.parameterValues:
            for parameter in parameter_set.parameters:
                parameter.name = f"{component.name}.{parameter.name}"
                everything.parameters.append(parameter)
begin = time.perf_counter()
result = simulate_ssp(
    given["ssp"],
    # Half a step less, since FMPy accumulates its times and might take an extra step.
    stop_time=(given["steps"] - 0.5) * given["step"],
    step_size=given["step"],
    parameter_set=everything,
)
seconds = time.perf_counter() - begin
names = ["time", *given["signals"]]
leave(given["signals"], zip(*(result[name] for name in names), strict=True), seconds)
