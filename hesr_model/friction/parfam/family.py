"""The family of eq. 11 with polynomial degree 1 as a law form.

    tau = c_0 + sum_i c_i x_i + sum_k c_gk g_k(theta_k0 + sum_i theta_ki x_i)

over features x from {dq, h, dh}, with the hysteresis state of eq. 9. A structure names the linear
terms and, for each unit, its function and its arguments; the constant feature is written "1".
"""

from collections.abc import Mapping
from typing import Any

import sympy

from hesr_model.errors import ArtifactError
from hesr_model.friction.functions import DQ
from hesr_model.friction.law import Coefficient, LawForm, Relaxation

FEATURES = ("1", "dq", "h", "dh")
"""Features in the order of every coefficient vector."""

FUNCTIONS = {"tanh": sympy.tanh, "sin": sympy.sin, "cos": sympy.cos, "exp": sympy.exp}
"""Functions g that a unit may have."""

_SUFFIX = {"1": "0", "dq": "dq", "h": "h", "dh": "dh"}
_UNIT = {"1": "N.m", "dq": "N.m.s/rad", "h": "N.m", "dh": "N.m.s"}
_ARGUMENT_UNIT = {"1": "1", "dq": "s/rad", "h": "1", "dh": "s"}


def linear_name(feature: str) -> str:
    """Name of the coefficient of a linear term."""
    return f"c_{_SUFFIX[feature]}"


def gain_name(unit: int) -> str:
    """Name of the factor of unit `unit` (from 1)."""
    return f"c_g{unit}"


def argument_name(unit: int, feature: str) -> str:
    """Name of the coefficient of a feature in the argument of unit `unit` (from 1)."""
    return f"theta{unit}_{_SUFFIX[feature]}"


def form(structure: Mapping[str, Any]) -> LawForm:
    """Return the expressions of a structure {"linear": [...], "units": [{"g", "arguments"}]}.

    Raises
    ------
    ArtifactError
        If a feature, a function or a key is not of the family.
    """
    linear, units = _checked(structure)
    hysteresis = Relaxation(name="h", unit="1", drive=_ALPHA * sympy.tanh(_BETA * DQ), rate=_ALPHA)
    symbols = dict(
        zip(FEATURES, (sympy.Integer(1), DQ, hysteresis.state, hysteresis.derivative), strict=True)
    )
    coefficients = [
        Coefficient(name=linear_name(x), unit=_UNIT[x], description=f"linear term in {x}")
        for x in linear
    ]
    output = sum(
        (c.symbol * symbols[x] for c, x in zip(coefficients, linear, strict=True)), sympy.Integer(0)
    )
    for k, (g, arguments) in enumerate(units, start=1):
        gain = Coefficient(name=gain_name(k), unit="N.m", description=f"factor of {g} {k}")
        inner = [
            Coefficient(
                name=argument_name(k, x),
                unit=_ARGUMENT_UNIT[x],
                description=f"{x} in the argument of {g} {k}",
            )
            for x in arguments
        ]
        argument = sum(c.symbol * symbols[x] for c, x in zip(inner, arguments, strict=True))
        output += gain.symbol * FUNCTIONS[g](argument)
        coefficients += [gain, *inner]
    if not output.free_symbols & {hysteresis.state, hysteresis.derivative}:
        return LawForm(coefficients=tuple(coefficients), output=output)
    return LawForm(
        coefficients=(*coefficients, *_HYSTERESIS), relaxations=(hysteresis,), output=output
    )


_HYSTERESIS = (
    Coefficient(name="alpha", unit="1/s", description="rate of the hysteresis state (eq. 9)"),
    Coefficient(name="beta", unit="s/rad", description="steepness of its drive (eq. 9)"),
)
_ALPHA, _BETA = (c.symbol for c in _HYSTERESIS)


def _checked(structure: Mapping[str, Any]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    if set(structure) != {"linear", "units"}:
        raise ArtifactError(
            f"ParFam structure has the keys {sorted(structure)}; needed are 'linear' and 'units'."
        )
    linear = list(structure["linear"])
    units = []
    for unit in structure["units"]:
        if set(unit) != {"g", "arguments"} or unit["g"] not in FUNCTIONS or not unit["arguments"]:
            raise ArtifactError(
                f"ParFam unit {dict(unit)} needs 'g' from {', '.join(FUNCTIONS)} and 'arguments'."
            )
        units.append((unit["g"], list(unit["arguments"])))
    for feature in [*linear, *(x for _, arguments in units for x in arguments)]:
        if feature not in FEATURES:
            raise ArtifactError(
                f"ParFam feature '{feature}' is unknown; known are {', '.join(FEATURES)}."
            )
    return linear, units
