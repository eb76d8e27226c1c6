"""A law run step by step, as in a controller."""

from collections.abc import Sequence

import numpy as np

from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import LawStepper, first_states


class Stepper:
    """Step one motion of a law.

    Parameters
    ----------
    law : the law of one joint.
    start : initial states; by default `first_states` of the inputs of the first step.

    Attributes
    ----------
    x : states; empty before the first step unless given.
    """

    def __init__(self, law: FrictionLaw, start: Sequence[float] | None = None) -> None:
        self._law, self._step = law, LawStepper(law)
        self.x = list(start or ())

    def step(self, dt: float, dq: float, q: float = 0.0, tau_load: float = 0.0) -> float:
        """Hold the inputs over dt [s] and return the torque at its end [N.m]."""
        if not self.x:
            self.x = list(first_states(self._law, dq, q, tau_load))
        row = (np.array([float(u)]) for u in (dt, dq, q, tau_load))
        torque, states = self._step(*row, np.array(self.x).reshape(-1, 1))
        self.x = states[:, 0].tolist()
        return float(torque[0])
