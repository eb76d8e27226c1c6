"""Scales of the experiments, measured on the FMU, inertia of the joints, and results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hesr.extras.properties.bench import FrictionBench
from hesr_model.audit.audit import ENCODER_NOISE
from hesr_model.audit.properties import Curve, Figure, Plot, PropertyResult
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_UNITS = {
    "amplitude": "rad/s",
    "break-away": "N.m",
    "log10 rate": "N.m/s",
    "moved": "mrad",
    "position": "mrad",
    "stretch": "mrad",
    "time": "s",
    "torque": "N.m",
    "velocity": "rad/s",
    "work taken, share": "",
}


def curve(label: str, x: Array, y: Array, *, closed: bool = False, max_points: int = 80) -> Curve:
    """Return a line of at most `max_points` finite points (N,), rounded to four digits."""
    is_finite = np.isfinite(x) & np.isfinite(y)
    x = x[is_finite]
    y = y[is_finite]
    rows = np.unique(np.linspace(0, len(x) - 1, min(len(x), max_points)).round().astype(int))
    if closed and len(rows):
        rows = np.append(rows, rows[0])
    return Curve(label=label, x=_round_values(x[rows]), y=_round_values(y[rows]))


def _round_values(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{value:.4g}") for value in values)


def plot(x: str, y: str, *curves: Curve) -> Plot:
    """Return lines over axes with these names."""
    return Plot(x=x, y=y, units=(_UNITS[x], _UNITS[y]), curves=curves)


def figures(*figure_rows: tuple[str, float | None, str]) -> tuple[Figure, ...]:
    """Return figures from name, value and SI unit."""
    return tuple(Figure(name=name, value=value, unit=unit) for name, value, unit in figure_rows)


def judge(
    *figure_rows: tuple[str, float | None, str], faults: Sequence[str], plot: Plot | None = None
) -> PropertyResult:
    """Return a result that passes if the list of sentences `faults` is empty."""
    return PropertyResult(
        verdict="fail" if faults else "pass",
        figures=figures(*figure_rows),
        reason=" ".join(faults),
        plot=plot,
    )


CREEP = 0.01  # in largest trained speeds
SLIDING = 0.1  # speed of the friction level, in largest trained speeds
DEFLECTION = 1e-3  # default amplitude of pre-sliding, in lengths of the scale

INERTIA: Mapping[str, tuple[float, ...]] = {"uf850": (3.0, 3.0, 0.6)}
"""Inertia of the joints of shipped robots [kg.m2], the others at rest."""

_MIN_FRICTION = 1e-6  # [N.m] minimum of a divisor
_SPEED_SHARES = np.geomspace(1e-3, 1.0, 31)
_DEFLECTION_RANGE = (ENCODER_NOISE, 1e-2)  # accepted in lengths, from an encoder's resolution
_RETURN_PATH = np.geomspace(1e-7, 0.5, 100)  # after a reversal, in lengths
_LENGTH_TIME = 1.0  # [s] the time of a length at the largest trained speed
_MAX_LENGTH = 1.0  # [rad]


@dataclass(frozen=True, kw_only=True, eq=False)
class Scale:
    """Sizes of a model's joints, (n,) unless noted."""

    speed: Array  # largest trained [rad/s]
    length: Array  # of motions: the way of a second at that speed, at most a radian [rad]
    speeds: Array  # (S, n) steady sliding [rad/s]
    steady: Array  # (S, n) half the difference of both directions [N.m]
    level: Array  # absolute `steady` at `SLIDING` [N.m]
    offset: Array  # mean of both directions there [N.m]
    load: float  # [N.m]
    deflection: Array  # amplitude of pre-sliding [rad]

    @property
    def is_driving(self) -> Array:
        """Whether slow steady sliding back and forth releases energy, (n,)."""
        return np.asarray((self.steady[_SPEED_SHARES <= SLIDING * 1.001] < 0.0).any(axis=0))

    @property
    def holding_torque(self) -> Array:
        """Holding torque at rest (n,) [N.m]: the level, or less if friction rises with speed."""
        slowest = np.abs(self.steady[0])
        return np.where(slowest > _MIN_FRICTION, np.minimum(self.level, slowest), self.level)


def measure_scale(bench: FrictionBench, speed: Array, load: float) -> Scale:
    """Slide and reverse joints up to `speed` (n,) [rad/s] under a load [N.m]."""
    speeds = _SPEED_SHARES[:, None] * speed
    torques = []
    for sign in (1.0, -1.0):
        bench.start(load=load)
        torques.append(bench.move(np.full(len(speeds), bench.sliding_time), sign * speeds))
    steady_torque = 0.5 * (torques[0] - torques[1])
    offset = 0.5 * (torques[0] + torques[1])
    level_row = int(np.argmin(np.abs(_SPEED_SHARES - SLIDING)))
    creep_speed = CREEP * speed
    bench.start(load=load)
    sliding_torque = bench.move(np.array([bench.sliding_time]), creep_speed[None])[0]
    length = np.minimum(_LENGTH_TIME * speed, _MAX_LENGTH)
    # All joints reach the same share of their path at once.
    times = _RETURN_PATH * np.max(length) / np.max(creep_speed)
    returning_speed = np.broadcast_to(-creep_speed, (len(times), len(creep_speed)))
    tau = bench.move(np.diff(times, prepend=0.0), returning_speed)
    # The deflection is the displacement at half of the torque change after the reversal.
    torque_change = np.where(sliding_torque == tau[-1], 1.0, sliding_torque - tau[-1])
    half_rows = np.argmax((sliding_torque - tau) / torque_change >= 0.5, axis=0)
    displacements = times[:, None] * creep_speed
    deflections = displacements[half_rows, np.arange(bench.joints)]
    shortest, longest = _DEFLECTION_RANGE
    is_accepted = (deflections >= shortest * length) & (deflections <= longest * length)
    return Scale(
        speed=speed,
        length=length,
        speeds=speeds,
        steady=steady_torque,
        level=np.maximum(np.abs(steady_torque[level_row]), _MIN_FRICTION),
        offset=offset[level_row],
        load=load,
        deflection=np.where(is_accepted, deflections, DEFLECTION * length),
    )


def compute_standing_inertia(
    robot: Robot, body: RigidBody, model: FrictionModel
) -> tuple[float, ...] | None:
    """Return the inertia of each joint at the middle of the trained range [kg.m2].

    It is that of `INERTIA`, else the diagonal of the identified mass matrix if positive.
    """
    if body.robot in INERTIA:
        return INERTIA[body.robot]
    joint_count = robot.n
    middle = np.zeros(joint_count)
    if model.trained:
        middle = np.array([trained_range.middle for trained_range in model.trained])
    q: Array = np.tile(middle, (joint_count + 1, 1))
    standstill = np.zeros_like(q)
    # One joint accelerates per row; the last row is gravity.
    tau = robot.torque(body.parameters, q, standstill, np.eye(joint_count + 1, joint_count))
    inertia = np.diag(tau[:joint_count] - tau[joint_count])
    if not np.all(inertia > 0.0):
        return None
    return tuple(map(float, inertia))
