"""Torque ripple in the joint angle: harmonics of the motor's angle, chosen by left-out logs.

    sum_k a_k cos(k N (q - lag dq)) + b_k sin(k N (q - lag dq))

N is the gear ratio, k the order per turn of the motor. The lag is the time by which the logged
torque follows the logged position: without it a ripple of constant amplitude turns its phase with
the speed and averages out (on a UR10e by a quarter turn at 0.5 rad/s, which is 3 ms).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from hesr_model.errors import ArtifactError
from hesr_model.friction.evaluate import Array
from hesr_model.friction.functions import DQ, Q
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.friction.samples import Rows, Samples, least_squares
from hesr_model.friction.separable import SearchSpace, left_out_cost

ORDERS = range(1, 17)
"""Orders per turn of the motor that are tried."""
LAG_BOUNDS = (0.0, 0.012)
"""Bounds of the lag [s]."""
MOST = 6
"""Orders that a joint gets at the most."""
GAIN = 0.002
"""An order stays if it lowers the mean square on left-out logs by this share."""
LAG = Coefficient(name="lag", unit="s", description="lag of the torque behind the position")
_LAGS = np.linspace(*LAG_BOUNDS, 25)
_NEAR = 2e-3
_ATTEMPTS = 3


@dataclass(frozen=True, kw_only=True)
class Ripple:
    """Which harmonics a joint has.

    Attributes
    ----------
    gear_ratio : turns of the motor per turn of the joint.
    orders : per turn of the motor.
    """

    gear_ratio: float
    orders: tuple[int, ...]

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> "Ripple":
        """Read {"gear_ratio", "orders"}.

        Raises
        ------
        ArtifactError
            If the data are not a ripple.
        """
        try:
            return cls(
                gear_ratio=float(data["gear_ratio"]), orders=tuple(int(k) for k in data["orders"])
            )
        except (KeyError, TypeError, ValueError) as error:
            raise ArtifactError(
                f"ripple {data!r} needs a number 'gear_ratio' and integers 'orders'."
            ) from error

    def to_json(self) -> dict[str, Any]:
        """Return JSON data."""
        return {"gear_ratio": self.gear_ratio, "orders": list(self.orders)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return tuple(f"ripple{k}_{part}" for k in self.orders for part in ("cos", "sin"))

    def extend(self, form: LawForm) -> LawForm:
        """Return a form with the ripple added to its output."""
        coefficients = [
            Coefficient(name=name, unit="N.m", description="amplitude of torque ripple")
            for name in self.names
        ]
        angle = self.gear_ratio * (Q - LAG.symbol * DQ)
        waves = [wave(k * angle) for k in self.orders for wave in (sympy.cos, sympy.sin)]
        torque = sum(c.symbol * w for c, w in zip(coefficients, waves, strict=True))
        return replace(
            form,
            coefficients=(*form.coefficients, *coefficients, LAG),
            output=form.output + torque,
        )

    def extend_space(self, space: SearchSpace) -> SearchSpace:
        """Return the space of the extended form."""
        return replace(
            space,
            bounds=(*space.bounds, (LAG.name, LAG_BOUNDS)),
            linear=(*space.linear, *self.names),
        )

    def columns(self, samples: Samples, lag: float) -> Array:
        """Return the (N, 2 orders) waves."""
        angle = self.gear_ratio * (samples.q - lag * samples.dq)
        waves = [wave(k * angle) for k in self.orders for wave in (np.cos, np.sin)]
        return np.stack(waves, axis=1)


def select(
    base: Array, samples: Samples, gear_ratio: float, folds: Sequence[Rows]
) -> tuple[Ripple, float] | None:
    """Return the ripple and its lag [s] that predict left-out logs best, or None.

    Orders are added one by one, the one that explains most of the residual first, as long as the
    left-out logs gain from it.

    Parameters
    ----------
    base : (N, L) columns of the law without ripple.
    samples : rows of the joint.
    gear_ratio : turns of the motor per turn of the joint.
    folds : (N,) masks of the rows that are left out in turn.
    """
    tau = samples.tau
    chosen, lag = Ripple(gear_ratio=gear_ratio, orders=()), 0.0
    columns, cost = base, left_out_cost(base, tau, folds)
    while len(chosen.orders) < MOST:
        residual = tau - columns @ least_squares(columns, tau)
        found = None
        for order, at in _ranking(samples, residual, chosen, lag)[:_ATTEMPTS]:
            candidate = replace(chosen, orders=(*chosen.orders, order))
            together = np.hstack([base, candidate.columns(samples, at)])
            trial = left_out_cost(together, tau, folds)
            if trial < (1.0 - GAIN) * cost:
                found = candidate, at
                break
        if found is None:
            break
        chosen, _ = found
        # All orders share one lag, which more orders determine better.
        lags = _LAGS if len(chosen.orders) == 1 else _LAGS[np.abs(_LAGS - lag) < _NEAR]
        costs = [
            left_out_cost(np.hstack([base, chosen.columns(samples, at)]), tau, folds) for at in lags
        ]
        lag, cost = float(lags[int(np.argmin(costs))]), min(costs)
        columns = np.hstack([base, chosen.columns(samples, lag)])
    return (chosen, lag) if chosen.orders else None


def _ranking(
    samples: Samples, residual: Array, chosen: Ripple, lag: float
) -> list[tuple[int, float]]:
    """Return (order, lag), those that explain most of the residual first.

    The first order brings the lag with it; later ones take that of the first.
    """
    lags = [lag] if chosen.orders else _LAGS
    explained = []
    for order in ORDERS:
        if order in chosen.orders:
            continue
        single = replace(chosen, orders=(order,))
        for at in lags:
            waves = single.columns(samples, at)
            moment = waves.T @ residual
            share = float(moment @ np.linalg.solve(waves.T @ waves + 1e-9 * np.eye(2), moment))
            explained.append((share, order, float(at)))
    explained.sort(reverse=True)
    return [(order, at) for _, order, at in explained]
