"""Inputs of networks: velocity, hysteresis state and its derivative, standardised."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from hesr_model.audit.audit import explodes
from hesr_model.errors import ArtifactError, FitError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array

TRIED = 30  # maximum number of networks tried for a torque in bounds
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Inputs of a network for one (alpha, beta), each with mean 0 and spread 1 over all rows."""

    cell: Cell
    z: Array  # (N, 3) standardised dq, h, dh
    mean: Array  # (3,) of dq [rad/s], h [1], dh [1/s]
    spread: Array  # (3,)

    @classmethod
    def of(cls, features: HysteresisFeatures, cell: Cell) -> "Inputs":
        """Run the hysteresis state of eq. 9 over the rows of a joint."""
        x = features.columns(cell.alpha, cell.beta)[:, 1:]
        mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), _TINY)
        return cls(cell=cell, z=(x - mean) / spread, mean=mean, spread=spread)


def candidates(features: HysteresisFeatures, count: int) -> list[Inputs]:
    """Return the inputs at the best `count` distinct (alpha, beta) of stage 1."""
    cells = calibrate.distinct(calibrate.profile(features), count)
    return [Inputs.of(features, cell) for cell in cells]


def first_tame(laws: Iterable[FrictionLaw], records: Sequence[FrictionRecord]) -> FrictionLaw:
    """Return the first law with a bounded torque; raises FitError if the first `TRIED` explode."""
    trained = TrainedRange.of(records)
    for law in islice(laws, TRIED):
        if not explodes(law, trained):
            return law
    raise FitError(
        f"joint '{records[0].joint}': the torque of the best networks explodes just outside "
        "the trained speeds; more training motion is needed."
    )


def size(law: str, structure: Mapping[str, Any], key: str, largest: int) -> int:
    """Return the size from a structure {key: size}; raises ArtifactError if it is invalid."""
    found = structure.get(key)
    if set(structure) != {key} or type(found) is not int or not 1 <= found <= largest:
        raise ArtifactError(
            f"law '{law}': structure is {dict(structure)}; needed is only '{key}', a whole number "
            f"from 1 to {largest}."
        )
    return found


def sizes(law: str, key: str, tried: Sequence[int], least: int, largest: int) -> tuple[int, ...]:
    """Return the candidate sizes of an estimator; raises FitError if one is invalid."""
    if not tried or any(type(x) is not int or not least <= x <= largest for x in tried):
        raise FitError(
            f"law '{law}': '{key}' is {list(tried)}; needed are whole numbers from {least} to "
            f"{largest}."
        )
    return tuple(tried)
