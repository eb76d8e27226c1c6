"""One FMU, run by FMPy."""

import numpy as np
from files import case, leave
from fmpy import simulate_fmu

given = case()
inputs = None
if given["inputs"]:
    names = ["time", *given["inputs"]]
    table = [given["times"], *given["inputs"].values()]
    rows = zip(*table, strict=True)
    inputs = np.array(list(rows), dtype=[(name, np.float64) for name in names])
result = simulate_fmu(
    given["fmu"],
    stop_time=given["stop"],
    output_interval=given["step"],
    start_values=given["start"],
    input=inputs,
    output=given["outputs"],
    fmi_type="CoSimulation",
    use_event_mode=False,
)
columns = ["time", *given["outputs"]]
leave(given["outputs"], zip(*(result[name] for name in columns), strict=True))
