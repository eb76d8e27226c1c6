"""Dry friction of variable level, in C and by NumPy; `table.Loss` has its numbers.

    level = constant + load |torque| + direct ln(1 + |v| / speed) + evolution ln(1 + s / age)
    s' = 1 - (|v| / slip + 1 / longest) s

The torque is that of the carrier's springs and its gravity compensation. The age s is exact for a
speed that is constant over a step.
"""

from collections.abc import Callable, Sequence
from functools import cache

import sympy
from sympy.codegen.cfunctions import expm1, log1p

from fmu_src.equations.c_printer import function
from hesr_model.equations.functions import absolute
from hesr_model.equations.program import Definitions
from hesr_model.equations.stepping import numpy_function
from hesr_model.support.arrays import Array

NUMBERS = sympy.symbols(
    "constant load direct reference_speed evolution reference_age slip longest", real=True
)
CONSTANT, LOAD, DIRECT, REFERENCE_SPEED, EVOLUTION, REFERENCE_AGE, SLIP, LONGEST = NUMBERS
TORQUE, SPEED, AGE, STEP = sympy.symbols("torque speed age step", real=True)
"""Torque of the carrier [N.m], speed [rad/s], age [s], and step [s]."""

LEVEL, AGED = sympy.symbols("level aged", real=True)
_FIELDS = ("constant", "load", "direct", "speed", "evolution", "age", "slip", "longest")
"""Fields of `table.Loss` that have the numbers."""

_LEVEL_NUMBERS = (CONSTANT, LOAD, DIRECT, REFERENCE_SPEED, EVOLUTION, REFERENCE_AGE)
_AGE_NUMBERS = (SLIP, LONGEST)


def level_steps() -> Definitions:
    """Return the program of `LEVEL`, whose steps keep the order of the sum."""
    loaded, sliding = sympy.symbols("loaded sliding", real=True)
    return {
        loaded: CONSTANT + LOAD * absolute(TORQUE),
        sliding: loaded + DIRECT * log1p(absolute(SPEED) / REFERENCE_SPEED),
        LEVEL: sliding + EVOLUTION * log1p(AGE / REFERENCE_AGE),
    }


def renewal_rate() -> sympy.Expr:
    """Return the renewal rate of the contacts [1/s]."""
    return absolute(SPEED) / SLIP + 1 / LONGEST


def age_steps() -> Definitions:
    """Return the program of `AGED`, the age after a step."""
    rate, exponent = sympy.symbols("rate exponent", real=True)
    return {
        rate: renewal_rate(),
        exponent: -rate * STEP,
        AGED: AGE * sympy.exp(exponent) - expm1(exponent) / rate,
    }


@cache
def level_function() -> Callable[..., Sequence[Array]]:
    """Return the level as a NumPy function of torque, speed, age, and numbers of the loss."""
    return numpy_function([TORQUE, SPEED, AGE, *_LEVEL_NUMBERS], level_steps(), [LEVEL])


@cache
def age_function() -> Callable[..., Sequence[Array]]:
    """Return the next age as a NumPy function of speed, age, step, and numbers of the loss."""
    return numpy_function([SPEED, AGE, STEP, *_AGE_NUMBERS], age_steps(), [AGED])


def losses_header() -> str:
    """Return losses.h, with the level and the age of a loss."""
    numbers = {
        symbol: (symbol.name, f"loss->{field}")
        for symbol, field in zip(NUMBERS, _FIELDS, strict=True)
    }
    arguments = {symbol: (symbol.name, symbol.name) for symbol in (TORQUE, SPEED, AGE, STEP)}
    places = numbers | arguments
    level = function(
        "find_level(const Loss *loss, double torque, double speed, double age, OUT(level))",
        level_steps(),
        {"*level": LEVEL},
        places,
        library=True,
    )
    aged = function(
        "find_age(const Loss *loss, double speed, double age, double step, OUT(aged))",
        age_steps(),
        {"*aged": AGED},
        places,
        library=True,
    )
    return _HEADER.format(level=level, aged=aged)


_HEADER = """\
/* Generated: level [N.m] and age [s] of dry friction. */
#ifndef LOSSES_H
#define LOSSES_H

#include <math.h>

#include "signals.h"

/* Level under a torque [N.m] of the carrier, at a speed [rad/s] and an age [s]. */
{level}
/* Age after a step [s] at a constant speed [rad/s]. */
{aged}
#endif
"""
