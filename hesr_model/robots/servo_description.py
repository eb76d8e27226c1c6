"""The servo of a robot file, and what is known of the size of torques without a sensor."""

from typing import Annotated, Literal

from pydantic import Field

from hesr_model.support.typed_files import Config

ServoKind = Literal["position", "pd", "pid"]
"""Torque from position errors alone, with the error of speeds, and with the integral."""

_Positive = Annotated[float, Field(gt=0)]
_PerJoint = _Positive | tuple[_Positive, ...]


class ServoDescription(Config):
    """The servo of each joint, as far as it is known; one value, or one per joint.

    `kp` [N.m/rad] and a `torque_limit` [N.m] that the logs reach fix the size of all torques.
    `gain_error` is the relative standard error of a stated gain or limit. Other gains are fitted:
    kind "position" has kp, "pd" also a gain of speed errors, "pid" also one of the integral.
    """

    kind: ServoKind = "position"
    kp: _PerJoint | None = None
    torque_limit: _PerJoint | None = None
    gain_error: Annotated[float, Field(ge=0, lt=1)] = 0.05


class ScaleDescription(Config):
    """What fixes the size of torques: `body_error` is the relative error of the model's masses."""

    body_error: Annotated[float, Field(ge=0, lt=1)] = 0.2
