"""Steps of a friction law for many motions at once."""

from functools import lru_cache

import numpy as np

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.predict import numbers
from hesr_model.support.arrays import Array


@lru_cache(maxsize=256)
def _kernel(form: LawForm, *, own: bool) -> Kernel:
    symbols = tuple(c.symbol for c in form.coefficients)
    given, columns = (symbols, INPUTS) if own else ((), (*symbols, *INPUTS))
    states = tuple(m.state for m in form.memory)
    return Kernel(form.memory, given, columns, (form.output, *states), once=True)


class LawStepper:
    """Step a law for W motions at once, with coefficients `values` (C, W) or those of the law."""

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._kernel = _kernel(law.form, own=values is None)
        self._given = numbers(law) if values is None else np.zeros(0)
        self._values = np.zeros((0, 0)) if values is None else values
        self._euler = law.discretisation == "euler"
        self._table = np.zeros((0, 0))
        self._run: KernelRun | None = None

    def _bind(self, motions: int) -> KernelRun:
        coefficients = len(self._values)
        self._table = np.zeros((1 + coefficients + len(INPUTS), 2 * motions))
        if coefficients:
            self._table[1 : 1 + coefficients] = np.repeat(self._values, 2, axis=1)
        dt, *inputs = self._table
        return KernelRun(self._kernel, inputs, dt, range(0, 2 * motions, 2), euler=self._euler)

    def __call__(
        self, dt: Array, dq: Array, q: Array, tau_load: Array, x: Array
    ) -> tuple[Array, Array]:
        """Hold inputs (W,) in [s, rad/s, rad, N.m] and return torque (W,) [N.m] and states (m, W).

        `x` (m, W) are the states before; dt = 0 reads the torque there.
        """
        if self._run is None or self._table.shape[1] != 2 * len(dt):
            self._run = self._bind(len(dt))
        self._table[0, 1::2] = dt
        for row, given in zip(self._table[-len(INPUTS) :], (dq, q, tau_load), strict=True):
            row[1::2] = given
        found = self._run.at(self._given, x, settled=True)[1::2].T.copy()
        return found[0], found[1:]
