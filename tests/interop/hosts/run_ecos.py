"""A system packaged as SSP, run by ecos."""

import time

from ecospy import EcosSimulation
from files import case, leave

given = case()
names = [signal.replace(".", "::", 1) for signal in given["signals"]]
with EcosSimulation(given["step"], ssp_path=given["ssp"]) as simulation:
    if not simulation.init(parameter_set=given["parameter_set"]):
        raise SystemExit("ecos could not initialise the system")
    rows = [[0.0, *map(simulation.get_real, names)]]
    seconds = 0.0
    for _ in range(given["steps"]):
        begin = time.perf_counter()
        reached = simulation.step()
        seconds += time.perf_counter() - begin
        rows.append([reached, *map(simulation.get_real, names)])
    simulation.terminate()
leave(given["signals"], rows, seconds)
