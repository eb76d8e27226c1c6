"""Generalised Maxwell-slip: parallel stops whose bound follows the Stribeck curve with a lag.

Sources: V. Lampaert, F. Al-Bender, J. Swevers, A generalized Maxwell-slip friction model
appropriate for control purposes, 2003; F. Al-Bender, V. Lampaert, J. Swevers, The generalized
Maxwell-slip model: a novel model for friction simulation and compensation, 2005.

There an element sticks, F_i' = k_i v, up to alpha_i s(v), and slides until v reverses,

    F_i' = sgn(v) C (alpha_i - F_i / s(v))

With F_i = sgn(v) alpha_i b this is b' = C (1 - b / s(v)), the same relaxation for all elements, and
a sliding element is at the bound b. Here x_i = clip(x_i + v dt / w_i, -b, b) at all times, because
the switch generates energy in motions so small that s(v) rises while an element slides.
"""

import sympy

from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.lugre import RATIO_TEXTBOOK
from hesr_model.laws.stops.form import DEFLECTIONS
from hesr_model.laws.stribeck import SIGMA_2, TAU_0, V_S, VELOCITY_BOUNDS

RATIO = Coefficient(name="ratio", unit="1", description="static friction over Coulomb friction")
ATTRACTION = Coefficient(name="C", unit="1/s", description="relaxation rate of sliding friction")
ATTRACTION_BOUNDS = (1.0, 1e3)  # bounds of the rate [1/s]
_WIDTHS = DEFLECTIONS[::2]
_FORCES = tuple(
    Coefficient(name=f"F_{i}", unit="N.m", description=f"Coulomb friction of element {i}")
    for i, _ in enumerate(_WIDTHS, start=1)
)
_CURVE = 1 + (RATIO.symbol - 1) * sympy.exp(-((DQ / V_S.symbol) ** 2))
_RATE = ATTRACTION.symbol / _CURVE
# Distance of the bound below its value at rest; states begin at 0.
_BOUND_DROP = Relaxation(name="y", unit="1", drive=_RATE * (RATIO.symbol - _CURVE), rate=_RATE)
_STOPS = tuple(
    Stop(
        name=f"x{i}",
        unit="1",
        velocity=DQ,
        deflection=float(f"{w:.4g}"),
        bound=RATIO.symbol - _BOUND_DROP.state,
    )
    for i, w in enumerate(_WIDTHS, start=1)
)

_TORQUE = sum(f.symbol * x.state for f, x in zip(_FORCES, _STOPS, strict=True))


@register
class Gms(OneForm):
    """Stops of Coulomb friction F_i between -b and b, b' = C (1 - b/s(v)), + sigma_2 v + tau_0."""

    name = "gms"
    title = "GMS, bounds that relax"
    order = 260
    classic = True
    everyday = False
    expressions = LawForm(
        coefficients=(*_FORCES, SIGMA_2, TAU_0, RATIO, V_S, ATTRACTION),
        memory=(_BOUND_DROP, *_STOPS),
        output=_TORQUE + SIGMA_2.symbol * DQ + TAU_0.symbol,
    )

    def space(self) -> SearchSpace:
        """Search F_s / F_c, v_s and C; all others are linear."""
        forces = (*(coefficient.name for coefficient in _FORCES), SIGMA_2.name)
        return SearchSpace(
            bounds=(
                (RATIO.name, RATIO_TEXTBOOK),
                (V_S.name, VELOCITY_BOUNDS),
                (ATTRACTION.name, ATTRACTION_BOUNDS),
            ),
            linear=(*forces, TAU_0.name),
            non_negative=len(forces),
        )
