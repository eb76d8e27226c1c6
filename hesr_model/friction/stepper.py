"""One step of a friction law for many motions at once."""

from functools import lru_cache

import numpy as np

from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.predict import numbers
from hesr_model.support.arrays import Array


@lru_cache(maxsize=256)
def _kernel(form: LawForm, *, own: bool) -> Kernel:
    """Return torque and states; coefficients are numbers if the law's `own`, else inputs."""
    symbols = tuple(c.symbol for c in form.coefficients)
    given, columns = (symbols, INPUTS) if own else ((), (*symbols, *INPUTS))
    states = tuple(m.state for m in form.memory)
    return Kernel(form.memory, given, columns, (form.output, *states), once=True)


class LawStepper:
    """Step a law for W motions at once.

    Parameters
    ----------
    law : the law of one joint.
    values : (C, W) coefficients of each motion, in their units; those of the law by default.
    """

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._kernel = _kernel(law.form, own=values is None)
        self._given = numbers(law) if values is None else np.zeros(0)
        self._values = np.zeros((0, 0)) if values is None else values
        self._euler = law.discretisation == "euler"
        self._table = np.zeros((0, 0))
        self._run: KernelRun | None = None

    def _bind(self, motions: int) -> KernelRun:
        """Allocate a record of two rows for each motion: its state and the step from there."""
        coefficients = len(self._values)
        self._table = np.zeros((1 + coefficients + len(INPUTS), 2 * motions))
        if coefficients:
            self._table[1 : 1 + coefficients] = np.repeat(self._values, 2, axis=1)
        dt, *inputs = self._table
        return self._kernel.over(inputs, dt, range(0, 2 * motions, 2), euler=self._euler)

    def __call__(
        self, dt: Array, dq: Array, q: Array, tau_load: Array, x: Array
    ) -> tuple[Array, Array]:
        """Hold inputs over steps and return torque and states at their end.

        Parameters
        ----------
        dt, dq, q, tau_load : (W,) [s, rad/s, rad, N.m]; dt = 0 reads the torque at `x`.
        x : (m, W) states before the step, in their units.

        Returns
        -------
        (W,) torque [N.m] and (m, W) states.

        Raises
        ------
        SimulationError
            If Euler's step is unstable.
        """
        if self._run is None or self._table.shape[1] != 2 * len(dt):
            self._run = self._bind(len(dt))
        self._table[0, 1::2] = dt
        for row, given in zip(self._table[-len(INPUTS) :], (dq, q, tau_load), strict=True):
            row[1::2] = given
        found = self._run.at(self._given, x, settled=True)[1::2].T.copy()
        return found[0], found[1:]
