"""A law on one reference motion in continuous time by SciPy, from SymPy, the FMU and Modelica.

Laws jump or have kinks at reversals, so both are integrated in two pieces.
"""

import ctypes
import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hesr_model.equations.functions import to_numpy_function
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.predict import first_states

COMPILERS = Path(__file__).parents[1] / ".tools/modelica"

SPEED, OMEGA, PHASE = 0.5, 2.0 * np.pi, 0.35
REVERSAL = (np.pi / 2 - PHASE) / OMEGA
"""The motion is dq = SPEED cos(OMEGA t + PHASE)."""
TIMES = np.linspace(0.0, 0.5, 101)
"""None of them is at the reversal, where the torque of some laws jumps."""

MODELICA = """
model Reference
  {block} law;
equation
  law.dq = 0.5*cos(2*3.141592653589793*time + 0.35);
  law.q = 0.5/(2*3.141592653589793)*sin(2*3.141592653589793*time + 0.35);
  law.tau_load = 6 + 4*sin(5*time);
end Reference;
"""
"""The same motion for a block of an exported package."""


def motion(t):
    """Inputs in the order of `INPUTS`."""
    t = np.asarray(t)
    angle = OMEGA * t + PHASE
    load = 6.0 + 4.0 * np.sin(5.0 * t)
    return np.stack([SPEED * np.cos(angle), SPEED / OMEGA * np.sin(angle), load])


def equations(law):
    """Derivatives of the states and torque as functions of the inputs and the states."""
    form, values = law.form, tuple(law.values.values())
    # Passed as arguments: numbers inside an expression are printed with only 15 digits, and the
    # large coefficients of a Dahl basis cancel.
    symbols = (*(c.symbol for c in form.coefficients), *INPUTS)
    states = [s for m in form.memory for s in (m.state, m.derivative)]
    moving = to_numpy_function(
        (*symbols, *(m.state for m in form.memory)),
        tuple(m.express_derivative() for m in form.memory),
    )
    output = to_numpy_function((*symbols, *states), (form.output,))

    def slope(inputs, x):
        return np.array(moving(*values, *inputs, *x), dtype=float)

    def torque(inputs, x):
        return output(*values, *inputs, *np.column_stack([x, slope(inputs, x)]).ravel())[0]

    return slope, torque


def integrated(slope, x, begin, end, times=()):
    """States at `times` and at the end, one row each."""
    inside = np.union1d(times, end)
    if not len(x):
        return np.zeros((len(inside), 0))
    rows = []
    for time in inside:  # values between the steps of a solver are less exact than its steps
        result = solve_ivp(slope, (begin, time), x, "DOP853", rtol=1e-13, atol=1e-16)
        assert result.success, result.message
        begin, x = time, result.y[:, -1]
        rows.append(x)
    return np.array(rows)


def pieces():
    """Start and end of each piece of the motion, and the TIMES within it."""
    for begin, end in ((TIMES[0], REVERSAL), (REVERSAL, TIMES[-1])):
        yield begin, end, TIMES[(begin <= TIMES) & (end >= TIMES)]


def python_torque(law):
    """Torque at TIMES from the SymPy expressions."""
    slope, torque = equations(law)
    x, found = np.array(first_states(law, *motion(0.0))), []
    for begin, end, times in pieces():
        rows = integrated(lambda t, x: slope(motion(t), x), x, begin, end, times)
        found += [torque(motion(t), row) for t, row in zip(times, rows, strict=False)]
        x = rows[-1]
    return np.array(found)


def fmu_torque(fmu, joint, law):
    """Torque of a joint at TIMES, by a solver that gets the derivatives from the FMU.

    Signs are held between events: one event just after the start of each piece sets them.
    """
    inputs = [f"{symbol.name}[{joint}]" for symbol in INPUTS]
    every = [unknown.variable.derivative.name for unknown in fmu.about.derivatives]
    own = [every.index(f"{m.name}[{joint}]") for m in law.form.memory]
    c = fmu.continuous()

    def at(t):
        return dict(zip(inputs, motion(t).tolist(), strict=True))

    def go_to(t, x):
        values = np.zeros(len(every))
        values[own] = x
        assert fmu("SetTime", c, float(t)) == 0
        assert fmu.set_all(c, at(t)) == 0
        array = (ctypes.c_double * len(every))(*values)
        assert fmu("SetContinuousStates", c, array, len(every)) == 0

    def slope(t, x):
        go_to(t, x)
        return np.array(fmu.numbers("GetDerivatives", c, len(every)))[own]

    x, found = np.array(first_states(law, *motion(0.0))), []
    for begin, end, times in pieces():
        fmu.event(c, at(begin + 1e-6))
        rows = integrated(slope, x, begin, end, times)
        for t, row in zip(times, rows, strict=False):
            go_to(t, row)
            found += fmu.get(c, f"tau[{joint}]")
        x = rows[-1]
    return np.array(found)


@contextmanager
def open_compilers(cache: Path) -> Iterator[Callable[[str], ModuleType]]:
    """Give a function that imports a compiler of Modelica, with its cache in a folder."""
    if not (COMPILERS / "version").exists():
        pytest.skip(
            "the Modelica compilers are not there: run `.ci/modelica .tools/modelica` first"
        )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(cache))
        patch.syspath_prepend(str(COMPILERS))
        yield importlib.import_module


def simulate(rumoca, model, times):
    """Results of a compiled model by name at `times`; events add further rows."""
    exact = rumoca.SimConfig(rtol=1e-13, atol=1e-16, solver="rk-like")
    result = model.simulate((0.0, float(times[-1])), dt=float(times[1]), config=exact)
    t = np.array(result.time)
    rows = [int(np.argmin(np.abs(t - instant))) for instant in times]
    assert np.abs(t[rows] - times).max() < 1e-9
    return {name: np.array(result[name])[rows] for name in result.names}


def relative(found, expected):
    """Largest difference relative to the largest torque; that itself without any torque."""
    return np.abs(found - expected).max() / (np.abs(expected).max() or 1.0)
