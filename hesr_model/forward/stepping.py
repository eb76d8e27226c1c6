"""One step of a friction law for many motions at once."""

from functools import lru_cache
from typing import Any

import numpy as np

from hesr_model.equations.functions import lowered
from hesr_model.equations.memory import DT, EULER
from hesr_model.equations.over_log import Array
from hesr_model.equations.program import moved, step
from hesr_model.friction.evaluate import numbers
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw, LawForm


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


class LawSteps:
    """Steps a law, W motions at once.

    Parameters
    ----------
    law : the law of one joint.
    values : (C, W) of its coefficients for each motion, in their units; the law's own where not
        given.
    """

    def __init__(self, law: FrictionLaw, values: Array | None = None) -> None:
        self._values = numbers(law) if values is None else tuple(values)
        self._function = _lowered(law.form)
        self._euler = float(law.discretisation == "euler")

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
        torque, *after = self._function(*self._values, dq, q, tau_load, *x, dt, self._euler)
        states = [np.broadcast_to(s, dt.shape) for s in after]
        return np.broadcast_to(torque, dt.shape), np.array(states).reshape(len(x), len(dt))
