"""One FMU for model exchange, evaluated by CasADi and integrated by a Runge-Kutta method.

Inputs are held over each step, as in co-simulation.
"""

import casadi
import numpy as np
from files import case, leave

SUBSTEPS = 64

given = case()
model = casadi.DaeBuilder("model", given["fmu"])
for name, value in given["start"].items():
    model.set(name, value)
rates, outputs = (model.create(kind, ["x", "u"], [kind]) for kind in ("ode", "y"))
chosen = [model.y().index(name) for name in given["outputs"]]
held = np.array(model.start(model.u()))
places = [model.u().index(name) for name in given["inputs"]]
table = np.array(list(given["inputs"].values())).T
state = np.array(model.start(model.x()))
h = given["step"] / SUBSTEPS


def slope(x: np.ndarray) -> np.ndarray:
    """Return the derivatives of the states x, (n,), in their units per second."""
    return np.array(rates(x, held)).ravel()


rows = []
for k, time in enumerate(given["times"]):
    held[places] = table[max(k - 1, 0)]
    for _ in range(SUBSTEPS if k and state.size else 0):
        a = slope(state)
        b = slope(state + 0.5 * h * a)
        c = slope(state + 0.5 * h * b)
        d = slope(state + h * c)
        state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    rows.append([time, *np.array(outputs(state, held)).ravel()[chosen]])
leave(given["outputs"], rows)
