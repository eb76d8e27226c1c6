"""Networks of velocity, hysteresis state and its derivative: standardised inputs and selection."""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, ClassVar

import numpy as np

from hesr_model.audit.audit import explodes
from hesr_model.equations.memory import Discretisation
from hesr_model.errors import ArtifactError, FitError
from hesr_model.fitting.estimator import Estimator
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.progress import counted, step

TRIED = 30  # maximum number for a torque in bounds
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """Inputs of a network for one (alpha, beta), each with mean 0 and spread 1 over all rows."""

    cell: Cell
    z: Array  # (N, 3) dq, h, dh
    mean: Array  # (3,) of dq [rad/s], h [1], dh [1/s]
    spread: Array  # (3,)

    @classmethod
    def of(cls, features: HysteresisFeatures, cell: Cell) -> "Inputs":
        """Run the hysteresis state of eq. 9 over the rows of a joint."""
        x = features.columns(cell.alpha, cell.beta)[:, 1:]
        mean, spread = x.mean(axis=0), np.maximum(x.std(axis=0), _TINY)
        return cls(cell=cell, z=(x - mean) / spread, mean=mean, spread=spread)


Costs = Callable[[Inputs, int], Array]
"""Errors on left-out rows by further hyper-parameters, for given inputs and size."""


class NetworkEstimator(Estimator):
    """Networks of several sizes at the best (alpha, beta), chosen by cross-validation."""

    key: ClassVar[str]  # of the size
    sizes: ClassVar[tuple[int, int]]  # smallest fitted and largest one

    def __init__(self, tried: Sequence[int], cells: int, discretisation: Discretisation) -> None:
        least, largest = self.sizes
        if not tried or any(type(x) is not int or not least <= x <= largest for x in tried):
            raise FitError(
                f"law '{self.name}': '{self.key}' is {list(tried)}; expected whole numbers from "
                f"{least} to {largest}."
            )
        self.tried = tuple(tried)
        self.cells = cells
        self.discretisation = discretisation

    @classmethod
    def size(cls, structure: Mapping[str, Any]) -> int:
        """Return the size from a structure {key: size}; raises ArtifactError if it is invalid."""
        found, largest = structure.get(cls.key), cls.sizes[1]
        if set(structure) != {cls.key} or type(found) is not int or not 1 <= found <= largest:
            raise ArtifactError(
                f"law '{cls.name}': structure is {dict(structure)}; expected only '{cls.key}', a "
                f"whole number from 1 to {largest}."
            )
        return found

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Cross-validate every choice and fit the best one (seeded by `rng`)."""
        largest = self.form({self.key: max(self.tried)})
        samples = JointRows.of(records, coefficients=len(largest.coefficients))
        features = HysteresisFeatures(samples=samples, discretisation=self.discretisation)
        return first_tame(self._best_first(candidates(features, self.cells), samples, rng), records)

    def _best_first(
        self, inputs: Sequence[Inputs], samples: JointRows, rng: np.random.Generator
    ) -> Iterator[FrictionLaw]:
        costs_of, law_of = self._search(samples, rng)
        choices = list(product(inputs, self.tried))
        costs = np.array([costs_of(*choice) for choice in counted(choices, step)])
        for place in np.argsort(costs, axis=None):
            i, *more = map(int, np.unravel_index(place, costs.shape))
            yield law_of(*choices[i], *more)

    @abstractmethod
    def _search(
        self, samples: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        """Return the costs of inputs and a size, and the law of these and indices of a cost."""

    def _of(self, size: int, values: Mapping[str, float]) -> FrictionLaw:
        structure = {self.key: size}
        return FrictionLaw(
            name=self.name,
            structure=structure,
            form=self.form(structure),
            values=values,
            discretisation=self.discretisation,
        )


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
        f"joint '{records[0].joint}': the torque of the best networks explodes just outside the "
        "trained speeds; record more motion."
    )
