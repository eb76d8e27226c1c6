"""Stribeck friction whose levels and slope differ by the direction of motion."""

import sympy

from hesr_model.equations.functions import positive, sgn
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import V_S, VELOCITY_BOUNDS

_DIRECTIONS = {"p": "for positive velocities", "n": "for negative velocities"}
_LEVELS = {
    suffix: (
        Coefficient(name=f"F_c_{suffix}", unit="N.m", description=f"Coulomb friction {direction}"),
        Coefficient(name=f"F_s_{suffix}", unit="N.m", description=f"static friction {direction}"),
        Coefficient(
            name=f"sigma_{suffix}",
            unit="N.m.s/rad",
            description=f"viscous friction {direction}",
        ),
    )
    for suffix, direction in _DIRECTIONS.items()
}
_COEFFICIENTS = (*_LEVELS["p"], *_LEVELS["n"])


def _express_friction(suffix: str, sign: int) -> sympy.Expr:
    """Return the size of friction in one direction, 0 in the other one."""
    coulomb, static, viscous = (quantity.symbol for quantity in _LEVELS[suffix])
    bump = sympy.exp(-((DQ / V_S.symbol) ** 2))
    # A sum of products of non-negative numbers: none of its terms can drive the joint.
    level = coulomb * (1 - bump) + static * bump
    return level * positive(sign * sgn(DQ)) + viscous * positive(sign * DQ)


@register
class StribeckByDirection(OneForm):
    """tau = F(v, F_c_p, F_s_p, sigma_p) for v > 0 and -F(-v, F_c_n, F_s_n, sigma_n) for v < 0.

    F(v) = F_c (1 - e) + F_s e + sigma v with e = exp(-(v/v_s)^2) is that of Stribeck, with one v_s.
    All are at least 0, so that the law is passive.
    """

    name = "stribeck_direction"
    title = "Stribeck by direction"
    order = 11
    everyday = False
    by_direction = True
    expressions = LawForm(
        coefficients=(*_COEFFICIENTS, V_S),
        output=_express_friction("p", 1) - _express_friction("n", -1),
    )

    def space(self) -> SearchSpace:
        """Search v_s."""
        linear = tuple(quantity.name for quantity in _COEFFICIENTS)
        return SearchSpace(
            bounds=((V_S.name, VELOCITY_BOUNDS),), linear=linear, non_negative=len(linear)
        )
