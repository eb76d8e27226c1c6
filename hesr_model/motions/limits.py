"""Limits of a motion, and motions shrunk into them."""

from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator
from scipy.optimize import minimize

from hesr_model.errors import FitError, RobotError, RuleError
from hesr_model.motions.trajectories import Fourier, sample_one_period
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Config

Positive = Annotated[float, Field(gt=0)]
RANGE_MARGIN = 0.05  # default margin at either end of a joint's range: no arm follows exactly
_SECONDS_TO_FULL_SPEED = 1.0  # default time to a joint's speed [s]; files have no acceleration
_MARGIN = 1e-3  # margin of every limit for peaks between the evaluated points
_HALVINGS = 12
_REST_CANDIDATES = 4000


class MotionLimits(Config):
    """Limits of a motion, one entry per joint; needed unless the model states them.

    Attributes
    ----------
    position : lowest and highest [rad or m]; by default the model's range less 5 % at either end.
    velocity : largest speed [rad/s or m/s]; by default the model's.
    acceleration : [rad/s2 or m/s2]; by default it reaches the velocity in one second.
    torque : rigid-body torque without friction [N.m or N]; by default the model's effort limit. It
        holds only as far as the model file's inertias are right.
    """

    position: tuple[tuple[float, float], ...] | None = None
    velocity: tuple[Positive, ...] | None = None
    acceleration: tuple[Positive, ...] | None = None
    torque: tuple[Positive, ...] | None = None

    @model_validator(mode="after")
    def _require_open_ranges(self) -> Self:
        for number, (lowest, highest) in enumerate(self.position or (), start=1):
            if not lowest < highest:
                raise RuleError(
                    f"position of joint {number} goes from {lowest:g} to {highest:g}; the first "
                    "must be the lower",
                    code="limits.position",
                    key=f"position.{number - 1}",
                )
        return self


@dataclass(frozen=True, kw_only=True, eq=False)
class Limits:
    """Absolute limits (n,) of one robot's joints; `torque` is infinite without limit."""

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    torque: Array

    @classmethod
    def from_settings(cls, robot: Robot, stated_limits: MotionLimits) -> Self:
        """Return the limits, by default the model's; raises RobotError if they do not fit it."""
        _require_one_entry_per_joint(robot, stated_limits)
        lower, upper, speed = robot.limits
        if stated_limits.position is None:
            _require_stated(robot, "position", upper - lower)
        margin = RANGE_MARGIN * (upper - lower)
        position = np.array(
            stated_limits.position or np.column_stack([lower + margin, upper - margin])
        )
        _require_allowed_positions(robot, position)
        if stated_limits.velocity is None:
            _require_stated(robot, "velocity", speed)
        velocity = np.array(stated_limits.velocity or speed)
        effort = np.where(robot.torque_limits > 0, robot.torque_limits, np.inf)
        return cls(
            lower=position[:, 0],
            upper=position[:, 1],
            velocity=velocity,
            acceleration=np.array(stated_limits.acceleration or velocity / _SECONDS_TO_FULL_SPEED),
            torque=np.array(stated_limits.torque or effort),
        )

    def shrink(self, motion: Fourier, robot: Robot, rest_q: Array) -> Fourier:
        """Shrink a motion until it keeps all limits, for torque towards `rest_q` (n,) [rad]."""
        inner_share = 1.0 - _MARGIN
        q, dq, ddq = sample_one_period(motion)
        displacement = q - motion.offset
        position_factor = (self.upper - self.lower) / np.ptp(displacement, axis=0)
        velocity_factor = self.velocity / np.abs(dq).max(axis=0)
        acceleration_factor = self.acceleration / np.abs(ddq).max(axis=0)
        unit_factor = np.full(robot.n, 1.0 / inner_share)  # no motion becomes larger
        factors = [unit_factor, position_factor, velocity_factor, acceleration_factor]
        factor = inner_share * np.minimum.reduce(factors)
        displacement = factor * displacement
        margin = 0.5 * _MARGIN * (self.upper - self.lower)
        offset = np.clip(
            motion.offset,
            self.lower + margin - displacement.min(axis=0),
            self.upper - margin - displacement.max(axis=0),
        )
        fitting_motion = replace(
            motion, offset=offset, a=factor[:, None] * motion.a, b=factor[:, None] * motion.b
        )
        return self._shrink_for_torque(fitting_motion, robot, rest_q)

    def _shrink_for_torque(self, motion: Fourier, robot: Robot, rest_q: Array) -> Fourier:
        def shrink_to_share(share: float) -> Fourier:
            offset = rest_q + share * (motion.offset - rest_q)
            return replace(motion, offset=offset, a=share * motion.a, b=share * motion.b)

        def keeps_limits(share: float) -> bool:
            peak = peak_torque(robot, shrink_to_share(share))
            return bool(np.all(peak <= (1.0 - _MARGIN) * self.torque))

        if not np.any(np.isfinite(self.torque)) or keeps_limits(1.0):
            return motion
        kept_share = 0.0
        exceeded_share = 1.0
        for _ in range(_HALVINGS):
            middle_share = 0.5 * (kept_share + exceeded_share)
            if keeps_limits(middle_share):
                kept_share = middle_share
            else:
                exceeded_share = middle_share
        if kept_share == 0.0:
            raise FitError(
                f"robot '{robot.description.name}': the limits allow no motion: gravity exceeds "
                "limits.torque in every position."
            )
        return shrink_to_share(kept_share)

    def find_rest_position(self, robot: Robot) -> Array:
        """Return the position (n,) [rad] of least gravity over limits; FitError if too large."""
        candidate_q = np.random.default_rng(0).uniform(
            self.lower, self.upper, (_REST_CANDIDATES, robot.n)
        )
        candidate_q[0] = 0.5 * (self.lower + self.upper)

        def compute_gravity(q: Array) -> Array:
            zeros = np.zeros_like(q)
            return np.abs(robot.torque(robot.nominal_parameters, q, zeros, zeros))

        minimum = minimize(
            lambda q: np.max(compute_gravity(q[None, :]) / self.torque),
            candidate_q[int(np.argmin(np.max(compute_gravity(candidate_q) / self.torque, axis=1)))],
            method="Nelder-Mead",
            bounds=np.column_stack([self.lower, self.upper]),
        )
        rest_q: Array = minimum.x
        gravity_torque = compute_gravity(rest_q[None, :])[0]
        j = int(np.argmax(gravity_torque / self.torque))
        if gravity_torque[j] >= self.torque[j]:
            raise FitError(
                f"robot '{robot.description.name}': the limits allow no motion: joint "
                f"'{robot.description.joints[j]}' needs {gravity_torque[j]:.3g} N.m against "
                f"gravity, but limits.torque is {self.torque[j]:g} N.m."
            )
        return rest_q


def _require_one_entry_per_joint(robot: Robot, stated_limits: MotionLimits) -> None:
    for key, entries in stated_limits:
        if entries is not None and len(entries) != robot.n:
            raise RobotError(
                f"key 'limits.{key}' has {len(entries)} entries; the {robot.n} joints of robot "
                f"'{robot.description.name}' need one each."
            )


def _require_allowed_positions(robot: Robot, position: Array) -> None:
    """Refuse ranges of position (n, 2) beyond the model's."""
    lower, upper, _ = robot.limits
    for j, joint in enumerate(robot.description.joints):
        if position[j, 0] < lower[j] or position[j, 1] > upper[j]:
            raise RobotError(
                f"key 'limits.position' of joint '{joint}' is {position[j, 0]:g} to "
                f"{position[j, 1]:g}; the model allows {lower[j]:g} to {upper[j]:g}."
            )


def _require_stated(robot: Robot, key: str, limits: Array) -> None:
    if not np.all(np.isfinite(limits)):
        joint = robot.joints[int(np.argmin(np.isfinite(limits)))]
        raise RobotError(
            f"robot '{robot.name}': its model has no {key} limit of joint '{joint}'; state "
            f"'{key}' of all joints in the table [limits] of a settings file."
        )


def peak_torque(robot: Robot, motion: Fourier) -> Array:
    """Return the largest torque (n,) [N.m] of the model file's rigid body, without friction."""
    q, dq, ddq = sample_one_period(motion)
    return np.asarray(np.abs(robot.torque(robot.nominal_parameters, q, dq, ddq)).max(axis=0))
