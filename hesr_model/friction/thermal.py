"""Thermal models: factors on Coulomb and viscous friction, and the heat of friction.

    Coulomb     c(T) = c_0 (1 - b_c (T - T_0))       viscous    n(T) = n_0 exp(-b_v (T - T_0))
    heat        x' = (R |tau dq| - x) / T_th         T = T_a + x, within its trained range

The exponential is Reynolds' law of viscosity.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite

import numpy as np
import sympy

from hesr_model.equations.component import Parameter, Quantity
from hesr_model.equations.functions import absolute, clip, larger
from hesr_model.equations.memory import Slow
from hesr_model.equations.recurrence import recurrence
from hesr_model.equations.stepping import numpy_function
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ
from hesr_model.support.arrays import Array

TEMPERATURE = Quantity(name="temperature", unit="degC", description="temperature of {joint}")
COULOMB_RANGE = 0.5  # largest relative change of the Coulomb factor
VISCOUS_RANGE = 1.5  # largest logarithm of the viscous factor: 0.22 to 4.5
_MIN_TIME_CONSTANT = 1e-3  # [s], rates divide by it
_MIN_SCALE = 1e-3  # bounds stay positive


@dataclass(frozen=True, kw_only=True)
class Thermal:
    """Thermal model of one joint in the units of `_UNITS`; ArtifactError if invalid."""

    coulomb: float
    viscous: float
    coulomb_scale: float = 1.0
    viscous_scale: float = 1.0
    reference: float = 20.0
    resistance: float = 1.0  # 1 if no temperature was `measured`
    time_constant: float = 1200.0
    ambient: float = 20.0
    coldest: float = -273.15  # trained range, unknown in older files
    warmest: float = 1e4
    measured: bool = True

    def __post_init__(self) -> None:
        for name in _UNITS:
            value = getattr(self, name)
            is_positive = name in ("coulomb_scale", "viscous_scale", "time_constant")
            if not isfinite(value) or (is_positive and value <= 0.0):
                expectation = "a positive number" if is_positive else "a number"
                raise ArtifactError(
                    f"thermal model: '{name}' is {value}; expected {expectation}.",
                    code="law.thermal",
                    key=f"thermal.{name}",
                )

    def factors(self, temperature: Array) -> tuple[Array, Array]:
        """Return the Coulomb and viscous factors at temperatures (N,) [degC]."""
        excess = np.clip(temperature, self.coldest, self.warmest) - self.reference
        values = [getattr(self, name) for name in _FACTOR_PARAMETERS]
        coulomb, viscous = _factor_function()(excess, *values)
        return coulomb, viscous

    def rise(self, power: Array, dt: Array, start: float = 0.0) -> Array:
        """Return the rise (N,) [K] over the ambient for power (N,) [W] held over `dt` (N,) [s]."""
        a = np.exp(-dt / self.time_constant)
        return self.resistance * recurrence(a, (1.0 - a) * power, start / self.resistance)


_UNITS = {
    "coulomb": ("1/K", "relative decrease of Coulomb friction with temperature"),
    "viscous": ("1/K", "exponent of the decrease of viscous friction with temperature"),
    "coulomb_scale": ("1", "factor on Coulomb friction at the reference temperature"),
    "viscous_scale": ("1", "factor on viscous friction at the reference temperature"),
    "reference": ("degC", "reference temperature"),
    "resistance": ("K/W", "thermal resistance between joint and ambient"),
    "time_constant": ("s", "thermal time constant"),
    "ambient": ("degC", "ambient temperature"),
    "coldest": ("degC", "lowest temperature in training, which limits that of the factors"),
    "warmest": ("degC", "highest temperature in training, which limits that of the factors"),
}

_FACTOR_PARAMETERS = ("coulomb", "viscous", "coulomb_scale", "viscous_scale")


def thermal_symbol(name: str) -> sympy.Symbol:
    """Return the symbol of a parameter of `Thermal`."""
    return sympy.Symbol(f"thermal_{name}", real=True)


def friction_factors(
    excess: sympy.Expr, coulomb_scale: sympy.Expr, viscous_scale: sympy.Expr
) -> tuple[sympy.Expr, sympy.Expr]:
    """Return the Coulomb and the viscous factor at an `excess` [K] over the reference."""
    coulomb = clip(thermal_symbol("coulomb") * excess, COULOMB_RANGE)
    viscous = clip(thermal_symbol("viscous") * excess, VISCOUS_RANGE)
    return coulomb_scale * (1 - coulomb), viscous_scale * sympy.exp(-viscous)


@cache
def _factor_function() -> Callable[..., Sequence[Array]]:
    excess = sympy.Symbol("over", real=True)
    parameters = [thermal_symbol(name) for name in _FACTOR_PARAMETERS]
    factors = friction_factors(excess, *parameters[2:])
    coulomb_factor, viscous_factor = sympy.symbols("coulomb_factor viscous_factor", real=True)
    steps = {coulomb_factor: factors[0], viscous_factor: factors[1]}
    return numpy_function([excess, *parameters], steps, [coulomb_factor, viscous_factor])


RISE = "rise"
THERMOMETER = "thermometer"  # parameter that selects the temperature input


def thermal_parameters(thermal: Thermal) -> tuple[Parameter, ...]:
    """Return the parameters of a joint's thermal model."""
    parameters = (
        Parameter(
            name=f"thermal_{name}", unit=unit, description=text, start=float(getattr(thermal, name))
        )
        for name, (unit, text) in _UNITS.items()
    )
    thermometer = Parameter(
        name=THERMOMETER,
        unit="1",
        start=float(thermal.measured),
        description="whether the input temperature is used; else friction power determines it",
        logical=True,
    )
    return (*parameters, thermometer)


@dataclass(frozen=True, kw_only=True)
class Warmth:
    """Expressions of a thermal model: its lumped mass, and factors on friction."""

    memory: Slow
    coulomb: sympy.Expr
    viscous: sympy.Expr


def warmth(torque: sympy.Expr) -> Warmth:
    """Return the expressions of a thermal model heated by a torque [N.m]."""
    symbols = {name: thermal_symbol(name) for name in _UNITS}
    use_thermometer = clip(sympy.Symbol(THERMOMETER, real=True), 1)
    rate = 1 / larger(symbols["time_constant"], _MIN_TIME_CONSTANT)
    heat = Slow(
        name=RISE, unit="K", drive=rate * symbols["resistance"] * absolute(torque * DQ), rate=rate
    )
    temperature = use_thermometer * TEMPERATURE.symbol + (1 - use_thermometer) * (
        symbols["ambient"] + heat.state
    )
    excess = (
        -larger(-symbols["warmest"], -larger(temperature, symbols["coldest"]))
        - symbols["reference"]
    )
    coulomb, viscous = friction_factors(
        excess,
        larger(symbols["coulomb_scale"], _MIN_SCALE),
        larger(symbols["viscous_scale"], _MIN_SCALE),
    )
    return Warmth(memory=heat, coulomb=coulomb, viscous=viscous)
