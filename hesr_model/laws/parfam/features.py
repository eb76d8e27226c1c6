"""The hysteresis state of eq. 9 over all rows of a joint, with its derivatives."""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import sympy

from hesr_model.equations.functions import larger, over
from hesr_model.equations.kernel import Kernel, KernelRun
from hesr_model.equations.memory import DT, Discretisation, Relaxation, Slow
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import SETTLING
from hesr_model.laws.parfam.family import FUNCTIONS
from hesr_model.support.arrays import Array

NUMBERS = sympy.symbols("alpha beta c:4 gain theta:4", real=True)  # order of slopes
LARGEST_EXPONENT = 50.0


@cache
def _kernel(g: str | None, discretisation: Discretisation) -> Kernel:
    """Return a candidate's slopes by `NUMBERS`, exact for the sampled h, and its residual."""
    alpha, beta, *c, gain = NUMBERS[:7]
    theta = NUMBERS[7:]
    tau = sympy.Symbol("tau", real=True)
    argument = sympy.Symbol("argument")
    target = sympy.tanh(beta * DQ)
    h = Relaxation(name="h", unit="1", drive=alpha * target, rate=alpha)
    lag = target - h.state
    rise = DQ * (1 - target**2)
    z = alpha * DT
    start_factor = over(z, 1 - sympy.exp(-z), 1)
    if discretisation == "euler":
        start_factor = 1 / (1 - z)
    by_alpha = Slow(name="h_alpha", unit="s", drive=lag * start_factor, rate=alpha)
    by_beta = Relaxation(name="h_beta", unit="rad/s", drive=alpha * rise, rate=alpha)
    x = (sympy.S.One, DQ, h.state, alpha * lag)
    inner = sympy.Add(*(t * expression for t, expression in zip(theta, x, strict=True)))
    if g == "exp":
        inner = -larger(-inner, -LARGEST_EXPONENT)
    unit = sympy.S.Zero
    if g:
        unit = FUNCTIONS[g](argument)
    value = unit.xreplace({argument: inner})
    slope = (gain * unit.diff(argument)).xreplace({argument: inner})
    of_h, of_dh = (a + slope * t for a, t in zip(c[2:], theta[2:], strict=True))
    a = by_alpha.state
    b = by_beta.state
    states = (of_h * a + of_dh * (lag - alpha * a), of_h * b + of_dh * alpha * (rise - b))
    torque = sympy.Add(gain * value, *(k * expression for k, expression in zip(c, x, strict=True)))
    expressions = (*states, *x, value, *(slope * expression for expression in x), torque - tau)
    return Kernel((h, by_alpha, by_beta), NUMBERS, (DQ, tau), expressions, SETTLING)


@dataclass(frozen=True, kw_only=True)
class HysteresisFeatures:
    """Features x = (1, dq, h, dh) of eq. 11 as functions of (alpha, beta)."""

    rows: JointRows
    discretisation: Discretisation

    @property
    def alpha_limit(self) -> float:
        """Upper limit of alpha [1/s]: alpha * step < 1, for Euler at the longest step (eq. 10)."""
        steps = self.rows.dt[~self.rows.begins]
        if self.discretisation == "euler":
            return (1.0 - 1e-9) / float(steps.max())
        return 1.0 / float(np.median(steps))

    def columns(self, alpha: float, beta: float) -> Array:
        """Return the (N, 4) features 1, dq [rad/s], h [1], dh [1/s]."""
        rows = self.rows
        z = alpha * self.rows.dt
        a = 1.0 - z
        if self.discretisation == "exact":
            a = np.exp(-z)
        target = np.tanh(beta * rows.dq)
        h = rows.recurrence(a, (1.0 - a) * target, target)  # h+ = a h + (1 - a) tanh(beta dq)
        columns = np.empty((len(h), 4), order="F")
        columns[:, 0] = 1.0
        columns[:, 1] = rows.dq
        columns[:, 2] = h
        columns[:, 3] = alpha * (target - h)
        return columns

    @cached_property
    def _runs(self) -> dict[str | None, KernelRun]:
        return {}

    def slopes(self, g: str | None) -> KernelRun:
        """Return the run of a candidate's slopes by `NUMBERS` and of its residual, (N, 12)."""
        if g not in self._runs:
            rows = self.rows
            self._runs[g] = KernelRun(
                _kernel(g, self.discretisation),
                (rows.dq, rows.tau),
                rows.dt,
                np.flatnonzero(rows.begins),
                euler=self.discretisation == "euler",
                target=rows.tau,
            )
        return self._runs[g]
