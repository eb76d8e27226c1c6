"""The arm stepped by MuJoCo's Python package: reference for its FMUs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from fmu_src.arm.plant import Noise, Plant
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.logs.noise import standard_normal
from hesr_model.robots.mjcf import compile_model
from hesr_model.support.arrays import Array


def torque_error(noise: Noise, counter: ArrayLike) -> Array:
    """Torque noise of samples number `counter` (N,), (N, n) [N.m]."""
    return _draw(noise.seed, 0, noise.torque, counter)


def encoder_error(noise: Noise, counter: ArrayLike) -> Array:
    """Position noise of samples number `counter` (N,), (N, n) [rad]."""
    return _draw(noise.seed, 1, noise.encoder, counter)


def _draw(seed: int, quantity: int, sigma: Sequence[float], counter: ArrayLike) -> Array:
    streams = 2 * np.arange(len(sigma)) + quantity
    rows = np.atleast_1d(np.asarray(counter))[:, None]
    return np.array(sigma) * standard_normal(seed, streams, rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmOutput:
    """State and torques of the arm at one instant, without noise.

    Attributes
    ----------
    q, dq
        (n,) [rad, rad/s].
    tau_meas
        (n,) torque of the servo with gravity compensation [N.m]: rigid body plus friction.
    tau_f_true
        (n,) friction torque [N.m], positive if it opposes positive velocity.
    """

    q: Array
    dq: Array
    tau_meas: Array
    tau_f_true: Array


class Arm:
    """An arm under velocity command, stepped by MuJoCo.

    Parameters
    ----------
    plant
        The MJCF and its names.

    Raises
    ------
    ConfigError
        If the MJCF is missing, cannot be compiled or lacks a part named by `plant`.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._model = compile_model(plant.model)
        self._data = mujoco.MjData(self._model)
        self.timestep = float(self._model.opt.timestep)
        """Step of the simulation [s]; commands are held for a multiple of it."""
        joints = [self._find("joint", name).id for name in plant.joints]
        self._qpos = self._model.jnt_qposadr[joints]
        self._dof = self._model.jnt_dofadr[joints]
        self.limits: Array = self._model.jnt_range[joints]
        """Lowest and highest position (n, 2) [rad]."""
        controls = [
            (self._model.actuator_ctrladr[self._find("actuator", name).id], joint)
            for joint, names in enumerate(plant.servo.commanded)
            for name in names
        ]
        self._control, self._commanded_joint = np.array(controls).reshape(-1, 2).T
        integrals = [self._find("actuator", name).id for name in plant.servo.integral]
        self._integral = self._model.actuator_actadr[integrals]
        self._integral_gain = self._model.actuator_gainprm[integrals, 0]
        sensors = [self._find("sensor", name).id for name in plant.servo.torque]
        self._servo_torque = self._model.sensor_adr[sensors]
        self.steps = 0
        """Steps of `timestep` since the last reset."""
        self.reset(np.zeros(len(plant.joints)))

    def _find(self, kind: str, name: str) -> Any:
        try:
            return getattr(self._model, kind)(name)
        except KeyError as error:
            raise ConfigError(f"{self.plant.model}: has no {kind} '{name}'.") from error

    @property
    def time(self) -> float:
        """Time since the last reset [s], from the step counter."""
        return self.steps * self.timestep

    def reset(self, q0: ArrayLike) -> ArmOutput:
        """Put the arm at rest at `q0` (n,) [rad], in equilibrium, with bristles unloaded.

        Gravity is compensated; the integral part of the servo holds the ripple torque at `q0`.
        """
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._qpos] = q0
        self._data.act[self._integral] = q0
        self.steps = 0
        self._data.act[self._integral] += self._output().tau_f_true / self._integral_gain
        return self._output()

    def step(self, dq_cmd: ArrayLike, dt: float) -> ArmOutput:
        """Hold a velocity command for `dt` and return the state at the end.

        Parameters
        ----------
        dq_cmd
            (n,) [rad/s]; reaches the servo after its latency.
        dt
            A positive integer multiple of `timestep` [s].

        Raises
        ------
        SimulationError
            If `dt` is not such a multiple, or a command is not finite.
        """
        count = round(dt / self.timestep)
        if count < 1 or abs(dt - count * self.timestep) > 1e-6 * self.timestep:
            raise SimulationError(
                f"{self.plant.model}: a step of {dt:g} s is asked for; a positive integer "
                f"multiple of {self.timestep:g} s is needed."
            )
        command = np.asarray(dq_cmd, dtype=float)
        if not np.isfinite(command).all():
            raise SimulationError(
                f"{self.plant.model}: the velocity command at {self.time:g} s is "
                f"{command.tolist()}; finite numbers are needed."
            )
        data = self._data
        data.ctrl[self._control] = command[self._commanded_joint]
        mujoco.mj_step(self._model, data, nstep=count)
        self.steps += count
        return self._output()

    def _output(self) -> ArmOutput:
        """Read the current instant.

        Commands act only through the delay line, so evaluating the forces here depends on the state
        alone and does not change it.
        """
        data = self._data
        mujoco.mj_forward(self._model, data)
        dof = self._dof
        tau_meas = data.sensordata[self._servo_torque] + data.qfrc_gravcomp[dof]
        # All other forces on a joint are friction.
        passive = data.qfrc_actuator[dof] + data.qfrc_passive[dof] - tau_meas
        return ArmOutput(
            q=data.qpos[self._qpos],
            dq=data.qvel[dof],
            tau_meas=tau_meas,
            tau_f_true=-passive,
        )
