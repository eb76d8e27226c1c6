"""Springs and balancers: torques of a joint that depend on its own position."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hesr_model.errors import RobotError
from hesr_model.support.arrays import Array

LINEAR = ("k", "const")
_BALANCER = {"const": 0, "cos": 1, "sin": 1, "cos2": 2, "sin2": 2}  # multiples of the angle


@dataclass(frozen=True, kw_only=True)
class SpringTerm:
    """Torque of the joint number `joint` per unit of the parameter `name`."""

    joint: int
    name: str

    @property
    def linear(self) -> bool:
        """Whether it is a stiffness, over the position."""
        return self.name == "k"

    @property
    def unit(self) -> str:
        """Unit of the parameter at a turning joint."""
        return "N.m/rad" if self.linear else "N.m"

    @property
    def sine(self) -> bool:
        """Whether it is a sine, else a cosine."""
        return self.name.startswith("sin")

    @property
    def harmonic(self) -> int:
        """Multiple of the angle; 0 for a constant."""
        return _BALANCER.get(self.name, 0)

    def over(self, q: Array) -> Array:
        """Return the torque at positions [rad or m] of its joint."""
        angle = self.harmonic * q
        return q if self.linear else np.sin(angle) if self.sine else np.cos(angle)


def spring_terms(
    robot: str,
    joints: Sequence[str],
    slides: Sequence[bool],
    springs: Sequence[str],
    balancers: Sequence[str],
) -> Iterator[SpringTerm]:
    """Yield the terms of the joints in two lists of a robot's file; raises RobotError."""
    for key, listed in (("springs", springs), ("balancers", balancers)):
        for name in listed:
            if name not in joints:
                raise RobotError(
                    f"key '{key}' of robot '{robot}' contains '{name}'; its joints are "
                    f"{', '.join(joints)}."
                )
            if key == "balancers" and slides[joints.index(name)]:
                raise RobotError(
                    f"key 'balancers' of robot '{robot}' contains '{name}', which slides; list it "
                    "in 'springs'."
                )
    for number, joint in enumerate(joints):
        names = [*LINEAR] * (joint in springs) + [*_BALANCER] * (joint in balancers)
        for name in dict.fromkeys(names):
            yield SpringTerm(joint=number, name=name)
