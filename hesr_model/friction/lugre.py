"""LuGre: bristles whose mean deflection is one relaxation (paper, eq. 1-3)."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from scipy.optimize import differential_evolution

from hesr_model.friction.estimator import Estimator, register
from hesr_model.friction.evaluate import Array, step_coefficients
from hesr_model.friction.functions import DQ, absolute
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm, Relaxation
from hesr_model.friction.samples import Samples, non_negative_least_squares
from hesr_model.friction.stribeck import VELOCITY_BOUNDS, no_structure
from hesr_model.residual import FrictionRecord

COEFFICIENTS = (
    Coefficient(name="sigma_0", unit="N.m/rad", description="bristle stiffness"),
    Coefficient(name="sigma_1", unit="N.m.s/rad", description="bristle damping"),
    Coefficient(name="sigma_2", unit="N.m.s/rad", description="viscous friction"),
    Coefficient(name="F_c", unit="N.m", description="Coulomb friction"),
    Coefficient(name="F_s", unit="N.m", description="static friction"),
    Coefficient(name="v_s", unit="rad/s", description="Stribeck velocity"),
    Coefficient(name="tau_0", unit="N.m", description="offset"),
)

DEFLECTION_BOUNDS = (1e-5, 0.1)
"""Bounds of the sliding deflection F_c / sigma_0 [rad]; wide, since the update is exact."""
STATIC_RATIO_BOUNDS = (0.2, 5.0)
"""Bounds of F_s / F_c; below 1 the level rises with speed, as lubricated gears show."""


@register
class LuGre(Estimator):
    """z' = v - sigma_0 |v|/g(v) z, tau = sigma_0 z + sigma_1 z' + sigma_2 v + tau_0.

    With y = sigma_0 z / F_c the law is linear in F_c, sigma_1 sigma_0 / F_c, sigma_2 and tau_0, so
    differential evolution searches only the sliding deflection, F_s / F_c and v_s; the rest is
    solved inside it.
    """

    name = "lugre"
    title = "LuGre"
    equation = "sigma_0 z + sigma_1 z' + sigma_2 dq + tau_0, z' = dq - sigma_0 |dq| z / g(dq)"

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the one form of the law."""
        no_structure("lugre", structure)
        sigma_0, sigma_1, sigma_2, f_c, f_s, v_s, tau_0 = (c.symbol for c in COEFFICIENTS)
        level = f_c + (f_s - f_c) * sympy.exp(-((DQ / v_s) ** 2))
        bristle = Relaxation(name="z", unit="rad", drive=DQ, rate=sigma_0 * absolute(DQ) / level)
        z, dz = bristle.state, bristle.derivative
        return LawForm(
            coefficients=COEFFICIENTS,
            relaxations=(bristle,),
            output=sigma_0 * z + sigma_1 * dz + sigma_2 * DQ + tau_0,
        )

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Fit by differential evolution over the three non-linear numbers (seeded by `rng`)."""
        samples = Samples.of(records, coefficients=len(COEFFICIENTS))

        def solve(point: Array) -> tuple[Array, float]:
            deflection, ratio, v_s = np.exp(point)
            level = 1.0 + (ratio - 1.0) * np.exp(-((samples.dq / v_s) ** 2))
            drive = samples.dq / deflection
            rate = np.abs(drive) / level
            y = samples.recurrence(*step_coefficients(drive, rate, samples.dt, "exact"))
            columns = np.column_stack([y, drive - rate * y, samples.dq, np.ones_like(y)])
            return non_negative_least_squares(columns, samples.tau, non_negative=3)

        bounds = np.log([DEFLECTION_BOUNDS, STATIC_RATIO_BOUNDS, VELOCITY_BOUNDS])
        best = differential_evolution(
            lambda point: solve(point)[1], bounds, rng=rng, popsize=10, maxiter=40, tol=1e-4
        )
        deflection, ratio, v_s = np.exp(best.x)
        (f_c, damping, sigma_2, tau_0), _ = solve(best.x)
        values = {
            "sigma_0": f_c / deflection,
            "sigma_1": damping / deflection,
            "sigma_2": sigma_2,
            "F_c": f_c,
            "F_s": ratio * f_c,
            "v_s": v_s,
            "tau_0": tau_0,
        }
        return FrictionLaw(name=self.name, form=self.form({}), values=values)
