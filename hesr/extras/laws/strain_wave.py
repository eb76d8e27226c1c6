"""Strain-wave laws: gear meshing with friction proportional to the load."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from hesr_model.equations.functions import absolute, positive, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import F_C, SIGMA_2, TAU_0

MU_AVG = Coefficient(name="mu_avg", unit="1", description="friction per load in both directions")
MU_DIF = Coefficient(name="mu_dif", unit="1", description="friction per load, driving or driven")
X_0 = Coefficient(name="x_0", unit="rad", description="sliding deflection")

DEFLECTION_BOUNDS = (1e-5, 0.1)  # bounds of the sliding deflection [rad]
_MESH = Relaxation(name="z", unit="1", drive=DQ / X_0.symbol, rate=absolute(DQ) / X_0.symbol)


@register
class StrainWave(OneForm):
    """Meshing z' = (v - |v| z)/x_0 with friction mu_avg |tau_load| z + mu_dif tau_load z^2 + ...

    Source: issue 3528 of the MuJoCo tracker, plus Coulomb, viscous and offset terms. While sliding,
    z^2 = 1 and mu_dif tau_load is collinear with the rigid-body torque: motor currents alone
    determine mu_dif poorly.
    """

    name = "strain_wave"
    title = "Strain wave"
    order = 140
    classic = True
    expressions = LawForm(
        coefficients=(X_0, MU_AVG, MU_DIF, F_C, SIGMA_2, TAU_0),
        memory=(_MESH,),
        output=MU_AVG.symbol * absolute(TAU_LOAD) * _MESH.state
        + MU_DIF.symbol * TAU_LOAD * _MESH.state**2
        + F_C.symbol * _MESH.state
        + SIGMA_2.symbol * DQ
        + TAU_0.symbol,
    )

    def space(self) -> SearchSpace:
        """Search the deflection; all others are linear."""
        return SearchSpace(
            bounds=((X_0.name, DEFLECTION_BOUNDS),),
            linear=("F_c", "sigma_2", "mu_avg", "mu_dif", "tau_0"),
            non_negative=2,
        )


RISE_BOUNDS = (1e-4, 10.0)  # bounds of the relative rise per load [1/(N.m)]
RISE_D = Coefficient(
    name="rise_d", unit="1/(N.m)", description="relative rise per load, driving motor"
)
RISE_B = Coefficient(
    name="rise_b", unit="1/(N.m)", description="relative rise per load, driven motor"
)
_AHEAD = positive(sgn(DQ) * TAU_LOAD)  # load in the direction of motion: the motor drives
_BACK = positive(-sgn(DQ) * TAU_LOAD)  # load against it: the motor is driven
_BOUND = 1 + RISE_D.symbol * _AHEAD + RISE_B.symbol * _BACK
_BOUND_MESH = replace(_MESH, rate=absolute(DQ) / (X_0.symbol * _BOUND))


@register
class StrainWaveBound(OneForm):
    """Meshing z' = (v - |v| z/b)/x_0, b = 1 + rise_d max(L sgn(v), 0) + rise_b max(-L sgn(v), 0).

    The load L in the bound of the deflection generates no energy, unlike the strain-wave law.
    """

    name = "strain_wave_bound"
    title = "Strain wave, load as bound"
    order = 150
    classic = True
    everyday = False
    limited = True
    typical: ClassVar[Mapping[str, Any]] = {"limited": True}
    expressions = LawForm(
        coefficients=(X_0, RISE_D, RISE_B, F_C, SIGMA_2, TAU_0),
        memory=(_BOUND_MESH,),
        output=F_C.symbol * _BOUND_MESH.state + SIGMA_2.symbol * DQ + TAU_0.symbol,
    )

    def space(self) -> SearchSpace:
        """Search the deflection and both rises; all others are linear."""
        return SearchSpace(
            bounds=(
                (X_0.name, DEFLECTION_BOUNDS),
                (RISE_D.name, RISE_BOUNDS),
                (RISE_B.name, RISE_BOUNDS),
            ),
            linear=("F_c", "sigma_2", "tau_0"),
            non_negative=2,
        )
