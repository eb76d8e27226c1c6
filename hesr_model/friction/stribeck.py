"""Stribeck: Coulomb, static and viscous friction as a function of velocity alone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from scipy.optimize import differential_evolution

from hesr_model.errors import ArtifactError
from hesr_model.friction.estimator import Estimator, register
from hesr_model.friction.evaluate import Array
from hesr_model.friction.functions import DQ, sgn
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.samples import Samples, non_negative_least_squares
from hesr_model.residual import FrictionRecord

COEFFICIENTS = (
    Coefficient(name="F_c", unit="N.m", description="Coulomb friction"),
    Coefficient(name="F_s", unit="N.m", description="static friction"),
    Coefficient(name="v_s", unit="rad/s", description="Stribeck velocity"),
    Coefficient(name="sigma_2", unit="N.m.s/rad", description="viscous friction"),
    Coefficient(name="tau_0", unit="N.m", description="offset"),
)

VELOCITY_BOUNDS = (1e-3, 1.0)
"""Bounds of the Stribeck velocity [rad/s]."""


def no_structure(name: str, structure: Mapping[str, Any]) -> None:
    """Refuse structure data for a law that has only one form."""
    if structure:
        raise ArtifactError(
            f"law '{name}' has one form only, found the structure {dict(structure)}."
        )


@register
class Stribeck(Estimator):
    """tau = (F_c + (F_s - F_c) exp(-(v/v_s)^2)) sgn(v) + sigma_2 v + tau_0  (eq. 3 as a map).

    v_s is found by differential evolution; the other coefficients enter linearly and are solved
    inside it, F_c, F_s and sigma_2 kept non-negative. F_s < F_c is allowed: the level of lubricated
    gears can rise with speed.
    """

    name = "stribeck"
    title = "Stribeck"
    equation = "(F_c + (F_s - F_c) exp(-(dq/v_s)^2)) sgn(dq) + sigma_2 dq + tau_0"

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the one form of the law."""
        no_structure("stribeck", structure)
        f_c, f_s, v_s, sigma_2, tau_0 = (c.symbol for c in COEFFICIENTS)
        level = f_c + (f_s - f_c) * sympy.exp(-((DQ / v_s) ** 2))
        return LawForm(coefficients=COEFFICIENTS, output=level * sgn(DQ) + sigma_2 * DQ + tau_0)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Fit by differential evolution over v_s (seeded by `rng`)."""
        samples = Samples.of(records, coefficients=len(COEFFICIENTS))
        sign = np.sign(samples.dq)

        def solve(point: Array) -> tuple[Array, float]:
            bump = np.exp(-((samples.dq / np.exp(point[0])) ** 2)) * sign
            columns = np.column_stack([sign - bump, bump, samples.dq, np.ones_like(sign)])
            return non_negative_least_squares(columns, samples.tau, non_negative=3)

        best = differential_evolution(
            lambda point: solve(point)[1], [tuple(np.log(VELOCITY_BOUNDS))], rng=rng, tol=1e-8
        )
        (f_c, f_s, sigma_2, tau_0), _ = solve(best.x)
        values = (f_c, f_s, float(np.exp(best.x[0])), sigma_2, tau_0)
        names = (c.name for c in COEFFICIENTS)
        return FrictionLaw(
            name=self.name, form=self.form({}), values=dict(zip(names, values, strict=True))
        )
