"""MLP-H."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.networks.inputs import Costs, Inputs, NetworkEstimator
from hesr_model.laws.networks.training import Network, path
from hesr_model.laws.parfam import evolve, family
from hesr_model.support.arrays import Array, Mask

MAX_HIDDEN = 16  # largest hidden layer
DECAYS = (3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6)
"""Weight decays on standardised data; each network starts from that of the previous decay."""
SEARCHED_ROWS = 1600
"""Rows for the comparison of choices; the chosen network is trained on all rows."""
_TINY = 1e-12


@register
class MlpH(NetworkEstimator):
    """tau = c_0 + sum_k c_k tanh(theta_k . (1, dq, h, h')).

    Levenberg-Marquardt with weight decay trains networks. (alpha, beta), size and decay predict
    left-out logs best on average over the random starts; the best-fitting start is used.
    """

    name = "mlp_h"
    title = "MLP-H"
    order = 110
    key = "hidden"
    sizes = (1, MAX_HIDDEN)
    typical: ClassVar[Mapping[str, Any]] = {"hidden": 1}

    def __init__(
        self,
        *,
        hidden: Sequence[int] = (2, 4, 8, 16),
        cells: int = 3,
        starts: int = 2,
        discretisation: Discretisation = "exact",
    ) -> None:
        super().__init__(hidden, cells, discretisation)
        self.starts = starts

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of {"hidden": size}: those of ParFam with as many units."""
        unit = {"g": "tanh", "arguments": list(family.FEATURES)}
        return family.form({"linear": ["1"], "units": [unit] * cls.size(structure)})

    def _search(
        self, samples: JointRows, rng: np.random.Generator
    ) -> tuple[Costs, Callable[..., FrictionLaw]]:
        level, scale = float(samples.tau.mean()), max(float(samples.tau.std()), _TINY)
        y, folds = (samples.tau - level) / scale, samples.folds
        starts = {
            hidden: [evolve.starting_points(rng, hidden, 4).T for _ in range(self.starts)]
            for hidden in self.tried
        }

        def law(inputs: Inputs, hidden: int, decay: int) -> FrictionLaw:
            decays = DECAYS[: decay + 1]
            found = [path(inputs.z, y, theta, decays)[-1] for theta in starts[hidden]]
            return self._law(inputs, min(found, key=lambda network: network.cost), level, scale)

        return lambda inputs, hidden: left_out(inputs.z, y, folds, starts[hidden]), law

    def _law(self, inputs: Inputs, network: Network, level: float, scale: float) -> FrictionLaw:
        gains, theta = network.gains, network.theta
        # tanh is odd: positive gains, largest first, make the printed network unique.
        theta = np.where(gains < 0.0, -theta, theta)
        gains = np.abs(gains)
        order = np.argsort(-gains, kind="stable")
        slopes = theta[1:] / inputs.spread[:, None]
        arguments = np.vstack([theta[0] - inputs.mean @ slopes, slopes])
        values = {
            family.linear_name("1"): level + scale * network.bias,
            "alpha": inputs.cell.alpha,
            "beta": inputs.cell.beta,
        }
        for k, unit in enumerate(order, start=1):
            values[family.gain_name(k)] = float(scale * gains[unit])
            for x, value in zip(family.FEATURES, arguments[:, unit], strict=True):
                values[family.argument_name(k, x)] = float(value)
        return self._of(len(gains), values)


def left_out(z: Array, y: Array, folds: Sequence[Mask], starts: Sequence[Array]) -> Array:
    """Return (decays,) mean squares on left-out rows, relative to the variance of the torque.

    Standardised `z` (N, 3), `y` (N,); masks (N,) of left-out rows; hidden layers (4, H).
    """
    stride = max(1, len(y) // SEARCHED_ROWS)
    total = np.zeros(len(DECAYS))
    for fold in folds:
        trained = np.flatnonzero(~fold)[::stride]
        for theta in starts:
            for i, network in enumerate(path(z[trained], y[trained], theta, DECAYS)):
                total[i] += np.sum((network.output(z[fold]) - y[fold]) ** 2)
    return total / (len(y) * len(starts))
