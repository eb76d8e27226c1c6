"""RBFNN-H of the paper, and networks of velocity, hysteresis state and its derivative."""

import warnings
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Any, ClassVar

import numpy as np
import scipy
import sympy

from hesr_model.audit.audit import explodes
from hesr_model.equations.memory import Discretisation
from hesr_model.errors import ArtifactError, FitError
from hesr_model.fitting.estimator import Estimator, register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.family import hysteresis_state
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.progress import report_progress, step

MAX_TRIED_LAWS = 30  # maximum number for a torque in bounds
_MIN_SPREAD = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class NetworkInputs:
    """Inputs of a network for one (alpha, beta), each with mean 0 and spread 1 over all rows."""

    cell: Cell
    z: Array  # (N, 3) dq, h, dh
    mean: Array  # (3,) of dq [rad/s], h [1], dh [1/s]
    spread: Array  # (3,)

    @classmethod
    def from_features(cls, features: HysteresisFeatures, cell: Cell) -> "NetworkInputs":
        """Run the hysteresis state of eq. 9 over the rows of a joint."""
        x = features.columns(cell.alpha, cell.beta)[:, 1:]
        mean = x.mean(axis=0)
        spread = np.maximum(x.std(axis=0), _MIN_SPREAD)
        return cls(cell=cell, z=(x - mean) / spread, mean=mean, spread=spread)


Costs = Callable[[NetworkInputs, int], Array]  # left-out errors by hyper-parameters, for a size


class NetworkEstimator(Estimator):
    """Networks of several sizes at the best (alpha, beta), chosen by cross-validation."""

    key: ClassVar[str]  # of the size
    sizes: ClassVar[tuple[int, int]]  # smallest fitted and largest one

    def __init__(
        self, tried_sizes: Sequence[int], cells: int, discretisation: Discretisation
    ) -> None:
        smallest, largest = self.sizes
        if not tried_sizes or any(
            type(size) is not int or not smallest <= size <= largest for size in tried_sizes
        ):
            raise FitError(
                f"law '{self.name}': '{self.key}' is {list(tried_sizes)}; expected whole numbers "
                f"from {smallest} to {largest}."
            )
        self.tried_sizes = tuple(tried_sizes)
        self.cells = cells
        self.discretisation = discretisation

    @classmethod
    def size(cls, structure: Mapping[str, Any]) -> int:
        """Return the size from a structure {key: size}; raises ArtifactError if it is invalid."""
        size = structure.get(cls.key)
        largest = cls.sizes[1]
        if set(structure) != {cls.key} or type(size) is not int or not 1 <= size <= largest:
            raise ArtifactError(
                f"law '{cls.name}': structure is {dict(structure)}; expected only '{cls.key}', a "
                f"whole number from 1 to {largest}.",
                code="law.structure",
                key="structure",
            )
        return size

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Cross-validate every choice and fit the best one (seeded by `rng`)."""
        largest_form = self.form({self.key: max(self.tried_sizes)})
        rows = JointRows.from_records(records, coefficients=len(largest_form.coefficients))
        features = HysteresisFeatures(rows=rows, discretisation=self.discretisation)
        return find_bounded_law(
            self._rank_laws(find_candidates(features, self.cells), rows, rng), records
        )

    def _rank_laws(
        self, inputs: Sequence[NetworkInputs], rows: JointRows, rng: np.random.Generator
    ) -> Iterator[FrictionLaw]:
        compute_costs, build_law = self._search(rows, rng)
        choices = list(product(inputs, self.tried_sizes))
        costs = np.array([compute_costs(*choice) for choice in report_progress(choices, step)])
        for flat_index in np.argsort(costs, axis=None):
            i, *cost_indices = map(int, np.unravel_index(flat_index, costs.shape))
            yield build_law(*choices[i], *cost_indices)

    @abstractmethod
    def _search(
        self, rows: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        """Return the costs of inputs and a size, and the law of these and indices of a cost."""

    def _build_law(self, size: int, values: Mapping[str, float]) -> FrictionLaw:
        structure = {self.key: size}
        return FrictionLaw(
            name=self.name,
            structure=structure,
            form=self.form(structure),
            values=values,
            discretisation=self.discretisation,
        )


def find_candidates(features: HysteresisFeatures, count: int) -> list[NetworkInputs]:
    """Return the inputs at the best `count` distinct (alpha, beta) of stage 1."""
    cells = calibrate.select_distinct(calibrate.compute_profile(features), count)
    return [NetworkInputs.from_features(features, cell) for cell in cells]


def find_bounded_law(
    laws: Iterable[FrictionLaw], joint_records: Sequence[FrictionRecord]
) -> FrictionLaw:
    """Return the first law with a bounded torque; FitError if `MAX_TRIED_LAWS` explode."""
    trained_range = TrainedRange.from_records(joint_records)
    for law in islice(laws, MAX_TRIED_LAWS):
        if not explodes(law, trained_range):
            return law
    raise FitError(
        f"joint '{joint_records[0].joint}': the torque of the best networks explodes just outside "
        "the trained speeds; record more motion."
    )


MAX_CENTRES = 40  # runs in microseconds
WIDTH_FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # widths, in mean distances of the centres
# Added to the mean square of Gaussians with peak 1; sums of larger weights lose digits.
RIDGES = tuple(float(x) for x in 10.0 ** np.arange(-8, -1))
CLUSTERED_ROWS = 2400  # for k-means
_INPUTS = (("dq", "rad/s"), ("h", "1"), ("dh", "1/s"))


@register
class RbfnnH(NetworkEstimator):
    """tau = w_0 + sum_k w_k exp(-1/2 sum_i ((x_i - m_ki) / s_i)^2), x = (dq, h, h').

    K-means places the m_k on the standardised inputs, the width is a factor times their mean
    distance to the nearest one, and ridge regression gives the weights. Cross-validation selects
    (alpha, beta), number, factor and ridge. As in the paper, linear terms are missing.
    """

    name = "rbfnn_h"
    title = "RBFNN-H"
    order = 120
    paper = 3
    key = "centres"
    sizes = (2, MAX_CENTRES)
    typical: ClassVar[Mapping[str, Any]] = {"centres": 1}

    def __init__(
        self,
        *,
        centres: Sequence[int] = (10, 20, 40),
        cells: int = 3,
        discretisation: Discretisation = "exact",
    ) -> None:
        super().__init__(centres, cells, discretisation)

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of {"centres": number of Gaussians}."""
        hysteresis, state_coefficients = hysteresis_state("paper")
        inputs = (DQ, hysteresis.state, hysteresis.derivative)
        widths = [
            Coefficient(name=f"s_{x}", unit=unit, description=f"width of the Gaussians in {x}")
            for x, unit in _INPUTS
        ]
        bias = Coefficient(name="w_0", unit="N.m", description="offset")
        coefficients = [*widths, bias]
        output = bias.symbol
        for k in range(1, cls.size(structure) + 1):
            weight = Coefficient(name=f"w_{k}", unit="N.m", description=f"weight of Gaussian {k}")
            centre = [
                Coefficient(name=f"m{k}_{x}", unit=unit, description=f"{x} at Gaussian {k}")
                for x, unit in _INPUTS
            ]
            square = sum(
                ((x - m.symbol) / s.symbol) ** 2
                for x, m, s in zip(inputs, centre, widths, strict=True)
            )
            output += weight.symbol * sympy.exp(-square / 2)
            coefficients += [weight, *centre]
        return LawForm(
            coefficients=(*coefficients, *state_coefficients), memory=(hysteresis,), output=output
        )

    def _search(
        self, rows: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        def build_law(inputs: NetworkInputs, count: int, factor: int, ridge: int) -> FrictionLaw:
            centres, spacing = cluster_centres(inputs.z, count, rng)
            width = WIDTH_FACTORS[factor] * spacing
            columns = gaussians(inputs.z, centres, width)
            bias, weights = ridge_weights(columns, rows.tau, (RIDGES[ridge],))
            return self._law(inputs, centres, width, float(bias[0]), weights[:, 0])

        return lambda inputs, count: cross_validate(inputs.z, rows, count, rng), build_law

    def _law(
        self, inputs: NetworkInputs, centres: Array, width: float, bias: float, weights: Array
    ) -> FrictionLaw:
        values = {"w_0": bias, "alpha": inputs.cell.alpha, "beta": inputs.cell.beta}
        values |= {f"w_{k}": float(w) for k, w in enumerate(weights, start=1)}
        raw_centres = inputs.mean + inputs.spread * centres
        for i, (x, _) in enumerate(_INPUTS):
            values[f"s_{x}"] = float(inputs.spread[i] * width)
            values |= {f"m{k}_{x}": float(m) for k, m in enumerate(raw_centres[:, i], start=1)}
        return self._build_law(len(weights), values)


def cross_validate(z: Array, rows: JointRows, count: int, rng: np.random.Generator) -> Array:
    """Return (factors, ridges) mean square errors [N^2.m^2] of networks by cross-validation."""
    total = np.zeros((len(WIDTH_FACTORS), len(RIDGES)))
    for fold in rows.folds:
        centres, spacing = cluster_centres(z[~fold], count, rng)
        for i, factor in enumerate(WIDTH_FACTORS):
            columns = gaussians(z, centres, factor * spacing)
            bias, weights = ridge_weights(columns[~fold], rows.tau[~fold], RIDGES)
            error = columns[fold] @ weights + bias - rows.tau[fold, None]
            total[i] += np.sum(error**2, axis=0)
    return total / len(rows.tau)


def cluster_centres(z: Array, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return at most (count, 3) centres of z (N, 3), and their mean distance to the nearest."""
    # Equal rows break k-means.
    points = np.unique(z[:: max(1, len(z) // CLUSTERED_ROWS)], axis=0)
    with warnings.catch_warnings():
        # a centre without rows stays in place
        warnings.simplefilter("ignore", UserWarning)
        from scipy.cluster.vq import kmeans2  # slow to import

        centres, _ = kmeans2(points, min(count, len(points)), minit="++", rng=rng)
    distance = scipy.spatial.distance.cdist(centres, centres)
    np.fill_diagonal(distance, np.inf)
    return centres, float(distance.min(axis=1).mean())


def gaussians(z: Array, centres: Array, width: float) -> Array:
    """Return the (N, K) Gaussians of inputs z (N, 3) about centres (K, 3), all standardised."""
    squares = scipy.spatial.distance.cdist(z, centres, "sqeuclidean")
    return np.asarray(np.exp(squares / (-2.0 * width**2)))


def ridge_weights(columns: Array, tau: Array, ridges: Sequence[float]) -> tuple[Array, Array]:
    """Return (R,) offsets and (K, R) weights [N.m] of R ridge regressions, with free offsets."""
    mean = columns.mean(axis=0)
    level = float(tau.mean())
    centred = columns - mean
    eigenvalues, vectors = np.linalg.eigh(centred.T @ centred / len(tau))
    moment = vectors.T @ (centred.T @ (tau - level)) / len(tau)
    weights = vectors @ (moment[:, None] / (np.maximum(eigenvalues, 0.0)[:, None] + ridges))
    return level - mean @ weights, weights
