"""Factors on the Coulomb and viscous friction of every law, and on levels of bounds.

    stop       x+ = clip(x + v dt / w, -c s, c s)     the factor c scales the bound
    bristle    x' = drive - rate / c x                F_c and F_s times c
    torque     c T(x / c) + n v f(v) + ripple + offset
    warmth     c(T) on c and n(T) on n, with a thermal model

Viscous terms have the velocity as a factor and no memory; ripple and offset have neither; all
others are Coulomb friction. Terms linear in stops and bristles are scaled by their bounds alone,
which adds no energy. Their derivative by the level is F_i xi_i: xi_i = dx_i/dc is +-s_i if the stop
is clipped and keeps its value otherwise.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import sympy

from hesr_model.equations.component import Equation, previous
from hesr_model.equations.functions import absolute, exceeds, larger, positive, sgn
from hesr_model.equations.memory import Element, Relaxation, Stop
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm

COULOMB = Coefficient(
    name="coulomb_scale",
    unit="1",
    description="factor on the Coulomb friction of {joint}, at rest and in motion",
)
VISCOUS = Coefficient(
    name="viscous_scale", unit="1", description="factor on the viscous friction of {joint}"
)
SCALES = (COULOMB, VISCOUS)  # factors of every law: 1 by default, 0 removes the part
MIN_SCALE = 1e-9  # smallest factor used as a divisor; at 0 the state of a bristle is undefined


def add_scales(form: LawForm) -> LawForm:
    """Return a form with `SCALES` as last coefficients; it is unchanged if both are 1."""
    level: sympy.Expr = COULOMB.symbol
    if any(isinstance(element, Relaxation) and is_bristle(element) for element in form.memory):
        level = larger(level, MIN_SCALE)
    memory = tuple(scale_element(element, level) for element in form.memory)
    scaled_elements = _find_scaled_elements(form.memory, memory)
    normalised = {symbol: symbol / level for symbol in _list_states(scaled_elements)}
    states = set(_list_states(form.memory))
    common, terms = _split_terms(form.output)
    parts: dict[str, list[sympy.Expr]] = {
        "viscous": [],
        "coulomb": [],
        "carried": [],
        "unscaled": [],
    }
    for term in terms:
        part = _classify_term(common * term, states, normalised.keys())
        parts[part].append(term.xreplace(normalised))
    output = common.xreplace(normalised) * sympy.Add(
        VISCOUS.symbol * sympy.Add(*parts["viscous"]),
        level * sympy.Add(*parts["coulomb"]),
        *(level * term for term in parts["carried"]),  # no factor is left in linear terms
        *parts["unscaled"],
    )
    return replace(form, coefficients=(*form.coefficients, *SCALES), memory=memory, output=output)


def scale_element(element: Element, level: sympy.Expr) -> Element:
    """Multiply an element's bound, if any, by `level`."""
    if isinstance(element, Stop):
        return replace(element, bound=element.bound * level)
    if not is_bristle(element):
        return element
    return replace(element, rate=element.rate / level)


def _find_scaled_elements(memory: Sequence[Element], scaled: Sequence[Element]) -> list[Element]:
    """Return the elements that differ from their scaled ones."""
    pairs = zip(memory, scaled, strict=True)
    return [element for element, scaled_element in pairs if element != scaled_element]


def is_bristle(element: Relaxation) -> bool:
    """Return True if the drive is proportional to velocity, so that the state has a level."""
    drive = element.drive
    return bool(DQ in drive.free_symbols and DQ not in (drive / DQ).free_symbols)


def has_viscous(form: LawForm) -> bool:
    """Return True if a form has a viscous term."""
    common, terms = _split_terms(form.output)
    states = set(_list_states(form.memory))
    return any(_classify_term(common * term, states, ()) == "viscous" for term in terms)


def _list_states(memory: Iterable[Element]) -> list[sympy.Symbol]:
    """Return state and derivative of each element."""
    symbols = []
    for element in memory:
        symbols += [element.state, element.derivative]
    return symbols


def _split_terms(output: sympy.Expr) -> tuple[sympy.Expr, tuple[sympy.Expr, ...]]:
    """Return a common factor and the terms of an output, which have it."""
    factors = sympy.Mul.make_args(output)
    sums = [factor for factor in factors if factor.is_Add]
    if len(sums) != 1:
        return sympy.S.One, (output,)
    common = sympy.Mul(*(factor for factor in factors if factor is not sums[0]))
    return common, sympy.Add.make_args(sums[0])


def _classify_term(
    term: sympy.Expr, states: Collection[sympy.Symbol], carried: Collection[sympy.Symbol]
) -> str:
    numerator, _ = sympy.fraction(term)
    bases = {f.as_base_exp()[0] for f in sympy.Mul.make_args(numerator)}
    if DQ in bases and not numerator.free_symbols & {*states}:
        return "viscous"
    symbols = term.free_symbols
    if symbols & {*carried}:
        return "carried"
    if symbols & {*states} or (DQ in symbols and Q not in symbols):
        return "coulomb"
    return "unscaled"


MIN_CHANGE = 0.1  # smallest relative change of friction to detect
MIN_OFFSET_CHANGE = 0.5  # the same, in standard deviations of the unexplained torque
_CLIPPED_SHARE = 1.0 - 1e-9  # share of its bound above which a stop is clipped, up to round-off


@dataclass(frozen=True, kw_only=True)
class TorqueParts:
    """Terms of a law's torque [N.m], with memory scaled by the level."""

    memory: tuple[Element, ...]
    hysteresis: sympy.Expr
    viscous: sympy.Expr
    unscaled: sympy.Expr  # ripple and offset
    level_slope: sympy.Expr  # derivative of the hysteresis by the level, from `sensitivities`
    sensitivities: tuple[Equation, ...]  # derivatives of the stops, warmth included


def split_torque(
    law: FrictionLaw, level: sympy.Expr, warmth: sympy.Expr = sympy.S.One
) -> TorqueParts:
    """Return a law with a level and a factor `warmth` on its bounds; ExportError without bounds."""
    form = law.form
    memory = tuple(scale_element(element, level * warmth) for element in form.memory)
    scaled_elements = _find_scaled_elements(form.memory, memory)
    if not scaled_elements:
        raise ExportError(
            f"law '{law.name}' has neither stops nor bristles to scale; use ParFam-S or LuGre, for "
            "example."
        )
    stateless = form.output.subs(dict.fromkeys(_list_states(form.memory), sympy.Integer(0)))
    terms = sympy.Add.make_args(sympy.expand_mul(stateless))
    viscous = []
    unscaled = []
    for term in terms:
        symbols = term.free_symbols
        if DQ in symbols and not {Q, TAU_LOAD} & symbols:
            viscous.append(term)
        else:
            unscaled.append(term)
    at_rest = {element.derivative: 0 for element in form.memory}
    level_slope = sympy.S.Zero
    sensitivities = []
    for element in scaled_elements:
        if isinstance(element, Stop):
            sensitivity = _derive_sensitivity(element, level, warmth)
            sensitivities.append(sensitivity)
            state_slope = sensitivity.symbol
        else:
            state_slope = element.state / level  # steady value of a sliding bristle
        level_slope += form.output.diff(element.state).subs(at_rest) * state_slope
    return TorqueParts(
        memory=memory,
        hysteresis=sympy.expand_mul(form.output - stateless),
        viscous=sympy.Add(*viscous),
        unscaled=sympy.Add(*unscaled),
        level_slope=level_slope,
        sensitivities=tuple(sensitivities),
    )


def _derive_sensitivity(stop: Stop, level: sympy.Expr, warmth: sympy.Expr) -> Equation:
    """Return the derivative of a stop by the level; see the module."""
    name = f"along_{stop.name}"
    bound = warmth * positive(stop.bound)
    clipped = exceeds(absolute(stop.state), _CLIPPED_SHARE * level * bound)
    return Equation(
        name=name,
        expression=clipped * sgn(stop.state) * bound + (1 - clipped) * previous(name),
        start=stop.state,
    )
