"""One step of a friction law for many motions at once."""

from contextlib import suppress
from functools import lru_cache
from typing import Any

import numpy as np
import sympy

from hesr_model.equations.functions import lowered
from hesr_model.equations.kernel import Kernel, Rows, kernel_of
from hesr_model.equations.memory import DT, EULER
from hesr_model.equations.program import moved, step
from hesr_model.equations.rows import OutsideError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.predict import numbers
from hesr_model.support.arrays import Array


@lru_cache(maxsize=256)
def _lowered(form: LawForm) -> Any:
    """Return a function of numbers, inputs, states, dt and euler: torque and states after."""
    after = step(form.memory)
    known = dict.fromkeys(after)
    for symbol, expression in after.items():
        known[symbol] = expression.xreplace({s: e for s, e in known.items() if e is not None})
    states = {m.state: known[moved(m)] for m in form.memory}
    rates = {m.derivative: m.continuous().xreplace(states) for m in form.memory}
    torque = form.output.xreplace(states | rates)
    arguments = (*(c.symbol for c in form.coefficients), *INPUTS, *states, DT, EULER)
    return lowered(arguments, (torque, *states.values()))


@lru_cache(maxsize=256)
def _kernel(form: LawForm, *, own: bool) -> Kernel | None:
    """Return the same in C, of rows of inputs; coefficients are the law's own, or rows too."""
    symbols = tuple(c.symbol for c in form.coefficients)
    given, columns = (symbols, INPUTS) if own else ((), (*symbols, *INPUTS))
    states = tuple(m.state for m in form.memory)
    return kernel_of(form.memory, given, columns, (form.output, *states), sympy.S.Zero, once=True)


class LawSteps:
    """Steps a law, W motions at once: in C, or in NumPy where that cannot be had.

    Parameters
    ----------
    law : the law of one joint.
    values : (C, W) of its coefficients for each motion, in their units; the law's own where not
        given.
    """

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._law, self._own = law, values is None
        self._values = numbers(law) if values is None else tuple(values)
        self._given = np.array(self._values if self._own else ())
        self._euler = law.discretisation == "euler"
        self._table = np.zeros((0, 0))
        self._rows: Rows | None = None

    def _bind(self, motions: int) -> None:
        """Make room for as many motions, each a record of two rows: where it is, and a step on."""
        coefficients = 0 if self._own else len(self._values)
        self._table = np.zeros((1 + coefficients + len(INPUTS), 2 * motions))
        if coefficients:
            self._table[1 : 1 + coefficients] = np.repeat(self._values, 2, axis=1)
        kernel = _kernel(self._law.form, own=self._own)
        dt, *inputs = self._table
        firsts = range(0, 2 * motions, 2)
        self._rows = kernel.over(inputs, dt, firsts, euler=self._euler) if kernel else None

    def __call__(
        self, dt: Array, dq: Array, q: Array, tau_load: Array, x: Array
    ) -> tuple[Array, Array]:
        """Hold inputs over steps; return the torque at their end and the states there.

        Parameters
        ----------
        dt, dq, q, tau_load : (W,) [s, rad/s, rad, N.m].
        x : (m, W) states before, in their units.

        Returns
        -------
        (W,) [N.m] and (m, W).
        """
        if self._table.shape[1] != 2 * len(dt):
            self._bind(len(dt))
        if self._rows:
            self._table[0, 1::2] = dt
            for row, given in zip(self._table[-len(INPUTS) :], (dq, q, tau_load), strict=True):
                row[1::2] = given
            with suppress(OutsideError):
                found = self._rows.at(self._given, x, settled=True)[1::2].T.copy()
                return found[0], found[1:]
        function = _lowered(self._law.form)
        torque, *after = function(*self._values, dq, q, tau_load, *x, dt, float(self._euler))
        states = [np.broadcast_to(s, dt.shape) for s in after]
        return np.broadcast_to(torque, dt.shape), np.array(states).reshape(len(x), len(dt))
