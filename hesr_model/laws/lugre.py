"""LuGre: bristles whose mean deflection is one relaxation (paper, eq. 1-3)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import sympy

from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import F_C, F_S, SIGMA_2, TAU_0, V_S, VELOCITY_BOUNDS

SIGMA_0 = Coefficient(name="sigma_0", unit="N.m/rad", description="bristle stiffness")
SIGMA_1 = Coefficient(name="sigma_1", unit="N.m.s/rad", description="bristle damping")
MU = Coefficient(name="mu", unit="1/(N.m)", description="relative rise with the load")
DEFLECTION_BOUNDS = (1e-5, 0.1)  # [rad] F_c / sigma_0; wide, since the update is exact
RATIO_TEXTBOOK = (1.0, 5.0)  # F_s / F_c: static above Coulomb friction
STATIC_RATIO_BOUNDS = (0.2, 5.0)  # relaxed: below 1 as in lubricated gears

# z' = v - sigma_0 |v| z / g(v) (eq. 2), with g relative to F_c: a common factor of sigma_0, F_c and
# F_s cancels.
_LEVEL = 1 + (F_S.symbol / F_C.symbol - 1) * sympy.exp(-((DQ / V_S.symbol) ** 2))
_RATE = SIGMA_0.symbol / F_C.symbol * absolute(DQ) / _LEVEL
_BRISTLE = Relaxation(name="z", unit="rad", drive=DQ, rate=_RATE)


def bristle_space(
    linear: tuple[str, ...], non_negative: int, **bounds: tuple[float, float]
) -> SearchSpace:
    """Search F_c / sigma_0, F_s / F_c and v_s within `bounds`: eq. 1 is linear in the others."""
    f_c, deflection, ratio = sympy.symbols("F_c deflection ratio", real=True)
    default_bounds = {
        "deflection": DEFLECTION_BOUNDS,
        "ratio": RATIO_TEXTBOOK,
        "v_s": VELOCITY_BOUNDS,
    }
    return SearchSpace(
        bounds=tuple((default_bounds | bounds).items()),
        linear=linear,
        non_negative=non_negative,
        values=(("sigma_0", f_c / deflection), ("F_s", ratio * f_c)),
    )


_ELASTIC = SIGMA_0.symbol * _BRISTLE.state + SIGMA_1.symbol * _BRISTLE.derivative
_LUGRE = LawForm(
    coefficients=(SIGMA_0, SIGMA_1, SIGMA_2, F_C, F_S, V_S, TAU_0),
    memory=(_BRISTLE,),
    output=_ELASTIC + SIGMA_2.symbol * DQ + TAU_0.symbol,
)  # eq. 1 with an offset


def _add_term(term: sympy.Expr, *coefficients: Coefficient) -> LawForm:
    return replace(
        _LUGRE, coefficients=(*_LUGRE.coefficients, *coefficients), output=_LUGRE.output + term
    )


@register
class LuGre(OneForm):
    """z' = v - sigma_0 |v|/g(v) z, tau = sigma_0 z + sigma_1 z' + sigma_2 v + tau_0.

    F_s >= F_c, unless `relaxed`.
    """

    name = "lugre"
    title = "LuGre"
    order = 30
    classic = True
    quick = True
    proposed = True
    paper = 2
    expressions = _LUGRE
    linear: ClassVar[tuple[str, ...]] = ("F_c", "sigma_1", "sigma_2", "tau_0")
    searched: ClassVar[Mapping[str, tuple[float, float]]] = {}  # bounds apart from the bristle's

    def __init__(self, *, relaxed: bool = False) -> None:
        self._relaxed = {"ratio": STATIC_RATIO_BOUNDS} if relaxed else {}

    def space(self) -> SearchSpace:
        """Search the bristle; the rest is linear, and only the last one, tau_0, may be negative."""
        return bristle_space(self.linear, len(self.linear) - 1, **self.searched, **self._relaxed)


@register
class LuGreLoad(LuGre):
    """LuGre whose bristle force rises with the load: tau = ... + mu sigma_0 z |tau_load|."""

    name = "lugre_load"
    title = "LuGre+load"
    order = 40
    proposed = True
    adds = ("lugre", "load")
    expressions = _add_term(MU.symbol * SIGMA_0.symbol * _BRISTLE.state * absolute(TAU_LOAD), MU)

    def space(self) -> SearchSpace:
        """Search the bristle; solve for F_c mu, in which the torque is linear."""
        unloaded_space = super().space()
        product = sympy.Symbol("F_c_mu", real=True)
        return replace(
            unloaded_space,
            linear=(*unloaded_space.linear, product.name),
            values=(*unloaded_space.values, (MU.name, product / F_C.symbol)),
        )


@register
class LuGreLoadRipple(LuGreLoad):
    """LuGre+load with motor ripple and with the start of z from the first torque samples."""

    name = "lugre_load_ripple"
    title = "LuGre+load+ripple"
    order = 50
    proposed = True
    adds = ("lugre_load", "motor ripple")
    needs = ("gear_ratio",)
    ripple = True
    typical: ClassVar[Mapping[str, Any]] = {"ripple": {"gear_ratio": 100, "orders": [2]}}
    start_samples = 5


SIGMA_T = Coefficient(
    name="sigma_t", unit="N.m.s/rad", description="viscous friction that thins with speed"
)
V_T = Coefficient(name="v_t", unit="rad/s", description="speed of shear thinning")
S_2 = Coefficient(name="s_2", unit="N.m.s/rad", description="viscous friction above what is needed")
THINNING_BOUNDS = (1e-2, 3.0)  # [rad/s]


@register
class LuGreTextbook(LuGre):
    """LuGre with shear-thinning viscous friction + sigma_t v / (1 + |v|/v_t)."""

    name = "lugre_textbook"
    title = "LuGre, shear thinning"
    order = 60
    expressions = _add_term(SIGMA_T.symbol * DQ / (1 + absolute(DQ) / V_T.symbol), SIGMA_T, V_T)
    linear = ("F_c", "sigma_1", "sigma_2", "sigma_t", "tau_0")
    searched: ClassVar[Mapping[str, tuple[float, float]]] = {"v_t": THINNING_BOUNDS}


@register
class LuGrePassive(LuGre):
    """LuGre that is passive: sigma_2 = s_2 + sigma_1 (F_s/F_c - 1) with s_2 >= 0, F_s >= F_c.

    Source: N. Barabanov, R. Ortega, Necessary and sufficient conditions for passivity of the LuGre
    friction model, 2000; in continuous time.
    """

    name = "lugre_passive"
    title = "LuGre, passive"
    order = 70
    expressions = replace(
        _LUGRE,
        coefficients=tuple(
            S_2 if coefficient is SIGMA_2 else coefficient for coefficient in _LUGRE.coefficients
        ),
        output=_LUGRE.output.subs(
            SIGMA_2.symbol, S_2.symbol + SIGMA_1.symbol * (F_S.symbol / F_C.symbol - 1)
        ),
    )
    linear = ("F_c", "sigma_1", "s_2", "tau_0")

    def __init__(self) -> None:
        super().__init__()
