"""Velocities derived from positions, and torques of the model."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hesr_model.errors import LogError
from hesr_model.inference.covariance import standard_errors
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.identification import LEAST_PEAK
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array, Mask, some_rows

LEAST_TRAVEL = 5e-3  # minimum travel of a moving joint [rad or m]
_ROWS = 4000  # per log
_KNEE = 0.1  # smoothing speed of a sign [rad/s, m/s], at most a quarter of the peak


@dataclass(frozen=True, kw_only=True, eq=False)
class Motionwise:
    """Smoothed part of a log, (N, n); `v`, `a` are derivatives of q, `dq` was logged."""

    log: Log
    t: Array
    q: Array
    v: Array
    a: Array
    dq: Array | None
    tau: Array

    @cached_property
    def moves(self) -> Mask:
        """Joints (n,) that move."""
        speed = np.max(np.abs(self.v), axis=0)
        return np.asarray((np.ptp(self.q, axis=0) > LEAST_TRAVEL) & (speed > LEAST_PEAK))

    @property
    def period(self) -> float:
        """Median time between rows [s]."""
        return float(np.median(np.diff(self.t)))

    def thinned(self, rows: int) -> "Motionwise":
        """Return at most `rows` rows, evenly spread."""
        return some_rows(self, slice(None, None, -(-len(self.t) // rows)))


def motionwise(log: Log, cutoff: float) -> list[Motionwise]:
    """Smooth the parts of a log that are long enough."""
    made = []
    for part in log.parts():
        try:
            derived = smooth(replace(part, dq=None), cutoff)
        except LogError:
            if len(log.gaps):
                continue
            raise
        dq = None if part.dq is None else smooth(part, cutoff).dq
        whole = Motionwise(
            log=part, t=part.t, q=derived.q, v=derived.dq, a=derived.ddq, dq=dq, tau=part.tau
        )
        made.append(whole.thinned(_ROWS))
    return made


@dataclass(frozen=True, kw_only=True, eq=False)
class Torques:
    """Model torques along a motion (N, n); gravity without its mean."""

    gravity: Array
    inertial: Array

    @classmethod
    def of(cls, robot: Robot, q: Array, v: Array, a: Array) -> "Torques":
        """Evaluate the model file along q, v, a (N, n)."""
        nothing = np.zeros_like(q)
        gravity = robot.torque(robot.nominal_parameters, q, nothing, nothing)
        whole = robot.torque(robot.nominal_parameters, q, v, a)
        return cls(gravity=gravity - gravity.mean(axis=0), inertial=whole - gravity)

    def at(self, coupling: Coupling) -> "Torques":
        """Transform torques of joints to coupled coordinates."""
        return Torques(
            gravity=coupling.torque(self.gravity), inertial=coupling.torque(self.inertial)
        )


def to_logged_side(
    motion: Motionwise, torques: Torques, coupling: Coupling | None
) -> tuple[Motionwise, Torques]:
    """Transform velocities and torques to motors if logged."""
    if coupling is None:
        return motion, torques
    at_motors = replace(motion, v=coupling.motion(motion.v), tau=coupling.torque(motion.tau))
    return at_motors, torques.at(coupling)


def rubbing(v: Array) -> Array:
    """Return Coulomb and viscous friction over `v`, equally weighted."""
    peak = float(np.max(np.abs(v))) or 1.0
    return np.asarray(np.tanh(v / min(_KNEE, 0.25 * peak)) + v / peak)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A coefficient and its standard error, corrected for autocorrelation."""

    value: float
    error: float

    @property
    def t(self) -> float:
        """The coefficient in standard errors."""
        return self.value / max(self.error, 1e-300)


@dataclass(frozen=True, kw_only=True)
class JointTorque:
    """Regression of a joint's torque: gravity and inertia over the model's, the others in [N.m]."""

    gravity: Estimate
    inertia: Estimate
    friction: Estimate
    gravity_size: float
    friction_size: float
    residual: float
    deviation: float

    @property
    def r2(self) -> float:
        """Explained share of the torque's variance."""
        return 1.0 - (self.residual / max(self.deviation, 1e-300)) ** 2

    @property
    def bears_gravity(self) -> bool:
        """Whether gravity is well above the residual."""
        size = self.gravity_size * max(1.0, abs(self.gravity.value))
        return self.gravity_size > 1e-6 and size > 2.0 * self.residual


def explain(tau: Array, gravity: Array, inertial: Array, v: Array) -> JointTorque:
    """Regress `tau` (N,) on `gravity`, `inertial` and friction over `v`."""
    shape = rubbing(v)
    columns = np.column_stack([gravity, inertial, shape, np.ones_like(v)])
    size = np.linalg.norm(columns, axis=0) / np.sqrt(len(v))
    used = size > 1e-9 * size.max()  # that of the offset is 1
    x = np.zeros(4)
    x[used] = np.linalg.lstsq(columns[:, used], tau, rcond=None)[0]
    residual = tau - columns @ x
    errors = np.full(4, np.inf)
    errors[used] = standard_errors(columns[:, used], residual)
    found = [Estimate(value=float(a), error=float(b)) for a, b in zip(x, errors, strict=True)]
    return JointTorque(
        gravity=found[0],
        inertia=found[1],
        friction=found[2],
        gravity_size=float(np.std(gravity)),
        friction_size=float(abs(x[2]) * np.std(shape)),
        residual=float(np.std(residual)),
        deviation=float(np.std(tau)),
    )
