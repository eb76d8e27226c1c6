"""The twin's arm as an FMU, behind the interface of the Python arm."""

import numpy as np
from numpy.typing import ArrayLike

from fmu_src.arm.plant import ArmOutput, Plant
from fmu_src.run.fmu import Component
from hesr_model.support.arrays import Array

_TRUE = ("q_true", "dq_true", "tau_true", "tau_f_true")
_MEASURED = ("q", "tau_meas")


class FmuArm:
    """An arm under velocity command, run as an FMU.

    It measures by itself: `measured` is what its noisy outputs say at the instant reached.

    Parameters
    ----------
    component : FMU of the signals in models/uf850/arm.toml, loaded.
    plant : joints, sample rate and noise.
    limits : lowest and highest position (n, 2) [rad].
    """

    def __init__(self, component: Component, plant: Plant, limits: Array) -> None:
        self.plant, self.limits = plant, limits
        self.seed = plant.noise.seed
        self.measured: tuple[Array, Array] = (np.zeros(0), np.zeros(0))
        """Position [rad] and torque [N.m] with their noise, (n,) each."""
        self._component = component
        self._steps = 0
        joints = range(1, len(plant.joints) + 1)
        names = [f"{signal}[{i}]" for signal in (*_TRUE, *_MEASURED) for i in joints]
        self._outputs = component.batch(names)
        self._command = component.batch([f"dq_cmd[{i}]" for i in joints])

    def reset(self, q0: ArrayLike) -> ArmOutput:
        """Put the arm at rest at `q0` (n,) [rad]; see `fmu_src.arm.plant.Arm.reset`."""
        component = self._component
        if component.used:
            component.reset()
        halves = {"noise_seed[1]": self.seed & 0xFFFFFFFF, "noise_seed[2]": self.seed >> 32}
        start = {f"q0[{i}]": float(q) for i, q in enumerate(np.asarray(q0), start=1)}
        noise = {f"{name}[{i}]": sigma
                 for name, sigmas in (("q_noise", self.plant.noise.encoder),
                                      ("tau_meas_noise", self.plant.noise.torque))
                 for i, sigma in enumerate(sigmas, start=1)}  # fmt: skip
        component.initialise(start={**start, **noise, **halves})
        self._steps = 0
        return self._read()

    def step(self, dq_cmd: ArrayLike, dt: float) -> ArmOutput:
        """Hold a velocity command dq_cmd (n,) [rad/s] for `dt` [s]; return what the arm does."""
        self._command.values[:] = dq_cmd
        self._command.write()
        self._component.step(self._steps * dt, dt)
        self._steps += 1
        return self._read()

    def _read(self) -> ArmOutput:
        values = self._outputs.read().reshape(len(_TRUE) + len(_MEASURED), -1).copy()
        q, dq, tau, friction, *measured = values
        self.measured = (measured[0], measured[1])
        return ArmOutput(q=q, dq=dq, tau_meas=tau, tau_f_true=friction)
