"""Motions of a study, as described in TOML."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from cosim.loop.closed_loop import PerJoint
from hesr_model.motions.trajectories import Sine, Sweep, Trajectory, chirp, random_fourier
from hesr_model.support.config import Config


class _Motion(Config):
    """Common part of all motions."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")
    also_reversed: bool = False  # also run the time-reversed motion as ``<name>_reversed``

    @property
    def unlogged(self) -> float:
        """Time before the log begins [s]."""
        return 0.0

    def _values(self, *names: str) -> dict[str, Any]:
        """Return fields by name, lists as arrays."""
        values = {name: getattr(self, name) for name in names}
        return {name: np.array(v) if isinstance(v, tuple) else v for name, v in values.items()}


class FourierMotion(_Motion):
    """Fourier series drawn from a seed; see `hesr_model.motions.trajectories.random_fourier`."""

    kind: Literal["fourier"]
    seed: int
    harmonics: int = Field(ge=2)
    period: float = Field(gt=0)
    peak_velocity: PerJoint
    offset: PerJoint
    periods: int = Field(default=1, ge=1)
    unlogged_periods: int = Field(default=0, ge=0)  # first periods without log

    @property
    def unlogged(self) -> float:
        """Time before the log begins [s]."""
        return self.unlogged_periods * self.period

    def trajectory(self) -> Trajectory:
        """Return the motion in closed form."""
        names = ("seed", "harmonics", "period", "peak_velocity", "offset", "periods")
        return random_fourier(**self._values(*names))


class SineMotion(_Motion):
    """Sine; see `hesr_model.motions.trajectories.Sine`."""

    kind: Literal["sine"]
    frequency: float = Field(gt=0)
    amplitude: PerJoint
    offset: PerJoint
    periods: int = Field(ge=1)

    def trajectory(self) -> Trajectory:
        """Return the motion in closed form."""
        return Sine(**self._values("offset", "amplitude", "frequency", "periods"))


class ChirpMotion(_Motion):
    """Chirp of constant peak velocity; see `hesr_model.motions.trajectories.chirp`."""

    kind: Literal["chirp"]
    first: float = Field(gt=0)
    last: float = Field(gt=0)
    length: float = Field(gt=0)
    amplitude: PerJoint
    start: PerJoint

    def trajectory(self) -> Trajectory:
        """Return the motion in closed form."""
        return chirp(**self._values("start", "amplitude", "first", "last", "length"))


class SweepMotion(_Motion):
    """Sweep with varying amplitude; see `hesr_model.motions.trajectories.Sweep`."""

    kind: Literal["sweep"]
    first: float = Field(gt=0)
    last: float = Field(gt=0)
    length: float = Field(gt=0)
    amplitude: PerJoint
    swing: PerJoint
    swing_phase: PerJoint
    swing_period: float = Field(gt=0)
    start: PerJoint

    def trajectory(self) -> Trajectory:
        """Return the motion in closed form."""
        names = ("start", "amplitude", "swing", "swing_period", "first", "last", "length")
        return Sweep(phase=np.array(self.swing_phase), **self._values(*names))


MotionSpec = Annotated[
    FourierMotion | SineMotion | ChirpMotion | SweepMotion, Field(discriminator="kind")
]


class Motions(Config):
    """Motions of a study; each gives one log, or two with `also_reversed`."""

    motions: tuple[MotionSpec, ...] = Field(min_length=1)

    @field_validator("motions")
    @classmethod
    def _names_differ(cls, motions: tuple[MotionSpec, ...]) -> tuple[MotionSpec, ...]:
        names = [name for motion in motions for name in names_of(motion)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two logs would be named '{name}'; names must differ")
        return motions


def names_of(motion: MotionSpec) -> tuple[str, ...]:
    """Return the names of the logs of a motion."""
    return (motion.name, f"{motion.name}_reversed") if motion.also_reversed else (motion.name,)
