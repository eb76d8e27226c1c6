"""Checks of the search space of a law's class: a sentence for each mistake, with its attribute."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from math import isfinite
from typing import NoReturn

import numpy as np
import sympy

from hesr_model.equations.memory import Element, Slow, Stop, to_expression
from hesr_model.errors import ConfigError
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import LawForm
from hesr_model.support.arrays import Array

# Motions at which rates and deflections are evaluated: both directions, slow and fast.
_SPEEDS = (-1.0, -0.1, 0.1, 1.0)  # [rad/s]
_POSITION = 0.3  # [rad]
_LOADS = (-5.0, 5.0)  # [N.m]

Numbers = Mapping[sympy.Symbol, sympy.Expr]


def refuse_class(law_name: str, attribute: str, reason: str, rule: str) -> NoReturn:
    """Raise ConfigError for an attribute of a law's class."""
    raise ConfigError(
        f"law '{law_name}': '{attribute}' {reason}.", code=f"law.class.{rule}", key=attribute
    )


def require_usable_space(law_name: str, form: LawForm, space: object) -> None:
    """Raise ConfigError if a search space does not suit the expressions of its law."""
    if not isinstance(space, SearchSpace):
        refuse_class(law_name, "space", f"is {type(space).__name__}; expected SearchSpace", "space")
    _require_each_coefficient_once(law_name, form, space)
    _require_numbers(law_name, space)
    _require_linear(law_name, form, space)
    for element in form.memory:
        _require_start(law_name, element, list(_list_samples(space)))


def _require_each_coefficient_once(law_name: str, form: LawForm, space: SearchSpace) -> None:
    coefficients = [quantity.name for quantity in form.coefficients]
    stated = [*space.names, *space.linear, *(name for name, _ in space.values)]
    for name in coefficients:
        if name not in stated:
            reason = (
                f"does not name the coefficient '{name}'; add it to 'bounds' to search it, to "
                "'linear' to solve for it, or to 'values'"
            )
            refuse_class(law_name, "space", reason, "missing")
    for name, count in Counter(stated).items():
        if count > 1:
            reason = f"names '{name}' {count} times in 'bounds', 'linear' and 'values'"
            refuse_class(law_name, "space", reason, "twice")
    # Numbers may also be searched of which only `values` depend.
    used_symbols = sympy.Tuple(*_read_values(space).values()).free_symbols
    known_names = {*coefficients, *map(str, used_symbols)}
    for name in stated:
        if name not in known_names:
            reason = f"names '{name}', which is none of {', '.join(coefficients)}"
            refuse_class(law_name, "space", reason, "unknown")


def _read_values(space: SearchSpace) -> Numbers:
    """Return the expressions of coefficients by symbol; numbers become expressions."""
    return {
        sympy.Symbol(name, real=True): to_expression("space", "values", value)
        for name, value in space.values
    }


def _require_numbers(law_name: str, space: SearchSpace) -> None:
    for name, (lower, upper) in space.bounds:
        if not (isfinite(lower) and isfinite(upper) and lower < upper):
            reason = f"are {lower:g} to {upper:g} for '{name}'; expected two rising numbers"
            refuse_class(law_name, "space.bounds", reason, "bounds")
    if not 0 <= space.non_negative <= len(space.linear):
        reason = f"is {space.non_negative}, but 'linear' has {len(space.linear)} names"
        refuse_class(law_name, "space.non_negative", reason, "non_negative")


def _require_linear(law_name: str, form: LawForm, space: SearchSpace) -> None:
    replacements = dict(_read_values(space))
    linear_symbols = [sympy.Symbol(name, real=True) for name in space.linear]
    memory_symbols = set()
    for element in form.memory:
        for part in element.parts:
            memory_symbols |= part.xreplace(replacements).free_symbols
    for symbol in linear_symbols:
        if symbol in memory_symbols:
            reason = f"names '{symbol}', which is in the memory; search it within 'bounds'"
            refuse_class(law_name, "space.linear", reason, "linear")
    output = sympy.expand_mul(form.output.xreplace(replacements))
    for symbol in _find_nonlinear(output, linear_symbols):
        reason = f"names '{symbol}', but the output is not linear in it; search it within 'bounds'"
        refuse_class(law_name, "space.linear", reason, "linear")
    offset = output.xreplace(dict.fromkeys(linear_symbols, sympy.S.Zero))
    if offset != 0:
        reason = f"leaves out a part of the output: {offset} has no coefficient of 'linear'"
        refuse_class(law_name, "space.linear", reason, "offset")


def _find_nonlinear(output: sympy.Expr, symbols: Sequence[sympy.Symbol]) -> list[sympy.Symbol]:
    """Return the symbols in which an output is not linear.

    First come those that are bent in themselves: of a product of two either may be searched.
    """
    slopes = [sympy.diff(output, symbol) for symbol in symbols]
    bent = [symbol for symbol, slope in zip(symbols, slopes, strict=True) if slope.has(symbol)]
    all_slopes = sympy.Tuple(*slopes)
    multiplied = [symbol for symbol in symbols if all_slopes.has(symbol)]
    return [*bent, *multiplied]


def _list_samples(space: SearchSpace) -> Iterator[Numbers]:
    """Yield searched numbers, at their bounds and between, with motions."""
    for share, speed, load in product((0.0, 0.5, 1.0), _SPEEDS, _LOADS):
        numbers = {
            sympy.Symbol(name, real=True): sympy.Float(lower + share * (upper - lower))
            for name, (lower, upper) in space.bounds
        }
        for symbol, value in _read_values(space).items():
            numbers[symbol] = value.xreplace(numbers)
        numbers |= {
            DQ: sympy.Float(speed),
            Q: sympy.Float(_POSITION),
            TAU_LOAD: sympy.Float(load),
        }
        yield numbers


def _require_start(law_name: str, element: Element, samples: list[Numbers]) -> None:
    """Raise ConfigError if a state has no steady state in motion, from which runs start."""
    if isinstance(element, Stop):
        values = _evaluate(element.deflection, samples)
        if np.any(values <= 0.0):
            reason = f"is {np.min(values):.3g}; it must be positive"
            refuse_class(law_name, f"memory.{element.name}.deflection", reason, "deflection")
        return
    values = _evaluate(element.rate, samples)
    attribute = f"memory.{element.name}.rate"
    if np.any(values < 0.0):
        k = int(np.argmin(values))
        if np.min(values) < 0.0 < np.max(values):
            remedy = "use absolute(DQ) for the speed"
        else:
            remedy = "turn its sign: x' = drive - rate x"
        speed = float(samples[k][DQ])
        reason = f"is {values[k]:.3g} at a velocity of {speed:g} rad/s; {remedy}"
        refuse_class(law_name, attribute, reason, "rate")
    if values.size and not np.any(values) and not isinstance(element, Slow):
        reason = (
            "is 0 in motion, so that the state has no steady value to start from; give it a "
            "rate, or use Slow, which starts at 0"
        )
        refuse_class(law_name, attribute, reason, "start")


def _evaluate(expression: sympy.Expr, samples: list[Numbers]) -> Array:
    """Return the real values of an expression without states at samples."""
    values = []
    for numbers in samples:
        value = expression.xreplace(dict(numbers)).doit().evalf()
        if not (value.is_number and value.is_finite and value.is_real):
            return np.zeros(0)  # rates with states have values only along a motion
        values.append(float(value))
    return np.array(values, dtype=float)
