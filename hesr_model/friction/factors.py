"""Factors in a law: a level on bounds, a factor on viscous friction, and an offset.

    stop       x+ = clip(x + v dt / w, -l s, l s)     the level l scales the bound, never the torque
    bristle    x' = drive - rate / l x                F_c and F_s times l
    viscous    n v f(v)
    warmth     c(T) on l and n(T) on n, with a thermal model
    torque     tau = hysteresis(x) + n v f(v) + ripple + tau_0 + o

The derivative of the torque by the level is F_i xi_i, where xi_i = dx_i/dl is +-s_i if the stop is
clipped and keeps its value otherwise.
"""

from dataclasses import dataclass

import sympy

from hesr_model.equations.component import Equation, previous
from hesr_model.equations.functions import absolute, exceeds, positive, sgn
from hesr_model.equations.memory import Element, Stop
from hesr_model.errors import ExportError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.scales import scaled_bound

CHANGE = 0.1  # smallest relative change of friction to detect
CHANGE_OF_OFFSET = 0.5
"""Smallest change of the offset to detect, in standard deviations of the unexplained torque."""
_CLIPPED = 1.0 - 1e-9  # share of its bound above which a stop is clipped, up to round-off


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Terms of a law's torque [N.m], with memory scaled by the level.

    `rest` are ripple and offset, `along` is the derivative of the hysteresis by the level, a
    function of `sensitivities`: the stops' derivatives, warmth included.
    """

    memory: tuple[Element, ...]
    hysteresis: sympy.Expr
    viscous: sympy.Expr
    rest: sympy.Expr
    along: sympy.Expr
    sensitivities: tuple[Equation, ...]


def parts(law: FrictionLaw, level: sympy.Expr, warm: sympy.Expr = sympy.S.One) -> Parts:
    """Return a law with a positive level and a factor `warm` of temperature on its bounds.

    Raises ExportError if the law has no bound.
    """
    form = law.form
    scaled = tuple(scaled_bound(m, level * warm) for m in form.memory)
    carrying = [m for m, own in zip(form.memory, scaled, strict=True) if m != own]
    if not carrying:
        raise ExportError(
            f"law '{law.name}' has neither stops nor bristles to scale; use ParFam-S or LuGre, for "
            "example."
        )
    states = {s: sympy.Integer(0) for m in form.memory for s in (m.state, m.derivative)}
    still = form.output.subs(states)
    terms = sympy.Add.make_args(sympy.expand_mul(still))
    viscous = [t for t in terms if DQ in t.free_symbols and not {Q, TAU_LOAD} & t.free_symbols]
    bound = {m: f"along_{m.name}" for m in carrying if isinstance(m, Stop)}
    along = sympy.S.Zero
    for element in carrying:
        own = (
            sympy.Symbol(bound[element], real=True)
            if element in bound
            else element.state / level  # steady value of a sliding bristle
        )
        along += form.output.diff(element.state).subs({m.derivative: 0 for m in form.memory}) * own
    return Parts(
        memory=scaled,
        hysteresis=sympy.expand_mul(form.output - still),
        viscous=sympy.Add(*viscous),
        rest=sympy.Add(*(t for t in terms if t not in viscous)),
        along=along,
        sensitivities=tuple(_sensitivity(m, name, level, warm) for m, name in bound.items()),
    )


def _sensitivity(stop: Stop, name: str, level: sympy.Expr, warm: sympy.Expr) -> Equation:
    bound = warm * positive(stop.bound)
    clipped = exceeds(absolute(stop.state), _CLIPPED * level * bound)
    return Equation(
        name=name,
        expression=clipped * sgn(stop.state) * bound + (1 - clipped) * previous(name),
        start=stop.state,
    )
