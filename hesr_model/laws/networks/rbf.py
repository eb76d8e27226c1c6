"""RBFNN-H: network of the paper, Gaussians of velocity, hysteresis state and derivative."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy
from scipy.spatial.distance import cdist

from hesr_model.equations.memory import Discretisation
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.laws.networks.inputs import Costs, Inputs, NetworkEstimator
from hesr_model.laws.parfam.family import hysteresis_state
from hesr_model.support.arrays import Array

MAX_CENTRES = 40  # runs in microseconds
FACTORS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)  # widths, in mean distances of the centres
RIDGES = tuple(float(x) for x in 10.0 ** np.arange(-8, -1))
"""Ridges, added to the mean square of Gaussians with peak 1; sums of larger weights lose digits."""
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
        hysteresis, own = hysteresis_state("paper")
        inputs = (DQ, hysteresis.state, hysteresis.derivative)
        widths = [
            Coefficient(name=f"s_{x}", unit=unit, description=f"width of the Gaussians in {x}")
            for x, unit in _INPUTS
        ]
        bias = Coefficient(name="w_0", unit="N.m", description="offset")
        coefficients, output = [*widths, bias], bias.symbol
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
        return LawForm(coefficients=(*coefficients, *own), memory=(hysteresis,), output=output)

    def _search(
        self, samples: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        def law(inputs: Inputs, count: int, factor: int, ridge: int) -> FrictionLaw:
            centres, spacing = clustered(inputs.z, count, rng)
            width = FACTORS[factor] * spacing
            columns = gaussians(inputs.z, centres, width)
            bias, weights = ridge_weights(columns, samples.tau, (RIDGES[ridge],))
            return self._law(inputs, centres, width, float(bias[0]), weights[:, 0])

        return lambda inputs, count: left_out(inputs.z, samples, count, rng), law

    def _law(
        self, inputs: Inputs, centres: Array, width: float, bias: float, weights: Array
    ) -> FrictionLaw:
        values = {"w_0": bias, "alpha": inputs.cell.alpha, "beta": inputs.cell.beta}
        values |= {f"w_{k}": float(w) for k, w in enumerate(weights, start=1)}
        places = inputs.mean + inputs.spread * centres
        for i, (x, _) in enumerate(_INPUTS):
            values[f"s_{x}"] = float(inputs.spread[i] * width)
            values |= {f"m{k}_{x}": float(m) for k, m in enumerate(places[:, i], start=1)}
        return self._of(len(weights), values)


def left_out(z: Array, samples: JointRows, count: int, rng: np.random.Generator) -> Array:
    """Return (factors, ridges) mean square errors [N^2.m^2] of networks by cross-validation."""
    total = np.zeros((len(FACTORS), len(RIDGES)))
    for fold in samples.folds:
        centres, spacing = clustered(z[~fold], count, rng)
        for i, factor in enumerate(FACTORS):
            columns = gaussians(z, centres, factor * spacing)
            bias, weights = ridge_weights(columns[~fold], samples.tau[~fold], RIDGES)
            error = columns[fold] @ weights + bias - samples.tau[fold, None]
            total[i] += np.sum(error**2, axis=0)
    return total / len(samples.tau)


def clustered(z: Array, count: int, rng: np.random.Generator) -> tuple[Array, float]:
    """Return at most (count, 3) centres of z (N, 3), and their mean distance to the nearest."""
    # Equal rows break k-means.
    points = np.unique(z[:: max(1, len(z) // CLUSTERED_ROWS)], axis=0)
    with warnings.catch_warnings():
        # a centre without rows stays in place
        warnings.simplefilter("ignore", UserWarning)
        from scipy.cluster.vq import kmeans2  # slow to import

        centres, _ = kmeans2(points, min(count, len(points)), minit="++", rng=rng)
    distance = cdist(centres, centres)
    np.fill_diagonal(distance, np.inf)
    return centres, float(distance.min(axis=1).mean())


def gaussians(z: Array, centres: Array, width: float) -> Array:
    """Return the (N, K) Gaussians of inputs z (N, 3) about centres (K, 3), all standardised."""
    return np.asarray(np.exp(cdist(z, centres, "sqeuclidean") / (-2.0 * width**2)))


def ridge_weights(columns: Array, tau: Array, ridges: Sequence[float]) -> tuple[Array, Array]:
    """Return (R,) offsets and (K, R) weights [N.m] of R ridge regressions, with free offsets."""
    mean, level = columns.mean(axis=0), float(tau.mean())
    centred = columns - mean
    eigenvalues, vectors = np.linalg.eigh(centred.T @ centred / len(tau))
    moment = vectors.T @ (centred.T @ (tau - level)) / len(tau)
    weights = vectors @ (moment[:, None] / (np.maximum(eigenvalues, 0.0)[:, None] + ridges))
    return level - mean @ weights, weights
