"""Torque ripple in the joint angle: harmonics of the motor angle, chosen by cross-validation.

    sum_k (a_k cos(k N (q - lag dq)) + b_k sin(k N (q - lag dq))) / (1 + (k N smoothing dq)^2)

N is the gear ratio, k the order per turn of the motor. The logged torque lags the logged position
(3 ms on a UR10e change the phase by a quarter turn at 0.5 rad/s). The smoothing is that of a
servo's bandwidth.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from hesr_model.errors import ArtifactError
from hesr_model.fitting.joint_rows import JointRows, least_squares
from hesr_model.fitting.separable import SearchSpace, left_out_cost
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.support.arrays import Array, Mask

ORDERS = range(1, 17)  # per turn of the motor
LAG_BOUNDS = (0.0, 0.012)  # [s]
SMOOTHING_BOUNDS = (0.0, 0.02)  # [s]
MAX_ORDERS = 6  # orders of a joint
MIN_GAIN = 0.002  # smallest relative reduction of the left-out mean square by an order
CHANCE_GAIN = 18.0  # the same per row: the best of many orders gains by chance
LAG = Coefficient(name="lag", unit="s", description="lag behind the position")
SMOOTHING = Coefficient(name="smoothing", unit="s", description="time constant over fast ripple")
Times = tuple[float, float]  # lag and smoothing [s]
_SMOOTHINGS = (0.0, 1e-3, 2e-3, 4e-3, 8e-3)
_TIMES: list[Times] = [*product(map(float, np.linspace(*LAG_BOUNDS, 25)), _SMOOTHINGS)]
_NEAR_LAG = 2e-3
_ATTEMPTS = 3


def name_waves(orders: Sequence[int]) -> tuple[str, ...]:
    """Return the names of the amplitudes of a cosine and a sine of each order."""
    names: list[str] = []
    for order in orders:
        names += [f"ripple{order}_cos", f"ripple{order}_sin"]
    return tuple(names)


def describe_wave(order: int, wave: sympy.FunctionClass) -> str:
    """Return the description of the amplitude of a cosine or sine of the motor's angle."""
    name = "cosine" if wave is sympy.cos else "sine"
    return f"amplitude of the {name} of torque ripple {order} times per turn of the motor"


@dataclass(frozen=True, kw_only=True)
class Ripple:
    """Harmonics of a joint."""

    gear_ratio: float
    orders: tuple[int, ...]  # per turn of the motor

    @classmethod
    def from_structure(cls, data: Any) -> "Ripple":
        """Return the ripple of {"gear_ratio", "orders"}; raises ArtifactError if invalid."""
        try:
            return TypeAdapter(cls).validate_python(data)
        except ValidationError as error:
            raise ArtifactError(
                f"ripple {data!r} needs a number 'gear_ratio' and integers 'orders'.",
                code="law.ripple",
                key="structure",
            ) from error

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the amplitudes."""
        return name_waves(self.orders)

    def extend(self, form: LawForm) -> LawForm:
        """Return a form with the ripple added to its output."""
        angle = self.gear_ratio * (Q - LAG.symbol * DQ)
        fast = self.gear_ratio * SMOOTHING.symbol * DQ
        coefficients = list(form.coefficients)
        torque = sympy.Integer(0)
        waves = product(self.orders, (sympy.cos, sympy.sin))
        for name, (k, wave) in zip(self.names, waves, strict=True):
            description = describe_wave(k, wave)
            amplitude = Coefficient(name=name, unit="N.m", description=description)
            coefficients.append(amplitude)
            torque += amplitude.symbol * (wave(k * angle) / (1 + (k * fast) ** 2))
        coefficients += [LAG, SMOOTHING]
        return replace(form, coefficients=tuple(coefficients), output=form.output + torque)

    def extend_space(self, space: SearchSpace) -> SearchSpace:
        """Return the space of the extended form."""
        return replace(
            space,
            bounds=(*space.bounds, (LAG.name, LAG_BOUNDS), (SMOOTHING.name, SMOOTHING_BOUNDS)),
            linear=(*space.linear, *self.names),
        )

    def columns(self, rows: JointRows, times: Times) -> Array:
        """Return the (N, 2 orders) waves, cosines and sines."""
        lag, smoothing = times
        angle = self.gear_ratio * (rows.q - lag * rows.dq)
        fast = self.gear_ratio * smoothing * rows.dq
        waves = {k: wave / (1.0 + (k * fast) ** 2) for k, wave in _yield_powers(angle, self.orders)}
        parts: list[Array] = []
        for k in self.orders:
            parts += [waves[k].real, waves[k].imag]
        return np.stack(parts, axis=1)


def _yield_powers(angle: Array, orders: Collection[int]) -> Iterator[tuple[int, NDArray[Any]]]:
    turn = np.exp(1j * angle)
    rotated = np.ones_like(turn)
    for k in range(1, max(orders, default=0) + 1):
        rotated *= turn
        if k in orders:
            yield k, rotated


def select(
    base: Array, rows: JointRows, gear_ratio: float, folds: Sequence[Mask]
) -> tuple[Ripple, Times] | None:
    """Return the ripple with lag and smoothing that predicts left-out logs best, or None.

    `base` (N, L) are the columns of the law without ripple. Orders are added one by one while the
    error on left-out logs falls.
    """
    tau = rows.tau
    gain = max(MIN_GAIN, CHANCE_GAIN / len(tau))
    chosen_ripple = Ripple(gear_ratio=gear_ratio, orders=())
    times = _TIMES[0]
    columns = base
    cost = left_out_cost(base, tau, folds)

    def cross_validate(ripple: Ripple, trial_times: Times) -> float:
        return left_out_cost(np.hstack([base, ripple.columns(rows, trial_times)]), tau, folds)

    while len(chosen_ripple.orders) < MAX_ORDERS:
        residual = tau - columns @ least_squares(columns, tau)
        # The first order decides lag and smoothing; further ones only correct them.
        ranked_times = _TIMES
        near_times = _TIMES
        if chosen_ripple.orders:
            ranked_times = [times]
            near_times = [t for t in _TIMES if abs(t[0] - times[0]) < _NEAR_LAG]
        ranked = _rank_orders(rows, residual, chosen_ripple, ranked_times)
        for order, trial_times in ranked[:_ATTEMPTS]:
            extended = replace(chosen_ripple, orders=(*chosen_ripple.orders, order))
            if cross_validate(extended, trial_times) < (1.0 - gain) * cost:
                break
        else:
            break
        chosen_ripple = extended
        times = min(near_times, key=lambda at: cross_validate(chosen_ripple, at))
        cost = cross_validate(chosen_ripple, times)
        columns = np.hstack([base, chosen_ripple.columns(rows, times)])
    if not chosen_ripple.orders:
        return None
    return chosen_ripple, times


def _rank_orders(
    rows: JointRows, residual: Array, chosen_ripple: Ripple, candidates: Sequence[Times]
) -> list[tuple[int, Times]]:
    explained = []
    orders = [order for order in ORDERS if order not in chosen_ripple.orders]
    weights = {
        order: _weights(rows, chosen_ripple.gear_ratio, order, candidates) for order in orders
    }
    for lag in dict.fromkeys(lag for lag, _ in candidates):
        angle = chosen_ripple.gear_ratio * (rows.q - lag * rows.dq)
        for order, rotated in _yield_powers(angle, weights):
            smoothings, wave_sizes, squared = weights[order]
            # Cosine and sine, also of the doubled angle for their squares.
            moments = (wave_sizes * residual) @ rotated.view(float).reshape(-1, 2)
            doubled = squared @ (rotated * rotated).view(float).reshape(-1, 2)
            for i, smoothing in enumerate(smoothings):
                if (lag, smoothing) not in candidates:
                    continue
                weight_sum = squared[i].sum()
                c, s = doubled[i]
                # cos^2 = (1 + cos 2x) / 2, sin cos = sin 2x / 2; regular also without any motion.
                gram = 0.5 * np.array([[weight_sum + c, s], [s, weight_sum - c]]) + 1e-9 * np.eye(2)
                share = float(moments[i] @ np.linalg.solve(gram, moments[i]))
                explained.append((share, order, (lag, smoothing)))
    explained.sort(reverse=True)
    return [(order, times) for _, order, times in explained]


def starts(times: Times) -> Iterator[dict[str, float]]:
    """Yield lag and smoothing for local searches: as selected, and off the limit of smoothing.

    A search from the limit ends there or not, depending on round-off.
    """
    lag, smoothing = times
    for start in dict.fromkeys((smoothing, max(smoothing, _SMOOTHINGS[1]))):
        yield {LAG.name: lag, SMOOTHING.name: start}


def _weights(
    rows: JointRows, gear_ratio: float, order: int, candidates: Sequence[Times]
) -> tuple[list[float], Array, Array]:
    smoothings = list(dict.fromkeys(smoothing for _, smoothing in candidates))
    fast = order * gear_ratio * np.outer(smoothings, rows.dq)
    wave_sizes = 1.0 / (1.0 + fast**2)
    return smoothings, wave_sizes, wave_sizes**2
