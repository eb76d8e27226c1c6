"""Ranges of the records that a law was fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Self

import numpy as np

from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import INPUT_UNITS, MOVING
from hesr_model.friction.thermal import TEMPERATURE, Thermal
from hesr_model.rigid_body.friction_record import FrictionRecord

Range = tuple[float, float]  # least and greatest value


@dataclass(frozen=True, kw_only=True)
class TrainedRange:
    """Ranges of training records [rad/s, rad, N.m]; ArtifactError if invalid or without motion."""

    sample_time: float  # median [s]
    dq: Range
    q: Range
    tau_load: Range
    tau: Range

    def __post_init__(self) -> None:
        for name in (*INPUT_UNITS, "tau"):
            lowest, highest = getattr(self, name)
            if not (isfinite(lowest) and isfinite(highest) and lowest <= highest):
                raise ArtifactError(
                    f"trained range of '{name}' is {lowest} to {highest}.",
                    code="law.trained",
                    key=f"trained.{name}",
                )
        if not (self.speed > 0.0 and self.sample_time > 0.0):
            raise ArtifactError(
                f"trained range of 'dq' is {self.dq[0]} to {self.dq[1]} rad/s at a sample time of "
                f"{self.sample_time} s; expected motion and a positive time.",
                code="law.trained_motion",
                key="trained.dq",
            )

    @classmethod
    def from_records(cls, joint_records: Sequence[FrictionRecord]) -> Self:
        """Return the ranges of a joint's records; of a joint at rest, speeds that count as rest."""
        ranges = {}
        for name in (*INPUT_UNITS, "tau"):
            values = np.concatenate([getattr(record, name) for record in joint_records])
            ranges[name] = float(np.min(values)), float(np.max(values))
        if ranges["dq"] == (0.0, 0.0):
            ranges["dq"] = -MOVING, MOVING
        period = float(np.median(np.concatenate([np.diff(record.t) for record in joint_records])))
        return cls(sample_time=round(period, 9), **ranges)

    @property
    def speed(self) -> float:
        """Largest trained speed [rad/s]."""
        return max(map(abs, self.dq))

    @property
    def middle(self) -> float:
        """Middle of the trained positions [rad]."""
        return sum(self.q) / 2.0


@dataclass(frozen=True, kw_only=True)
class Excess:
    """Share of rows outside a trained range, and largest distances below and above it."""

    rows: float
    below: float
    above: float


def find_excess(
    trained_range: TrainedRange,
    joint_records: Sequence[FrictionRecord],
    thermal: Thermal | None = None,
) -> dict[str, Excess]:
    """Return the excess of each input of a joint, and its temperature, that leaves its range."""
    excesses = {}
    ranges = {name: getattr(trained_range, name) for name in INPUT_UNITS}
    if thermal and all(record.temperature is not None for record in joint_records):
        ranges[TEMPERATURE.name] = thermal.coldest, thermal.warmest
    for name, (lowest, highest) in ranges.items():
        values = np.concatenate([getattr(record, name) for record in joint_records])
        below = lowest - values
        above = values - highest
        is_beyond = (below > 0.0) | (above > 0.0)
        if np.any(is_beyond):
            excesses[name] = Excess(
                rows=float(np.mean(is_beyond)),
                below=max(0.0, float(np.max(below))),
                above=max(0.0, float(np.max(above))),
            )
    return excesses
