"""The twin's arm over a day, with drifting friction, a payload and collisions.

Coulomb friction is scaled by the levels of its bristles, which keep their stiffness, and viscous
friction by its damping, like the factors of a friction law; both may change at every step.
"""

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from oracles.arm import Arm

from fmu_src.arm.plant import Plant

_LEVELS = [3, 4]
"""Indices of Coulomb and static friction in MuJoCo's bias parameters."""


class DriftingArm(Arm):
    """An arm whose friction and load change while it moves.

    Parameters
    ----------
    plant : as for `Arm`.
    load : body that carries a payload.

    Raises
    ------
    ConfigError
        As for `Arm`, or if the body does not exist.
    """

    def __init__(self, plant: Plant, load: str) -> None:
        super().__init__(plant)
        model = self._model
        self._body = int(self._find("body", load).id)
        self._mass = float(model.body_mass[self._body])
        passive = (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR) & (
            np.asarray(model.actuator_ctrlnum) == 0
        )
        self._elements = np.flatnonzero(passive)
        dof = model.jnt_dofadr[model.actuator_trnid[self._elements, 0]]
        self._of = np.array([list(self._dof).index(d) for d in dof])
        self._levels = model.actuator_biasprm[self._elements][:, _LEVELS].copy()
        self._damping = model.actuator_damping[self._elements].copy()

    def scale(self, coulomb: ArrayLike, viscous: ArrayLike) -> None:
        """Scale Coulomb and viscous friction of each joint, (n,) relative to the arm's own."""
        level = np.asarray(coulomb, dtype=float)[self._of]
        model = self._model
        for k, element in enumerate(self._elements):
            model.actuator_biasprm[element, _LEVELS] = level[k] * self._levels[k]
        model.actuator_damping[self._elements] = (
            np.asarray(viscous, dtype=float)[self._of] * self._damping
        )

    def load(self, mass: float) -> None:
        """Carry a payload of the given mass [kg] at the body's centre."""
        self._model.body_mass[self._body] = self._mass + mass
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def push(self, torque: ArrayLike) -> None:
        """Apply external torques (n,) [N.m] to the joints until the next call."""
        self._data.qfrc_applied[self._dof] = torque
