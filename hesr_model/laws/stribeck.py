"""Stribeck: Coulomb, static and viscous friction as a function of velocity alone."""

import sympy

from hesr_model.equations.functions import sgn
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm

F_C = Coefficient(name="F_c", unit="N.m", description="Coulomb friction")
F_S = Coefficient(name="F_s", unit="N.m", description="static friction")
V_S = Coefficient(name="v_s", unit="rad/s", description="Stribeck velocity")
SIGMA_2 = Coefficient(name="sigma_2", unit="N.m.s/rad", description="viscous friction")
TAU_0 = Coefficient(name="tau_0", unit="N.m", description="offset")
VELOCITY_BOUNDS = (1e-3, 1.0)  # [rad/s]
_LEVEL = F_C.symbol + (F_S.symbol - F_C.symbol) * sympy.exp(-((DQ / V_S.symbol) ** 2))


@register
class Stribeck(OneForm):
    """tau = (F_c + (F_s - F_c) exp(-(v/v_s)^2)) sgn(v) + sigma_2 v + tau_0  (eq. 3 as a map).

    F_c, F_s, sigma_2 >= 0. F_s < F_c is allowed for lubricated gears.
    """

    name = "stribeck"
    title = "Stribeck"
    order = 10
    classic = True
    quick = True
    proposed = True
    from_commands = True
    paper = 4
    expressions = LawForm(
        coefficients=(F_C, F_S, V_S, SIGMA_2, TAU_0),
        output=_LEVEL * sgn(DQ) + SIGMA_2.symbol * DQ + TAU_0.symbol,
    )

    def space(self) -> SearchSpace:
        """Search v_s."""
        return SearchSpace(
            bounds=(("v_s", VELOCITY_BOUNDS),),
            linear=("F_c", "F_s", "sigma_2", "tau_0"),
            non_negative=3,
        )
