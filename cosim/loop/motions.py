"""Motions of a study in TOML."""

from collections.abc import Callable, Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator

from cosim.loop.closed_loop import PerJoint
from hesr_model.errors import ConfigError, RuleError
from hesr_model.motions.trajectories import Sine, Sweep, Trajectory, chirp, random_fourier
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import Config


class _Motion(Config):
    make: ClassVar[Callable[..., Trajectory]]
    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    also_reversed: bool = False  # second log ``<name>_reversed``

    unlogged_ends: float = Field(default=0.0, ge=0)  # at rest, before and after the log [s]

    @property
    def unlogged(self) -> tuple[float, float]:
        """Times before and after the log [s]."""
        return self.unlogged_ends, self.unlogged_ends

    def trajectory(self) -> Trajectory:
        """Return the motion in closed form, made of all other fields."""
        other = {"name", "also_reversed", "kind", "unlogged_periods", "unlogged_ends"}
        values = self.model_dump(exclude=other)
        return self.make(**{k: np.array(v) if type(v) is tuple else v for k, v in values.items()})


class FourierMotion(_Motion):
    """Fourier series; see `hesr_model.motions.trajectories.random_fourier`."""

    make = staticmethod(random_fourier)
    kind: Literal["fourier"]
    seed: int
    harmonics: int = Field(ge=2)
    period: float = Field(gt=0)
    peak_velocity: PerJoint
    offset: PerJoint
    periods: int = Field(default=1, ge=1)
    unlogged_periods: int = Field(default=0, ge=0)  # without log

    @property
    def unlogged(self) -> tuple[float, float]:
        """Times before and after the log [s]."""
        return self.unlogged_ends + self.unlogged_periods * self.period, self.unlogged_ends


class SineMotion(_Motion):
    """Sine; see `hesr_model.motions.trajectories.Sine`."""

    make = Sine
    kind: Literal["sine"]
    frequency: float = Field(gt=0)
    amplitude: PerJoint
    offset: PerJoint
    periods: int = Field(ge=1)


class ChirpMotion(_Motion):
    """Chirp of constant peak velocity; see `hesr_model.motions.trajectories.chirp`."""

    make = staticmethod(chirp)
    kind: Literal["chirp"]
    first: float = Field(gt=0)
    last: float = Field(gt=0)
    length: float = Field(gt=0)
    amplitude: PerJoint
    start: PerJoint


class SweepMotion(_Motion):
    """Sweep with varying amplitude; see `hesr_model.motions.trajectories.Sweep`."""

    make = Sweep
    kind: Literal["sweep"]
    first: float = Field(gt=0)
    last: float = Field(gt=0)
    length: float = Field(gt=0)
    amplitude: PerJoint
    swing: PerJoint
    swing_phase: PerJoint
    swing_period: float = Field(gt=0)
    start: PerJoint


MotionSpec = Annotated[
    FourierMotion | SineMotion | ChirpMotion | SweepMotion, Field(discriminator="kind")
]


class Motions(Config):
    """Motions of a study."""

    motions: tuple[MotionSpec, ...] = Field(min_length=1)

    @field_validator("motions")
    @classmethod
    def _names_differ(cls, motions: tuple[MotionSpec, ...]) -> tuple[MotionSpec, ...]:
        names: list[str] = []
        for motion in motions:
            names += list_log_names(motion)
        for name in names:
            if names.count(name) > 1:
                raise RuleError(
                    f"two logs would be named '{name}'; names must differ", code="motions.names"
                )
        return motions


def list_log_names(motion: MotionSpec) -> tuple[str, ...]:
    """Return the names of the logs of a motion."""
    if motion.also_reversed:
        return motion.name, f"{motion.name}_reversed"
    return (motion.name,)


def require_within(limits: Array, q: Array, joints: Sequence[str], subject: str) -> None:
    """Raise ConfigError if positions (N, n) leave the limits (n, 2) [rad]."""
    for joint, (lower, upper), path in zip(joints, limits, q.T, strict=True):
        if path.min() < lower or path.max() > upper:
            raise ConfigError(
                f"{subject} takes {joint} from {path.min():.3f} to {path.max():.3f} rad; it can go "
                f"from {lower:.3f} to {upper:.3f} rad."
            )
