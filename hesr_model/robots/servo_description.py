"""The servo of a robot file, and what is known of the size of torques without a sensor."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from hesr_model.support.typed_files import Config

ServoKind = Literal["position", "voltage", "pd", "pid"]
"""Torque from position errors alone, with the error of speeds, and with the integral."""

_Positive = Annotated[float, Field(gt=0)]
_Known = _Positive | Literal["free"]


class ServoDescription(Config):
    """The servo of each joint, as far as it is known; one value, or one per joint.

    What is not known is "free", the default.
    `kp` [N.m/rad] and a `torque_limit` [N.m] that the logs reach fix the size of all torques.
    `gain_error` is the relative standard error of a stated gain or limit. Other gains are fitted:
    kind "position" has kp, "pd" also a gain of speed errors, "pid" also one of the integral.
    "voltage" is "position" whose limit is that of the voltage: at stall, before back-EMF, which is
    part of the viscous friction. So is that of "position", as the two act alike.
    """

    kind: ServoKind = "position"
    kp: _Known | tuple[_Known, ...] = "free"
    torque_limit: _Known | tuple[_Known, ...] = "free"
    gain_error: Annotated[float, Field(ge=0, lt=1)] = 0.05

    def find_stated(
        self, key: Literal["kp", "torque_limit"], j: int, joint_count: int
    ) -> float | None:
        """Return the stated gain [N.m/rad] or torque limit [N.m] of joint j; None if it is free."""
        value = self.expand_per_joint(key, joint_count)[j]
        return None if value == "free" else float(value)


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
