"""Run `python simulate.py [closed_loop.toml | plant_loop.toml]`: FMPy and NumPy only."""

import sys
import tomllib
from contextlib import ExitStack
from importlib import import_module, util
from pathlib import Path
from re import findall
from tempfile import TemporaryDirectory

import numpy as np
from fmpy import extract, instantiate_fmu, read_model_description

path = Path(__file__).with_name("closed_loop.toml") if len(sys.argv) < 2 else Path(sys.argv[1])


def fail(message):
    print(f"{path}: {message}", file=sys.stderr)
    sys.exit(2)


if not path.is_file():
    fail("there is no such file.")
system = tomllib.loads(path.read_text(encoding="utf-8"))
step, slaves, variables = system["step"], {}, {}
if (order := system.get("order", "gauss_seidel")) not in ("gauss_seidel", "jacobi"):
    fail(f"order = '{order}' is not one of gauss_seidel, jacobi.")


def end(signal):  # an FMU, and its variables q[1], q[2], .. for q
    name, own = signal.split(".")
    found = [v for v in variables.get(name, ()) if own in (v.name, v.name.split("[")[0])]
    if not found:
        fail(f"there is no variable {signal}.")
    return slaves[name], [v.valueReference for v in found], found


def start(signal, value):  # one value for all elements or one for each; a choice also by its name
    slave, references, [first, *_] = end(signal)
    choices = {name: int(number) for number, name in findall(r"(\d+) = (\w+)", first.description)}
    if first.type == "Integer" and choices:
        number = value if isinstance(value, int) else choices.get(value)
        if number not in choices.values():
            fail(f"{signal} = {value!r} is not one of {', '.join(choices)}.")
        value = number
    if isinstance(value, str) or np.size(value) not in (1, len(references)):
        fail(f"{signal} = {value!r} is not {len(references)} number(s).")
    put = slave.setInteger if first.type == "Integer" else slave.setReal
    put(references, np.broadcast_to(value, len(references)).tolist())


def feed(group):  # sets the inputs of FMUs to the newest outputs, which are all read before
    wires = [(into, source) for into, source in links if into[0] in group]
    values = [source[0].getReal(source[1]) for _, source in wires]
    for ((slave, inputs, _), _), value in zip(wires, values, strict=True):
        slave.setReal(inputs, value)


with ExitStack() as stack:  # frees the FMUs, then removes the folder, also after an error
    folder = stack.enter_context(TemporaryDirectory())
    for part in system["components"]:
        name = part["name"]
        if part.get("step", step) != step:
            fail(f"'{name}' has its own step; only 'hesr simulate' supports that.")
        place = extract(path.parent / part["fmu"], Path(folder, name))
        about = read_model_description(place)
        slave = instantiate_fmu(place, about, "CoSimulation")
        stack.callback(slave.freeInstance)
        slaves[name], variables[name] = slave, about.modelVariables
        slave.setupExperiment()
        for variable, value in part.get("start", {}).items():
            start(f"{name}.{variable}", value)
        slave.enterInitializationMode()
    links = [(end(into), end(out)) for into, out in system["connections"].items()]
    for slave in [*slaves.values()] * len(slaves):  # until the outputs agree
        feed([slave])
    for slave in slaves.values():
        slave.exitInitializationMode()
    # In turn, the arm first, each with the newest outputs, or all with those before the step.
    in_turn = [[slave] for slave in slaves.values()]
    groups = in_turn if order == "gauss_seidel" else [[*slaves.values()]]
    rows, observed = [], [end(signal) for signal in system["observe"]]  # desired, true position
    for k in range(round(system["stop"] / step) + 1):
        for group in groups if k else ():
            feed(group)
            for slave in group:
                slave.doStep((k - 1) * step, step)
        rows.append([k * step, *(x for slave, q, _ in observed for x in slave.getReal(q))])
    for slave in slaves.values():
        slave.terminate()
t, desired, q = np.split(np.array(rows), [1, 1 + len(observed[0][1])], axis=1)
print("RMSE [mrad]:", *np.round(1e3 * np.sqrt(np.mean((desired - q) ** 2, axis=0)), 3))
np.savetxt("tracking.csv", rows, "%.17g", ",", header="t, desired and true q", comments="")
if util.find_spec("matplotlib"):
    lines = import_module("matplotlib.pyplot").plot(t, 1e3 * (desired - q))
    lines[0].figure.savefig("tracking.png")
