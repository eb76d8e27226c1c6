"""Causal first-order low pass, as memory of equations and over whole logs."""

from functools import cache

import numpy as np
import sympy

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import Prompt
from hesr_model.support.arrays import Array

_INPUT = sympy.Symbol("u", real=True)
_CUTOFF = sympy.Symbol("cutoff", real=True)


def build_low_pass(signal: sympy.Symbol, cutoff: sympy.Expr | float, unit: str) -> Prompt:
    """Return x' = w (u - x), w = 2 pi cutoff [Hz], which begins at u."""
    rate = 2 * sympy.pi.evalf(20) * cutoff
    return Prompt(name=f"{signal.name}_filtered", unit=unit, drive=rate * signal, rate=rate)


@cache
def _kernel() -> Kernel:
    element = build_low_pass(_INPUT, _CUTOFF, "1")
    return Kernel((element,), (_CUTOFF,), (_INPUT,), (element.state,), once=True)


def low_pass_signals(t: Array, values: Array, cutoff: float) -> Array:
    """Return signals (N, n) at the times t (N,) [s] behind a low pass with a cutoff [Hz]."""
    dt = np.diff(t, prepend=t[0])
    columns = [KernelRun(_kernel(), [u], dt).evaluate(np.array([cutoff]))[:, 0] for u in values.T]
    return np.column_stack(columns)
