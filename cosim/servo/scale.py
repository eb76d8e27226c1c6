"""What fixes the size of torques in logs without torque.

Positions depend on ratios of torques only: all torques times one factor move nothing. The factor
comes from a stated gain, a stated torque that the servo reached, or gravity by the model's masses.
"""

from dataclasses import dataclass

import numpy as np

from cosim.servo.interval import Interval
from hesr_model.friction.servo import ScaleSource
from hesr_model.robots.robot import RobotDescription

_MOST_ERROR = 0.3  # largest relative error of gravity over the gain that still fixes the size
_CONTRADICTION = 3.0  # standard errors between a stated gain and gravity


@dataclass(frozen=True, kw_only=True)
class TorqueScale:
    """Size of a joint's torques.

    Attributes
    ----------
    source : what fixes it.
    gain : gain of the servo [N.m/rad], 1 without a source.
    error : relative standard error of what is stated; None without a source.
    follows_gravity : whether the gain is the inverse of gravity over the gain, whose errors of
        the fit then enter those of all torques.
    contradiction : stated gain over that of gravity if the two disagree, else None.
    """

    source: ScaleSource
    gain: float = 1.0
    error: float | None = None
    follows_gravity: bool = False
    contradiction: float | None = None


def find_scale(interval: Interval, description: RobotDescription, j: int) -> TorqueScale:
    """Return the size of the torques of joint j, from its fit over the gain."""
    servo = description.servo
    body_error = description.scale.body_error
    gravity, gravity_error = interval.find("body_factor")
    has_gravity = gravity > 0.0 and gravity_error < _MOST_ERROR * gravity
    relative_error = gravity_error / gravity if has_gravity else np.inf
    gain = None if servo.kp is None else servo.expand_per_joint("kp", len(description.joints))[j]
    if gain is not None:
        contradiction = None
        if has_gravity:
            spread = float(np.sqrt(relative_error**2 + servo.gain_error**2 + body_error**2))
            ratio = gain * gravity
            if abs(np.log(ratio)) > _CONTRADICTION * spread:
                contradiction = ratio
        return TorqueScale(
            source="gain", gain=gain, error=servo.gain_error, contradiction=contradiction
        )
    limit, _ = interval.find("torque_limit")
    if servo.torque_limit is not None and limit > 0.0:
        stated = servo.expand_per_joint("torque_limit", len(description.joints))[j]
        return TorqueScale(source="stall torque", gain=stated / limit, error=servo.gain_error)
    if has_gravity:
        return TorqueScale(
            source="gravity", gain=1.0 / gravity, error=body_error, follows_gravity=True
        )
    return TorqueScale(source="none")
