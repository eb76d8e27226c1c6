"""Band of a law: torques that contain the measured friction with a given probability.

    w   = s(v, load) (ln(1 - coverage) / ln(1 - 0.95))^tail
    s^2 = floor^2 + slow^2 / (1 + (v/v_slow)^2) + rest^2 r + (fast v)^2 + (share load)^2
    r   = (1 - min((v/v_rest)^2, 1))^2, 1 at rest and 0 in motion

In motion tau - w and tau + w bound friction. At rest the band spans the torques of the law creeping
at its speed of a steady start both ways, and the floor, unless the calibration logs contain rests.
The tail is Weibull's. Slow joints have a lower v_rest (`find_rest_speed`).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from math import isfinite, sqrt

import numpy as np
import sympy
from numpy.typing import ArrayLike

from hesr_model.equations.component import Equation, Parameter, Quantity
from hesr_model.equations.functions import clip, larger, positive
from hesr_model.equations.memory import Element
from hesr_model.equations.program import Definitions, initial_state, initial_symbol
from hesr_model.equations.stepping import numpy_function
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, MOVING, TAU_LOAD, TORQUE
from hesr_model.support.arrays import Array

LEVEL = 0.95  # probability of the stored half-widths
REST = 0.005  # v_rest, the speed [rad/s, m/s] that ends the width of rest, of usual joints
MIN_COVERAGE = 0.5
MAX_COVERAGE = 0.999  # limits of the probability
LOWER = "tau_lower"
UPPER = "tau_upper"  # names of the outputs
REST_SPEED = sympy.Symbol("rest_speed", real=True)
"""Symbol of `REST`, so that NumPy and C divide by it."""

VARIANCE = sympy.Symbol("variance", real=True)
"""s^2 in the steps of `variance_steps`."""

_TINY_VARIANCE = sympy.Float(1e-24)  # [(N.m)^2], keeps the root differentiable if all numbers are 0

COVERAGE = Parameter(
    name="coverage",
    unit="1",
    description="share of measured torques within the band, from 0.5 to 0.999",
    start=LEVEL,
)


def find_rest_speed(steady_speed: float) -> float:
    """Return v_rest [rad/s, m/s] of a law whose motions start steadily from `steady_speed` on."""
    return REST * (steady_speed / MOVING)


def _define_number(name: str, unit: str, description: str, *, logical: bool = False) -> Quantity:
    text = f"{description}, of {{joint}}"
    return Quantity(name=f"band_{name}", unit=unit, description=text, logical=logical)


NUMBERS = (
    _define_number("floor", "N.m", "constant half-width at 95 %"),
    _define_number("slow", "N.m", "half-width at 95 % added by slow motion"),
    _define_number(
        "slow_speed", "rad/s", "speed that halves the square of the half-width of slow motion"
    ),
    _define_number("rest", "N.m", "half-width at 95 % added at rest"),
    _define_number("fast", "N.m.s/rad", "half-width at 95 % added by speed, per speed"),
    _define_number("load", "1", "half-width at 95 % added by load, per load"),
    _define_number("tail", "1", "exponent of the error's tail, 0.65 for a normal distribution"),
    _define_number(
        "envelope", "1", "whether the band at rest spans both break-away torques", logical=True
    ),
)  # in the order of the fields of `Band`
_FLOOR, _SLOW, SLOW_SPEED, _REST, _FAST, _LOAD, _TAIL, _ENVELOPE = (
    quantity.symbol for quantity in NUMBERS
)
_SIZES = (_FLOOR, _SLOW, _REST, _FAST, _LOAD)
_RESTING = sympy.Symbol("resting", real=True)
_SQUARES = sympy.symbols("floor_square slow_square rest_square fast_square load_square", real=True)


@dataclass(frozen=True, kw_only=True)
class Band:
    """Numbers of one joint's band (`NUMBERS`); ArtifactError if negative or not finite."""

    floor: float
    slow: float
    slow_speed: float
    rest: float
    fast: float
    load: float
    tail: float
    envelope: float

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isfinite(value) and value >= 0.0) or (field.name == "slow_speed" and not value):
                raise ArtifactError(
                    f"'{field.name}' of a band is {value}; expected a finite number of at least 0, "
                    "and a positive speed.",
                    code="law.band",
                    key=f"band.{field.name}",
                )

    def half_width(self, dq: float, tau_load: float = 0.0, *, rest_speed: float = REST) -> float:
        """Return the half-width [N.m] at 95 % in motion at a speed [rad/s] under a load [N.m]."""
        sizes = (self.floor, self.slow, self.rest, self.fast, self.load)
        parts = shapes(dq, tau_load, self.slow_speed, rest_speed)
        return sqrt(sum(size**2 * part for size, part in zip(sizes, parts, strict=True)))

    @property
    def values(self) -> Mapping[str, float]:
        """The numbers by the names of `NUMBERS`."""
        return {f"band_{f.name}": float(getattr(self, f.name)) for f in fields(self)}


def variance_steps(slow_speed: sympy.Expr = SLOW_SPEED) -> Definitions:
    """Return the program of `VARIANCE`.

    Its steps fix the order of operations in C and NumPy, which SymPy would change in one
    expression.
    """
    slow_ratio, rest_ratio, rest_width, fast_width, load_width = sympy.symbols(
        "slow_ratio rest_ratio rest_width fast_width load_width", real=True
    )
    first_two, first_three, first_four = sympy.symbols(
        "first_two first_three first_four", real=True
    )
    floor_square, slow_square, rest_square, fast_square, load_square = _SQUARES
    return {
        slow_ratio: DQ / slow_speed,
        rest_ratio: DQ / REST_SPEED,
        _RESTING: 1 - clip(rest_ratio**2, 1),
        rest_width: _REST * _RESTING,
        fast_width: _FAST * DQ,
        load_width: _LOAD * TAU_LOAD,
        floor_square: _FLOOR**2,
        slow_square: _SLOW**2 / (1 + slow_ratio**2),
        rest_square: rest_width**2,
        fast_square: fast_width**2,
        load_square: load_width**2,
        first_two: floor_square + slow_square,
        first_three: first_two + rest_square,
        first_four: first_three + fast_square,
        VARIANCE: first_four + load_square,
    }


@cache
def _shape_function() -> Callable[..., Sequence[Array]]:
    units = dict.fromkeys(_SIZES, sympy.S.One)
    steps = {symbol: step.xreplace(units) for symbol, step in variance_steps().items()}
    return numpy_function([DQ, TAU_LOAD, SLOW_SPEED, REST_SPEED], steps, _SQUARES)


def shapes(
    dq: ArrayLike, tau_load: ArrayLike, slow_speed: float, rest_speed: float = REST
) -> tuple[Array, ...]:
    """Return the factors of floor^2, slow^2, rest^2, fast^2 and load^2 in s^2."""
    parts = _shape_function()(dq, tau_load, slow_speed, rest_speed)
    return tuple(np.broadcast_to(part, np.shape(dq)) for part in parts)


def band_equations(
    memory: Sequence[Element],
    output: sympy.Expr,
    *,
    steady_speed: float = MOVING,
    squares: bool = False,
) -> tuple[Equation, ...]:
    """Return a band's outputs, or the `squares` of their distances, after intermediate values."""
    values: Definitions = {REST_SPEED: sympy.Float(find_rest_speed(steady_speed))}
    for symbol, expression in variance_steps().items():  # each uses earlier ones only
        values[symbol] = expression.xreplace(values)
    middle = (MAX_COVERAGE + MIN_COVERAGE) / 2
    reach = (MAX_COVERAGE - MIN_COVERAGE) / 2
    probability = middle + clip(COVERAGE.symbol - middle, reach)
    tail_ratio = sympy.log(1 - probability) / float(np.log(1 - LEVEL))
    factor = Equation(name="band_factor", expression=sympy.exp(_TAIL * sympy.log(tail_ratio)))
    deviation = sympy.sqrt(values[VARIANCE] + _TINY_VARIANCE)
    half_width = Equation(name="band", expression=deviation * factor.symbol)
    torque = sympy.Symbol(TORQUE, real=True)
    resting = _ENVELOPE * values[_RESTING] ** 2
    ahead, behind = (sympy.Symbol(name, real=True) for name in ("ahead", "behind"))

    def side(name: str, sign: int, text: str) -> Equation:
        edge = torque + sign * half_width.symbol
        furthest = sign * (larger(sign * ahead, sign * behind) + _FLOOR * factor.symbol)
        end = edge + resting * (furthest - edge)
        expression = end
        if squares:
            expression = positive(sign * (end - torque)) ** 2
        return Equation(
            name=name,
            unit="N.m",
            description=f"{text} end of the band of the measured friction {{effort}} of {{joint}}",
            expression=expression,
            output=True,
        )

    return (
        factor,
        half_width,
        *_creep_equations(memory, output, "ahead", steady_speed),
        *_creep_equations(memory, output, "behind", -steady_speed),
        side(LOWER, -1, "lower"),
        side(UPPER, 1, "upper"),
    )


def _creep_equations(
    memory: Sequence[Element], output: sympy.Expr, name: str, speed: float
) -> Iterator[Equation]:
    replacements = {DQ: sympy.Float(speed)}
    memory = [element.subs(replacements) for element in memory]
    lines = initial_state(memory, sympy.S.One)
    prefixed_symbols = {
        symbol: sympy.Symbol(f"{name}_{symbol.name}", real=True) for symbol in lines
    }
    replacements |= {element.state: sympy.S.Zero for element in memory}  # start of iterations
    for symbol, expression in lines.items():
        yield Equation(
            name=prefixed_symbols[symbol].name,
            expression=expression.xreplace(prefixed_symbols | replacements),
        )
    replacements |= {element.state: prefixed_symbols[initial_symbol(element)] for element in memory}
    replacements |= {element.derivative: sympy.S.Zero for element in memory}
    yield Equation(name=name, expression=output.xreplace(replacements))
