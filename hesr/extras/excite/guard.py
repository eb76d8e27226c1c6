"""Limits of planned motions, checked between setpoints as well."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from hesr_model.errors import RobotError
from hesr_model.motions.excitation import ExcitationSettings
from hesr_model.motions.limits import Limits, Positive
from hesr_model.motions.trajectories import Trajectory
from hesr_model.robots.collision import Clearance, Plane
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_BETWEEN = 3  # instants checked per setpoint
_STEP = 0.01  # [rad or m] summed motion of all joints between checks for contacts
_ROUNDING = 1e-9
_ALLOWED = 0.2  # default friction over the torque limit


class MotionSettings(ExcitationSettings):
    """Settings of planned motions."""

    start: tuple[float, ...] | None = None  # (n,) [rad or m]; near the middle of the ranges
    planes: tuple[Plane, ...] = ()  # floor and walls
    clearance: float = Field(default=0.03, ge=0)  # smallest distance between bodies [m]
    radius: Positive | None = None  # of the capsules around links without geometry [m]
    friction: tuple[float, ...] | None = None  # (n,) [N.m or N]; 20 % of the torque limit
    margin: float = Field(default=0.05, ge=0, lt=1)  # free share of all limits but position


class Guard:
    """Limits of a robot's motions: `stated`, and less margins and friction; contacts.

    Raises RobotError if a list of the settings has not one entry per joint.
    """

    def __init__(self, robot: Robot, settings: MotionSettings) -> None:
        for key in ("start", "friction"):
            if len(entries := getattr(settings, key) or (0.0,) * robot.n) != robot.n:
                raise RobotError(
                    f"key '{key}' has {len(entries)} entries; the {robot.n} joints of robot "
                    f"'{robot.name}' need one each."
                )
        self.robot, self.stated = robot, Limits.of(robot, settings.limits)
        share = np.where(np.isfinite(self.stated.torque), _ALLOWED * self.stated.torque, 0.0)
        self.friction = np.array(settings.friction or share)
        kept = 1.0 - settings.margin
        self.limits = replace(
            self.stated,
            velocity=kept * self.stated.velocity,
            acceleration=kept * self.stated.acceleration,
            torque=kept * self.stated.torque - self.friction,
        )
        self.clearance = Clearance(
            robot, planes=settings.planes, margin=settings.clearance, radius=settings.radius
        )

    def torque(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the torque (N, n) [N.m] of the model file's rigid body."""
        return self.robot.torque(self.robot.nominal_parameters, q, dq, ddq)

    def fault(self, motion: Trajectory, rate: float) -> str:
        """Return the joint and the limit it exceeds, or bodies that touch; empty if safe."""
        t = np.linspace(0.0, motion.duration, _BETWEEN * round(motion.duration * rate) + 1)
        q, dq, ddq = motion.sample(t)
        limits, tau = self.limits, self.torque(*(x[::_BETWEEN] for x in (q, dq, ddq)))
        for what, value, low, high in (
            ("position", q, limits.lower, limits.upper),
            ("velocity", dq, -limits.velocity, limits.velocity),
            ("acceleration", ddq, -limits.acceleration, limits.acceleration),
            ("torque", tau, -limits.torque, limits.torque),
        ):
            excess = np.maximum(low - value.min(axis=0), value.max(axis=0) - high)
            if np.any(over := excess > _ROUNDING * np.maximum(1.0, np.abs(high))):
                j = int(np.argmax(over))
                allowed = f" with {self.friction[j]:.3g} for friction" * (what == "torque")
                return (
                    f"joint '{self.robot.joints[j]}' needs a {what} of {excess[j]:.3g} beyond "
                    f"limits.{what} less its margin, {low[j]:.4g} to {high[j]:.4g}{allowed}"
                )
        way = np.cumsum(np.abs(np.diff(q, axis=0, prepend=q[:1])).sum(axis=1))
        _, rows = np.unique(np.floor(way / _STEP), return_index=True)
        if found := self.clearance.contact(q[rows]):
            return f"'{found[1]}' comes too near to '{found[2]}' at {t[rows[found[0]]]:.1f} s"
        return ""
