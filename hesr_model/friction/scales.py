"""Two factors that every law has: on its Coulomb friction and on its viscous friction.

    stop       x+ = clip(x + v dt / w, -c s, c s)     the factor c is one on the bound
    bristle    x' = drive - rate / c x
    torque     c T(x / c) + n v f(v) + ripple + offset

Viscous is a term with the velocity as a factor and without memory; ripple and offset are terms of
position, load or nothing at all, and have no factor; all others are Coulomb friction. What is
linear in stops and bristles is scaled by their bounds alone: the stiffness at rest stays, the level
and the way to it grow, and a factor that changes while the memory is loaded gives no energy. Where
no bound can be scaled the factor is one on the torque.
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
SCALES = (COULOMB, VISCOUS)
"""1 for the law as it is, 0 for none of the part."""

LEAST = 1e-9
"""Of the factor where it divides: 0 would leave a bristle without a place."""


def scaled(form: LawForm) -> LawForm:
    """Return a form with `SCALES` as its last coefficients, the same where both are 1."""
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
        *(level * term for term in parts["carried"]),  # where it is linear no factor is left
        *parts["rest"],
    )
    return LawForm(coefficients=(*form.coefficients, *SCALES), memory=memory, output=output)


def scaled_bound(element: Element, level: sympy.Expr) -> Element:
    """Return an element whose bound is `level` times what it was; itself where it has none."""
    if isinstance(element, Stop):
        return replace(element, bound=element.bound * level)
    return replace(element, rate=element.rate / level) if is_bristle(element) else element


def is_bristle(element: Relaxation) -> bool:
    """Whether the velocity drives it: what it holds has a level."""
    drive = element.drive
    return bool(DQ in drive.free_symbols and DQ not in (drive / DQ).free_symbols)


def has_viscous(form: LawForm) -> bool:
    """Whether a form has a term of viscous friction."""
    common, terms = _terms(form.output)
    return any(_part(common * term, _states(form), ()) == "viscous" for term in terms)


def _states(form: LawForm) -> set[sympy.Symbol]:
    return {s for m in form.memory for s in (m.state, m.derivative)}


def _terms(output: sympy.Expr) -> tuple[sympy.Expr, tuple[sympy.Expr, ...]]:
    """Return what all terms of a torque have in common, as a denominator, and the terms."""
    factors = sympy.Mul.make_args(output)
    sums = [f for f in factors if f.is_Add]
    if len(sums) != 1:
        return sympy.S.One, (output,)
    return sympy.Mul(*(f for f in factors if f is not sums[0])), sympy.Add.make_args(sums[0])


def _part(
    term: sympy.Expr, states: Collection[sympy.Symbol], carried: Collection[sympy.Symbol]
) -> str:
    """Return of which part a term is; carried is Coulomb friction in what has a bound."""
    above, _ = sympy.fraction(term)
    bases = {f.as_base_exp()[0] for f in sympy.Mul.make_args(above)}
    if DQ in bases and not above.free_symbols & {*states}:
        return "viscous"
    used = term.free_symbols
    if used & {*carried}:
        return "carried"
    return "coulomb" if used & {*states} or (DQ in used and Q not in used) else "rest"
