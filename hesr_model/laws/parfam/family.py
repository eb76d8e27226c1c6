"""The family of eq. 11 with polynomial degree 1 as a law form.

    tau = c_0 + sum_i c_i x_i + sum_k c_gk g_k(theta_k0 + sum_i theta_ki x_i)

over features x from {dq, h, dh}, with the hysteresis state of eq. 9. A structure names the linear
terms and, for each unit, its function and its arguments; the constant feature is written "1".
"""

from collections.abc import Mapping, Sequence
from typing import Any

import sympy

from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import V_S

FEATURES = ("1", "dq", "h", "dh")  # in the order of coefficient vectors
LINEAR = (*FEATURES, "h_load", "h_bump")  # h |tau_load| and h exp(-(dq/v_s)^2)
DIVISORS = ("dq", "h")  # h' is unbounded and would allow poles
STATES = ("paper", "generalised", "bristle")  # eq. 9; with position memory; LuGre's bristle
FUNCTIONS = {"tanh": sympy.tanh, "sin": sympy.sin, "cos": sympy.cos, "exp": sympy.exp}
_UNIT = {"1": "N.m", "dq": "N.m.s/rad", "h": "N.m", "dh": "N.m.s", "h_load": "1", "h_bump": "N.m"}
_ARGUMENT_UNIT = {"1": "1", "dq": "s/rad", "h": "1", "dh": "s"}


def _suffix(feature: str) -> str:
    return "0" if feature == "1" else feature


def linear_name(feature: str) -> str:
    """Return the name of the coefficient of a linear term."""
    return f"c_{_suffix(feature)}"


def gain_name(unit: int) -> str:
    """Return the name of the factor of a unit, from 1."""
    return f"c_g{unit}"


def argument_name(unit: int, feature: str) -> str:
    """Return the name of the coefficient of a feature in the argument of a unit, from 1."""
    return f"theta{unit}_{_suffix(feature)}"


def denominator_name(feature: str) -> str:
    """Return the name of the coefficient of a feature in the denominator."""
    return f"d_{_suffix(feature)}"


def form(structure: Mapping[str, Any]) -> LawForm:
    """Return the expressions of a structure {"linear": [...], "units": [{"g", "arguments"}]}.

    Optional keys are "state", one of `STATES`, and "denominator", features x of 1 + sum_i d_i x_i
    below the output. Raises ArtifactError if one is unknown.
    """
    linear, units, state, denominator = _validate_structure(structure)
    hysteresis, state_coefficients = hysteresis_state(state)
    h = hysteresis.state
    dh = hysteresis.derivative
    symbols = {
        "1": sympy.Integer(1),
        "dq": DQ,
        "h": h,
        "dh": dh,
        "h_load": h * absolute(TAU_LOAD),
        "h_bump": h * sympy.exp(-((DQ / V_S.symbol) ** 2)),
    }

    def build_weighted_sum(weights: Sequence[Coefficient], features: Sequence[str]) -> sympy.Expr:
        products = (weight.symbol * symbols[x] for weight, x in zip(weights, features, strict=True))
        return sum(products, sympy.Integer(0))

    coefficients = [
        Coefficient(name=linear_name(x), unit=_UNIT[x], description=f"linear term in {x}")
        for x in linear
    ]
    terms = [build_weighted_sum(coefficients, linear)]
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
        terms.append(gain.symbol * FUNCTIONS[g](build_weighted_sum(inner, arguments)))
        coefficients += [gain, *inner]
    if "h_bump" in linear and state != "bristle":
        coefficients.append(V_S)
    divisors = [
        Coefficient(
            name=denominator_name(x), unit=_ARGUMENT_UNIT[x], description=f"{x} in the denominator"
        )
        for x in denominator
    ]
    # A sum of two at a time is slow.
    output = sympy.Add(*terms) / (1 + build_weighted_sum(divisors, denominator))
    coefficients += divisors
    if not output.free_symbols & {h, dh}:
        return LawForm(coefficients=tuple(coefficients), output=output)
    return LawForm(
        coefficients=(*coefficients, *state_coefficients), memory=(hysteresis,), output=output
    )


def hysteresis_state(kind: str) -> tuple[Relaxation, tuple[Coefficient, ...]]:
    """Return the hysteresis state and its coefficients.

    The generalised state adds position memory (kappa, as in Dahl's model), and a gate that stops
    the relaxation at rest. The bristle has position memory alone, and the Stribeck curve inside the
    state (eq. 2-3, with h = 1 at Coulomb friction).
    """
    target = sympy.tanh(_BETA * DQ)
    if kind == "paper":
        return Relaxation(name="h", unit="1", drive=_ALPHA * target, rate=_ALPHA), _HYSTERESIS
    drive = KAPPA.symbol * DQ
    rate = KAPPA.symbol * absolute(DQ)
    if kind == "bristle":
        level = 1 + (RHO.symbol - 1) * sympy.exp(-((DQ / V_S.symbol) ** 2))
        return Relaxation(name="h", unit="1", drive=drive, rate=rate / level), (KAPPA, RHO, V_S)
    gated = _ALPHA * (1 - sympy.exp(-((DQ / V_0.symbol) ** 2)))
    generalised = Relaxation(name="h", unit="1", drive=gated * target + drive, rate=gated + rate)
    return generalised, (*_HYSTERESIS, KAPPA, V_0)


KAPPA = Coefficient(name="kappa", unit="1/rad", description="memory of the state in position")
RHO = Coefficient(name="rho", unit="1", description="static over Coulomb friction")
V_0 = Coefficient(name="v_0", unit="rad/s", description="speed below which the state holds")
_HYSTERESIS = (
    Coefficient(name="alpha", unit="1/s", description="rate of the hysteresis state (eq. 9)"),
    Coefficient(name="beta", unit="s/rad", description="steepness of its drive (eq. 9)"),
)
_ALPHA, _BETA = (c.symbol for c in _HYSTERESIS)


def _validate_structure(
    structure: Mapping[str, Any],
) -> tuple[list[str], list[tuple[str, list[str]]], str, list[str]]:
    if not {"linear", "units"} <= set(structure) <= {"linear", "units", "state", "denominator"}:
        raise ArtifactError(
            f"ParFam structure has the keys {sorted(structure)}; expected 'linear' and 'units', "
            "and 'state' and 'denominator' are allowed.",
            code="law.structure_keys",
            key="structure",
        )
    state = structure.get("state", "paper")
    if state not in STATES:
        raise ArtifactError(
            f"ParFam state {state!r} is unknown; known are {', '.join(STATES)}.",
            code="law.structure_state",
            key="structure.state",
        )
    linear = list(structure["linear"])
    units = []
    for unit in structure["units"]:
        if set(unit) != {"g", "arguments"} or unit["g"] not in FUNCTIONS or not unit["arguments"]:
            raise ArtifactError(
                f"ParFam unit {dict(unit)} needs 'g' from {', '.join(FUNCTIONS)} and 'arguments'.",
                code="law.structure_unit",
                key="structure.units",
            )
        units.append((unit["g"], list(unit["arguments"])))
    denominator = list(structure.get("denominator", ()))
    checks = (
        (linear, LINEAR),
        *((arguments, FEATURES) for _, arguments in units),
        (denominator, DIVISORS),
    )
    for features, allowed in checks:
        for feature in features:
            if feature not in allowed:
                raise ArtifactError(
                    f"ParFam feature '{feature}' is unknown; known are {', '.join(allowed)}.",
                    code="law.structure_feature",
                    key="structure",
                )
    return linear, units, state, denominator
