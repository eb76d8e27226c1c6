"""The closed loop without FMI: reference for a co-simulation of the same parts.

Desired motion, rigid-body torque, friction laws, controller and arm are in Python, without the C
code of the FMUs. Quantities independent of measurements are computed for the whole run at once.
"""

from dataclasses import dataclass

import numpy as np
from oracles.arm import Arm, encoder_error, torque_error
from oracles.stepper import Stepper

from cosim.loop.closed_loop import Gains, Scheme, preview
from fmu_src.arm.plant import Plant
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.motions.trajectories import Trajectory
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_ROUNDING = 1e-9  # [s] tolerance of the start of the motion


@dataclass(frozen=True, kw_only=True, eq=False)
class MonolithicLoop:
    """A closed loop of n joints.

    Attributes
    ----------
    plant : the arm.
    robot : its rigid-body model.
    parameters : (P,) of `robot.parameter_names`.
    friction : one law per joint.
    motion : desired motion; the arm starts at rest at its start.
    scheme, gains : of the controller.
    step : period of commands and measurements [s].
    stop : end of the run [s].
    rest : rest before the motion begins [s].
    time_constant : of the filter of measured velocities [s].
    """

    plant: Plant
    robot: Robot
    parameters: Array
    friction: FrictionModel
    motion: Trajectory
    scheme: Scheme
    gains: Gains
    step: float
    stop: float
    rest: float = 0.0
    time_constant: float = 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopResult:
    """Results of a closed loop.

    Attributes
    ----------
    t : (N,) sampling instants [s].
    q_d, q_true : (N, n) desired position, and noise-free position of the arm [rad].
    dq_cmd : (N, n) velocity command from each instant on [rad/s].
    """

    t: Array
    q_d: Array
    q_true: Array
    dq_cmd: Array


def run_loop(loop: MonolithicLoop) -> LoopResult:
    """Run a closed loop: repeatedly measure, command, and hold the command for a step.

    Raises
    ------
    ConfigError
        If the arm's model is missing or lacks a part.
    SimulationError
        If the step is not a multiple of the arm's, a law is unstable at it, or a command is not
        finite.
    """
    count = round(loop.stop / loop.step) + 1
    t = loop.step * np.arange(count, dtype=float)
    q_d = _motion(loop, t)[0]
    noise = loop.plant.noise
    encoder, torque = (e(noise, np.arange(count)) for e in (encoder_error, torque_error))
    desired = _Desired(loop, t)
    controller = _Controller(loop, q_d, desired)
    arm = Arm(loop.plant)
    q_true, dq_cmd = np.empty_like(q_d), np.empty_like(q_d)
    state = arm.reset(q_d[0])
    for k in range(count):
        if k > 0:
            state = arm.step(dq_cmd[k - 1], loop.step)
        q_true[k] = state.q
        dq_cmd[k] = controller.command(k, state.q + encoder[k], state.tau_meas + torque[k])
    return LoopResult(t=t, q_d=q_d, q_true=q_true, dq_cmd=dq_cmd)


def _motion(loop: MonolithicLoop, t: Array) -> tuple[Array, Array, Array]:
    """Position, velocity and acceleration (N, n) at times (N,); the first of them are at rest."""
    q, dq, ddq = loop.motion.sample(np.maximum(t - loop.rest, 0.0))
    moving = (t >= loop.rest - _ROUNDING)[:, None]
    return q, dq * moving, ddq * moving


class _Desired:
    """Velocity and torque of the desired motion, with a lead time.

    Parameters
    ----------
    loop : the loop.
    t : (N,) sampling instants [s].

    Attributes
    ----------
    dq : (N, n) [rad/s].
    """

    def __init__(self, loop: MonolithicLoop, t: Array) -> None:
        self._loop = loop
        ahead = t + preview(loop.scheme, loop.gains, loop.step)
        self._q, self.dq, ddq = _motion(loop, ahead)
        self._rigid = loop.robot.torque(loop.parameters, self._q, self.dq, ddq)
        self._torque: Array | None = None
        if loop.scheme.source == "desired":
            parts = zip(loop.friction.laws, self.dq.T, self._q.T, self._rigid.T, strict=True)
            friction = [predict(law, t=t, dq=v, q=q, tau_load=load) for law, v, q, load in parts]
            self._torque = self._rigid + loop.scheme.friction_gain * np.column_stack(friction)
        self._laws = [Stepper(law) for law in loop.friction.laws]
        self._before: Array | None = None
        self._velocity = np.zeros(self.dq.shape[1])

    def torque(self, k: int, q: Array) -> Array:
        """Return the torque (n,) [N.m] at sample k, with friction of desired or measured motion."""
        if self._torque is not None:
            return np.asarray(self._torque[k])
        loop = self._loop
        dq = self._measured(q)
        dt = loop.step if k > 0 else 0.0
        friction = [
            law.step(dt, dq=float(dq[i]), q=float(self._q[k, i]), tau_load=float(self._rigid[k, i]))
            for i, law in enumerate(self._laws)
        ]
        return np.asarray(self._rigid[k] + loop.scheme.friction_gain * np.array(friction))

    def _measured(self, q: Array) -> Array:
        """Differences of measured positions through a first-order low-pass; zero at first."""
        loop = self._loop
        lag = loop.time_constant if loop.scheme.source == "filtered" else 0.0
        share = 1.0 - np.exp(-loop.step / lag) if lag > 0.0 else 1.0
        if self._before is not None:
            self._velocity = self._velocity + share * (
                (q - self._before) / loop.step - self._velocity
            )
        self._before = q
        return self._velocity


class _Controller:
    """The laws of the Controller FMU's C code, for all joints at once."""

    def __init__(self, loop: MonolithicLoop, q_d: Array, desired: _Desired) -> None:
        self._loop, self._q_d, self._desired = loop, q_d, desired
        gains = loop.gains
        self._fade = np.exp(-gains.decay * np.abs(desired.dq))
        self._Kp, self._Kd, self._Ki = (np.array(g) for g in (gains.Kp, gains.Kd, gains.Ki))
        # A held command acts in the middle of its sample on average.
        self._servo = np.array(gains.Kv) + 0.5 * loop.step * self._Ki
        self._integral: Array | None = None
        self._rest = np.zeros((1, q_d.shape[1]))
        self._error: Array | None = None

    def command(self, k: int, q: Array, tau: Array) -> Array:
        """Return dq_cmd (n,) [rad/s] from the measurements of sample k [rad, N.m]."""
        scheme = self._loop.scheme
        outer = scheme.Kx * (self._q_d[k] - q)
        inner: Array | float = 0.0
        if scheme.compensation == "torque_error":
            inner = self._from_error(k, self._desired.torque(k, q) - tau)
        elif scheme.compensation == "servo_inversion":
            inner = self._through_servo(self._desired.torque(k, q), q)
        return np.asarray(self._desired.dq[k] + inner + outer)

    def _from_error(self, k: int, error: Array) -> Array:
        before = error if self._error is None else self._error
        self._error = error
        rate = (error - before) / self._loop.step
        return np.asarray(self._fade[k] * (self._Kp * error + self._Kd * rate))

    def _through_servo(self, tau_d: Array, q: Array) -> Array:
        loop = self._loop
        gravity = loop.robot.torque(loop.parameters, q[None], self._rest, self._rest)[0]
        wanted = tau_d - gravity
        if self._integral is None:  # at rest the servo's own integral already holds the torque
            self._integral = np.divide(
                wanted, self._Ki, out=np.zeros_like(wanted), where=self._Ki > 0.0
            )
        command = (wanted - self._Ki * self._integral) / self._servo
        self._integral = self._integral + loop.step * command
        return np.asarray(command)
