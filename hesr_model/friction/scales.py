"""Factors on the Coulomb and viscous friction of every law.

    stop       x+ = clip(x + v dt / w, -c s, c s)     the factor c scales the bound
    bristle    x' = drive - rate / c x
    torque     c T(x / c) + n v f(v) + ripple + offset

Viscous terms have the velocity as a factor and no memory; ripple and offset have neither; all
others are Coulomb friction. Terms linear in stops and bristles are scaled by their bounds alone,
which adds no energy.
"""

from collections.abc import Collection
from dataclasses import replace

import sympy

from hesr_model.equations.functions import larger
from hesr_model.equations.memory import Element, Relaxation, Stop
from hesr_model.friction.inputs import DQ, Q
from hesr_model.friction.law import Coefficient, LawForm

COULOMB = Coefficient(
    name="coulomb_scale",
    unit="1",
    description="factor on the Coulomb friction of {joint}, at rest and in motion",
)
VISCOUS = Coefficient(
    name="viscous_scale", unit="1", description="factor on the viscous friction of {joint}"
)
SCALES = (COULOMB, VISCOUS)  # factors of every law: 1 by default, 0 removes the part
LEAST = 1e-9  # smallest factor used as a divisor; at 0 the state of a bristle is undefined


def scaled(form: LawForm) -> LawForm:
    """Return a form with `SCALES` as last coefficients; it is unchanged if both are 1."""
    level: sympy.Expr = COULOMB.symbol
    if any(isinstance(m, Relaxation) and is_bristle(m) for m in form.memory):
        level = larger(level, LEAST)
    memory = tuple(scaled_bound(m, level) for m in form.memory)
    carrying = [m for m, own in zip(form.memory, memory, strict=True) if m != own]
    normed = {s: s / level for m in carrying for s in (m.state, m.derivative)}
    common, terms = _terms(form.output)
    parts: dict[str, list[sympy.Expr]] = {"viscous": [], "coulomb": [], "carried": [], "rest": []}
    for term in terms:
        parts[_part(common * term, _states(form), normed.keys())].append(term.xreplace(normed))
    output = common.xreplace(normed) * sympy.Add(
        VISCOUS.symbol * sympy.Add(*parts["viscous"]),
        level * sympy.Add(*parts["coulomb"]),
        *(level * term for term in parts["carried"]),  # no factor is left in linear terms
        *parts["rest"],
    )
    return LawForm(coefficients=(*form.coefficients, *SCALES), memory=memory, output=output)


def scaled_bound(element: Element, level: sympy.Expr) -> Element:
    """Multiply an element's bound, if any, by `level`."""
    if isinstance(element, Stop):
        return replace(element, bound=element.bound * level)
    return replace(element, rate=element.rate / level) if is_bristle(element) else element


def is_bristle(element: Relaxation) -> bool:
    """Return True if the drive is proportional to velocity, so that the state has a level."""
    drive = element.drive
    return bool(DQ in drive.free_symbols and DQ not in (drive / DQ).free_symbols)


def has_viscous(form: LawForm) -> bool:
    """Return True if a form has a viscous term."""
    common, terms = _terms(form.output)
    return any(_part(common * term, _states(form), ()) == "viscous" for term in terms)


def _states(form: LawForm) -> set[sympy.Symbol]:
    return {s for m in form.memory for s in (m.state, m.derivative)}


def _terms(output: sympy.Expr) -> tuple[sympy.Expr, tuple[sympy.Expr, ...]]:
    factors = sympy.Mul.make_args(output)
    sums = [f for f in factors if f.is_Add]
    if len(sums) != 1:
        return sympy.S.One, (output,)
    return sympy.Mul(*(f for f in factors if f is not sums[0])), sympy.Add.make_args(sums[0])


def _part(
    term: sympy.Expr, states: Collection[sympy.Symbol], carried: Collection[sympy.Symbol]
) -> str:
    above, _ = sympy.fraction(term)
    bases = {f.as_base_exp()[0] for f in sympy.Mul.make_args(above)}
    if DQ in bases and not above.free_symbols & {*states}:
        return "viscous"
    used = term.free_symbols
    if used & {*carried}:
        return "carried"
    return "coulomb" if used & {*states} or (DQ in used and Q not in used) else "rest"
