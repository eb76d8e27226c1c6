"""Dry friction of a model whose level moves, in Python: what `mjcf_losses.h` does in C."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from fmu_src.arm.parts import Loss
from hesr_model.support.arrays import Array

LEAST_LEVEL = 1e-9
"""A joint without any friction has none in MuJoCo's constraints."""


class LossState:
    """Levels [N.m] and ages [s] of losses, which a model is given before each of its steps.

    Parameters
    ----------
    losses : of the model.
    scale : factor on them and on the damping of their joints.
    """

    def __init__(self, losses: Sequence[Loss], scale: float) -> None:
        def column(name: str) -> Array:
            return np.array([getattr(loss, name) for loss in losses], dtype=float)

        self._scale = scale
        self._dof = np.array([loss.dof for loss in losses], dtype=int)
        carrier = np.array([loss.carrier for loss in losses], dtype=int)
        self._carrier = np.maximum(carrier, 0)
        self._load = column("load") * (carrier >= 0)
        self._constant, self._longest = column("constant"), column("longest")
        self._direct, self._speed = column("direct"), column("speed")
        self._evolution, self._age, self._slip = column("evolution"), column("age"), column("slip")
        self.levels: Array = self._constant.copy()
        self.ages: Array = np.zeros(len(self._dof))

    def begin(self, model: Any, data: Any) -> None:
        """Begin at the instant that was evaluated, with contacts that are new."""
        self.ages[:] = 0.0
        self._renew(model, data)

    def advance(self, model: Any, data: Any) -> None:
        """Go on by the step that was made last."""
        rate = np.abs(data.qvel[self._dof]) / self._slip + 1.0 / self._longest
        exponent = -rate * float(model.opt.timestep)
        self.ages = self.ages * np.exp(exponent) - np.expm1(exponent) / rate
        self._renew(model, data)

    def _renew(self, model: Any, data: Any) -> None:
        load = data.qfrc_spring[self._carrier] + data.qfrc_gravcomp[self._carrier]
        speed = np.abs(data.qvel[self._dof])
        self.levels = (
            self._constant
            + self._load * np.abs(load)
            + self._direct * np.log1p(speed / self._speed)
            + self._evolution * np.log1p(self.ages / self._age)
        )
        self.give(model)

    def give(self, model: Any) -> None:
        """Give the levels to a model."""
        model.dof_frictionloss[self._dof] = np.maximum(self._scale * self.levels, LEAST_LEVEL)

    def torque(self, model: Any, data: Any) -> Array:
        """Torque that opposes the motion at the instant that was evaluated last [N.m]."""
        dof = self._dof
        return np.asarray(model.dof_damping[dof] * data.qvel[dof] - data.qfrc_constraint[dof])
