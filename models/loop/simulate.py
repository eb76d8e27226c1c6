"""Run `python simulate.py [closed_loop.toml | plant_loop.toml]`: FMPy and NumPy only."""

import sys
import tomllib
from importlib import import_module, util
from pathlib import Path

import numpy as np
from fmpy import extract, fmi2, read_model_description

path = Path(__file__).with_name("closed_loop.toml") if len(sys.argv) < 2 else Path(sys.argv[1])
system = tomllib.loads(path.read_text(encoding="utf-8"))
step, slaves, variables = system["step"], {}, {}


def end(signal):  # an FMU and the references of q[1], q[2], .. for q
    name, own = signal.split(".")
    found = [v for v in variables[name] if own in (v.name, v.name.split("[")[0])]
    return slaves[name], [v.valueReference for v in found]


def feed(slave):  # sets the inputs of an FMU to the newest outputs of the others
    for (into, inputs), (source, outputs) in links:
        if into is slave:
            slave.setReal(inputs, source.getReal(outputs))


for part in system["components"]:
    name, fmu = part["name"], path.parent / part["fmu"]
    about = read_model_description(fmu)
    kind = about.coSimulation.modelIdentifier
    slave = fmi2.FMU2Slave(guid=about.guid, unzipDirectory=extract(fmu), modelIdentifier=kind)
    slaves[name], variables[name] = slave, about.modelVariables
    slave.instantiate()
    slave.setupExperiment()
    for variable, value in part.get("start", {}).items():
        references = end(f"{name}.{variable}")[1]
        if isinstance(value, str):  # a choice; the description has its number
            text = about.modelVariables[references[0]].description
            slave.setInteger(references, [int(text.split(f" = {value}")[0][-1])])
        else:
            slave.setReal(references, list(np.broadcast_to(value, len(references))))
    slave.enterInitializationMode()
links = [(end(into), end(out)) for into, out in system["connections"].items()]
for slave in [*slaves.values()] * len(slaves):  # until the outputs agree
    feed(slave)
for slave in slaves.values():
    slave.exitInitializationMode()
rows, observed = [], [end(signal) for signal in system["observe"]]  # desired and true position
for k in range(round(system["stop"] / step) + 1):
    for slave in slaves.values() if k else ():  # in turn, the arm first
        feed(slave)
        slave.doStep((k - 1) * step, step)
    rows.append([k * step, *(x for slave, q in observed for x in slave.getReal(q))])
t, desired, q = np.split(np.array(rows), [1, 1 + len(observed[0][1])], axis=1)
print("RMSE [mrad]:", *np.round(1e3 * np.sqrt(np.mean((desired - q) ** 2, axis=0)), 3))
np.savetxt("tracking.csv", rows, "%.17g", ",", header="t, desired and true q", comments="")
if util.find_spec("matplotlib"):
    import_module("matplotlib.pyplot").plot(t, 1e3 * (desired - q))
    import_module("matplotlib.pyplot").savefig("tracking.png")
