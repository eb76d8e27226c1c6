"""The arm as MuJoCo simulates it: rigid body, servo and true friction, all from one MJCF."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationInfo, field_validator

from fmu_src.arm.alternative_plants import Truth, TruthName
from fmu_src.arm.signals import compiled
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.logs.noise import standard_normal
from hesr_model.support.config import Config, RelativePath

Array = NDArray[np.float64]

_TORQUE, _ENCODER = 0, 1


class Servo(Config):
    """Which parts of the MJCF are the servo, one entry per joint.

    Attributes
    ----------
    commanded
        Actuators that take the joint's velocity command.
    integral
        The one of them whose state is the integrated command, a position.
    torque
        Sensors of the servo's torque.
    """

    commanded: tuple[tuple[str, ...], ...]
    integral: tuple[str, ...]
    torque: tuple[str, ...]


class Noise(Config):
    """Measurement noise, normal and independent from sample to sample.

    Attributes
    ----------
    seed
        Of `hesr_model.logs.noise`.
    torque, encoder
        Standard deviations per joint [N.m], [rad].
    """

    seed: int
    torque: tuple[float, ...]
    encoder: tuple[float, ...]

    @field_validator("torque", "encoder")
    @classmethod
    def _not_negative(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        if any(value < 0 for value in values):
            raise ValueError("standard deviations must not be negative")
        return values

    def torque_error(self, counter: ArrayLike) -> Array:
        """Torque noise of samples number `counter` (N,), (N, n) [N.m]."""
        return self._draw(_TORQUE, self.torque, counter)

    def encoder_error(self, counter: ArrayLike) -> Array:
        """Position noise of samples number `counter` (N,), (N, n) [rad]."""
        return self._draw(_ENCODER, self.encoder, counter)

    def _draw(self, quantity: int, sigma: Sequence[float], counter: ArrayLike) -> Array:
        streams = 2 * np.arange(len(sigma)) + quantity
        rows = np.atleast_1d(np.asarray(counter))[:, None]
        return np.array(sigma) * standard_normal(self.seed, streams, rows)


class Plant(Config):
    """What the MJCF does not hold.

    Attributes
    ----------
    model
        The MJCF.
    joints
        From base to tip, in the order of every list here and of every output.
    sample_rate
        Of logs and commands [Hz].
    truths
        Other frictions than that of the MJCF, of which a study may take one.
    """

    model: RelativePath
    joints: tuple[str, ...] = Field(min_length=1)
    sample_rate: float = Field(gt=0)
    servo: Servo
    noise: Noise
    truths: Mapping[TruthName, Truth] = {}

    @field_validator("servo", "noise")
    @classmethod
    def _one_entry_per_joint(cls, table: Config, info: ValidationInfo) -> Config:
        joints = info.data.get("joints", ())
        for key, entries in table:
            if joints and isinstance(entries, tuple) and len(entries) != len(joints):
                raise ValueError(
                    f"{key} has {len(entries)} entries; {len(joints)} are needed, one per joint"
                )
        return table


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmOutput:
    """What the arm does at one instant, without noise.

    Attributes
    ----------
    q, dq
        (n,) [rad, rad/s].
    tau_meas
        (n,) torque of the servo with gravity compensation [N.m]: rigid body plus friction.
    tau_f_true
        (n,) friction torque [N.m], positive where it opposes positive velocity.
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
        The MJCF and the names in it.

    Raises
    ------
    ConfigError
        If the MJCF is missing or cannot be compiled, or lacks a part that `plant` names.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self._model = compiled(plant.model)
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

    def scale_friction(self, coulomb: ArrayLike, viscous: ArrayLike) -> None:
        """Multiply Coulomb and static friction, with its stiffness, and viscous friction.

        Of what the MJCF holds as passive dcmotor actuators, before a run is reset.

        Parameters
        ----------
        coulomb, viscous
            (n,) factors.
        """
        model = self._model
        for name, level, rate in zip(
            self.plant.joints, np.asarray(coulomb), np.asarray(viscous), strict=True
        ):
            joint = model.joint(name).id
            passive = (
                (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_DCMOTOR)
                & (model.actuator_ctrlnum == 0)
                & (model.actuator_trnid[:, 0] == joint)
            )
            for i in np.flatnonzero(passive):
                model.actuator_dynprm[i, 5] *= level  # bristle stiffness
                model.actuator_biasprm[i, 3:5] *= level  # Coulomb and static friction
                model.actuator_damping[i] *= rate

    def reset(self, q0: ArrayLike) -> ArmOutput:
        """Put the arm at rest at `q0` (n,) [rad], in equilibrium, with bristles unloaded.

        Gravity is compensated; what ripple there is at `q0`, the servo's integral holds.
        """
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[self._qpos] = q0
        self._data.act[self._integral] = q0
        self.steps = 0
        self._data.act[self._integral] += self._output().tau_f_true / self._integral_gain
        return self._output()

    def step(self, dq_cmd: ArrayLike, dt: float) -> ArmOutput:
        """Hold a velocity command for `dt` and return what the arm does at the end.

        Parameters
        ----------
        dq_cmd
            (n,) [rad/s]; the servo sees it after its latency.
        dt
            A positive integer multiple of `timestep` [s].

        Raises
        ------
        SimulationError
            If `dt` is no such multiple, or a command is not a finite number.
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
        """Read the instant that has been reached.

        Commands act through the delay line only, so that evaluating the forces here depends on
        the state alone and changes nothing of it.
        """
        data = self._data
        mujoco.mj_forward(self._model, data)
        dof = self._dof
        tau_meas = data.sensordata[self._servo_torque] + data.qfrc_gravcomp[dof]
        # Whatever else acts on a joint is friction.
        passive = data.qfrc_actuator[dof] + data.qfrc_passive[dof] - tau_meas
        return ArmOutput(
            q=data.qpos[self._qpos],
            dq=data.qvel[dof],
            tau_meas=tau_meas,
            tau_f_true=-passive,
        )
