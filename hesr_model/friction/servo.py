"""Servos that were fitted together with friction, from commands and positions."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Self

ScaleSource = Literal[
    "gain", "stall torque", "gravity", "added inertia", "current", "other joints", "none"
]
"""What fixes the size of all torques; without any they are in units of the gain."""


@dataclass(frozen=True, kw_only=True)
class JointServo:
    """Servo and armature of one joint; all torques may be in units of one common factor.

    Attributes
    ----------
    kp, ki, kd : gains [N.m/rad, N.m/(rad.s), N.m.s/rad].
    armature : inertia beside that of the links [kg.m2].
    latency : of commands [s].
    torque_limit : [N.m]; None if none was reached.
    command_filter : time constant of a filter of the commands [s].
    speed_limit : of followed commands [rad/s]; None if none was reached.
    body_factor : factor of inertia and gravity of the links.
    added_factor : factor of known inertias that single logs added.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    armature: float = 0.0
    latency: float = 0.0
    torque_limit: float | None = None
    command_filter: float = 0.0
    speed_limit: float | None = None
    body_factor: float = 1.0
    added_factor: float = 1.0

    def scale(self, factor: float) -> Self:
        """Return the servo with all torques multiplied, which moves nothing."""
        limit = self.torque_limit
        if limit is not None:
            limit = factor * limit
        return replace(
            self,
            kp=factor * self.kp,
            ki=factor * self.ki,
            kd=factor * self.kd,
            armature=factor * self.armature,
            torque_limit=limit,
            body_factor=factor * self.body_factor,
            added_factor=factor * self.added_factor,
        )


@dataclass(frozen=True, kw_only=True)
class FittedServo:
    """The servo of one joint as fitted, and how well it and the law explain the motion.

    Attributes
    ----------
    servo : in N.m, or over the gain if `scale` is none.
    scale : what fixes the size of torques.
    scale_error : relative standard error of that size; None without a scale.
    intervals : half widths of 95 % intervals of the servo's values by name.
    position_rmse : error of the positions along the commands of the logs [rad; m].
    ideal_rmse : that of a servo that follows its delayed commands exactly [rad; m].
    """

    servo: JointServo
    scale: ScaleSource
    scale_error: float | None = None
    intervals: Mapping[str, float]
    position_rmse: float
    ideal_rmse: float
