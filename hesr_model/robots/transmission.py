"""Transmissions: gears, and motors that turn several joints.

Motor angles are theta = R q (Siciliano et al., Robotics, section 7.2); by virtual work tau_q = R'
tau_motor. Friction and rotor inertia belong to *friction coordinates* u: motors, divided by their
own gear ratios, or joints::

    u = C q,   C[i, j] = R[i, j] / R[i, i],   tau_q = C' tau_u
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from hesr_model.errors import ArtifactError, RobotError, RuleError
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Config

Side = Literal["motor", "joint"]
_MAX_CONDITION = 1e8  # matrix with rows divided by gear ratios


class Transmission(Config):
    """The table ``[transmission]`` of a robot file.

    `matrix` (n, n) gives turns of each motor (row) per turn of each joint (column), negative if
    reversed, gear ratios on the diagonal. `logs` are of motors or joints; at motor position 0,
    joints are at `LogFormat.zero`. `friction` acts at motors or joints, for all or one per joint.
    """

    matrix: tuple[tuple[float, ...], ...] = Field(min_length=1)
    logs: Side = "joint"
    friction: Side | tuple[Side, ...] = "motor"

    @model_validator(mode="after")
    def _require_regular(self) -> "Transmission":
        n = len(self.matrix)
        if any(len(row) != n for row in self.matrix):
            raise RuleError(
                f"its matrix has {n} rows; each needs {n} entries, one per joint",
                code="transmission.square",
                key="matrix",
            )
        for k, row in enumerate(self.matrix, start=1):
            if row[k - 1] == 0.0:
                raise RuleError(
                    f"the gear ratio of motor {k}, on the matrix's diagonal, is 0",
                    code="transmission.ratio_zero",
                    key=f"matrix.{k - 1}.{k - 1}",
                )
        if not isinstance(self.friction, str) and len(self.friction) != n:
            raise RuleError(
                f"'friction' has {len(self.friction)} entries; {n} are needed, or one",
                code="transmission.friction_entries",
                key="friction",
            )
        for key, matrix in (("matrix", self.motors), ("friction", self.coordinates)):
            if np.linalg.cond(matrix) > _MAX_CONDITION:
                raise RuleError(f"its {key} is singular", code="transmission.singular", key=key)
        return self

    @property
    def ratios(self) -> Array:
        """Turns (n,) of each motor per turn of its own joint, signed."""
        return np.diag(np.array(self.matrix))

    @property
    def motors(self) -> Array:
        """Motor over joint angles (n, n), divided by the gear ratios."""
        return np.array(self.matrix) / self.ratios[:, None]

    @property
    def coordinates(self) -> Array:
        """Friction coordinates over joint angles (n, n)."""
        n = len(self.matrix)
        is_at_motor = np.array([side == "motor" for side in self.expand_per_joint("friction", n)])
        return np.where(is_at_motor[:, None], self.motors, np.eye(n))

    def require_turning(self, joints: Sequence[str], slides: Sequence[bool]) -> None:
        """Raise RobotError if joints of different kinds are coupled."""
        for i, j in np.argwhere(np.array(self.matrix) != 0.0):
            if slides[i] != slides[j]:
                raise RobotError(
                    f"key 'transmission.matrix' couples the motor of joint '{joints[i]}' to joint "
                    f"'{joints[j]}'; a sliding and a turning joint cannot be coupled."
                )


@dataclass(frozen=True)
class Coupling:
    """Coordinates u = C q of coupled joints; `matrix` is C."""

    matrix: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        n = len(self.matrix)
        is_square = n > 0 and all(len(row) == n for row in self.matrix)
        if not is_square or not np.linalg.cond(self.forward) < _MAX_CONDITION:
            raise ArtifactError(
                f"a coupling of joints must be a regular square matrix; found is {self.matrix}."
            )

    @classmethod
    def from_matrix(cls, matrix: Array) -> "Coupling | None":
        """Return the coupling of a matrix (n, n), if any."""
        if np.array_equal(matrix, np.eye(len(matrix))):
            return None
        return cls(tuple(tuple(float(entry) for entry in row) for row in matrix))

    @cached_property
    def forward(self) -> Array:
        """C (n, n), which maps motions of joints to u."""
        return np.array(self.matrix)

    @cached_property
    def backward(self) -> Array:
        """C'^-1 (n, n), which maps torques at joints to u."""
        return np.asarray(np.linalg.inv(self.forward.T))

    def motion(self, joints: Array) -> Array:
        """Return motions (N, n) of u from q."""
        return np.asarray(joints @ self.forward.T)

    def torque(self, joints: Array) -> Array:
        """Return torques (N, n), or regressor rows (N, n, P), at u from q."""
        return np.asarray(np.einsum("ij,kj...->ki...", self.backward, joints))

    def to_joints(self, torque: Array) -> Array:
        """Return torques (N, n) at q from u."""
        return np.asarray(torque @ self.forward)

    def ends(self, torque: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Return the ends (N, n) at q of independent bands around torques (N, n) at u."""
        below, above = (np.maximum(x, 0.0) ** 2 for x in (torque - lower, upper - torque))
        squared_forward = self.forward**2
        is_positive = self.forward > 0.0
        middle = self.to_joints(torque)
        down = below @ (squared_forward * is_positive) + above @ (squared_forward * ~is_positive)
        up = above @ (squared_forward * is_positive) + below @ (squared_forward * ~is_positive)
        return middle - np.sqrt(down), middle + np.sqrt(up)


def transform_motion(coupling: Coupling | None, motion: Array) -> Array:
    """Return the motion (N, n) of friction coordinates."""
    return motion if coupling is None else coupling.motion(motion)


LINEAR = ("k", "const")
BALANCER = {"const": 0, "cos": 1, "sin": 1, "cos2": 2, "sin2": 2}  # multiples of the angle


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
        return BALANCER.get(self.name, 0)

    def compute_torque(self, q: Array) -> Array:
        """Return the torque at positions [rad or m] of its joint."""
        angle = self.harmonic * q
        return q if self.linear else np.sin(angle) if self.sine else np.cos(angle)
