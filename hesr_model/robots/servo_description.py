"""The servo of a robot file, and what is known of the size of torques without a sensor."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from hesr_model.support.typed_files import Config

ServoKind = Literal["position", "voltage", "pd", "pid"]
"""Torque from position errors alone, with the error of speeds, and with the integral."""

_Positive = Annotated[float, Field(gt=0)]
_PerJoint = _Positive | tuple[_Positive, ...]


class ServoDescription(Config):
    """The servo of each joint, as far as it is known; one value, or one per joint.

    `kp` [N.m/rad] and a `torque_limit` [N.m] that the logs reach fix the size of all torques.
    `gain_error` is the relative standard error of a stated gain or limit. Other gains are fitted:
    kind "position" has kp, "pd" also a gain of speed errors, "pid" also one of the integral.
    "voltage" is "position" whose limit is that of the voltage: at stall, before back-EMF, which is
    part of the viscous friction. So is that of "position", as the two act alike.
    """

    kind: ServoKind = "position"
    kp: _PerJoint | None = None
    torque_limit: _PerJoint | None = None
    gain_error: Annotated[float, Field(ge=0, lt=1)] = 0.05


class ScaleDescription(Config):
    """What fixes the size of torques.

    `body_error` is the relative standard error of the model's masses. `inertia_added` are known
    inertias [kg.m2; kg] that joints turned in single logs, as in
    ``inertia_added.with_disc = {joint1 = 0.02}``; logs with and without them fix the size.
    `same_servos` states that all joints have the same servo and gear: a joint without a source of
    its own has the gain of the others.
    """

    body_error: Annotated[float, Field(ge=0, lt=1)] = 0.2
    inertia_added: Mapping[str, Mapping[str, Annotated[float, Field(ge=0)]]] = {}
    same_servos: bool = False

    def find_added_inertia(self, log: str, joint: str) -> float:
        """Return the known inertia that a joint turned in a log beside the model's bodies."""
        return self.inertia_added.get(log, {}).get(joint, 0.0)
