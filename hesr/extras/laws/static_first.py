"""LuGre fitted in two steps: static curve first, then stiffness and damping of the bristles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import sympy
from scipy.optimize import minimize_scalar

from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.laws.lugre import RATIO_TEXTBOOK, LuGre, bristle_space
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array

FREE_RATIO = (0.01, 5.0)  # F_s / F_c; 0 would leave no bristle at rest
_STIFF_DEFLECTIONS = (1.0e-5, 1.01e-5)  # [rad] deflection of bristles that follow the static curve


@register
class LuGreStaticFirst(LuGre):
    """LuGre with a static curve fitted first, the mean of both branches of the loop.

    sigma_0 and sigma_1 are fitted with it fixed. With `textbook` F_s >= F_c.
    """

    name = "lugre_static_first"
    title = "LuGre, static first"
    order = 35
    everyday = False

    def __init__(self, *, textbook: bool = False) -> None:
        self.ratio = FREE_RATIO
        if textbook:
            self.ratio = RATIO_TEXTBOOK

    def space(self) -> SearchSpace:
        """Search the bristle within the limits of the static curve."""
        return bristle_space(("F_c", "sigma_1", "sigma_2", "tau_0"), 3, ratio=self.ratio)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Fit the static curve (seeded by `rng`), then search the deflection F_c / sigma_0."""
        form = self.core({})
        rows = JointRows.from_records(records, coefficients=len(form.coefficients))
        space = self.space().scale_to_joint(is_prismatic=rows.sliding)
        stiff_space = bristle_space(
            ("F_c", "sigma_2", "tau_0"), 2, ratio=self.ratio, deflection=_STIFF_DEFLECTIONS
        )
        values_without_damping = (*space.values, ("sigma_1", sympy.Integer(0)))
        stiff_space = replace(stiff_space, values=values_without_damping)
        curve_problem = Separable(form, stiff_space, rows)
        problem = Separable(form, space, rows)
        static_point = curve_problem.polish(curve_problem.search(rng))
        (coulomb, *other_unknowns), _ = curve_problem.solve(static_point)

        def fit_bristle(coordinate: float) -> tuple[float, Array, Array]:
            point = np.array([coordinate, *static_point[1:]])
            columns = problem.columns(point)
            unknowns = np.array([coulomb, 0.0, *other_unknowns])
            residual = rows.tau - columns @ unknowns
            slope = columns[:, 1]
            unknowns[1] = max(0.0, float(slope @ residual) / max(float(slope @ slope), 1e-300))
            return float(np.sum((residual - unknowns[1] * slope) ** 2)), point, unknowns

        coordinates = np.linspace(problem.bounds[0, 0], problem.bounds[0, 1], 25)
        best_row = int(np.argmin([fit_bristle(float(coordinate))[0] for coordinate in coordinates]))
        bracket = (coordinates[max(best_row - 1, 0)], coordinates[min(best_row + 1, 24)])
        optimum = minimize_scalar(
            lambda coordinate: fit_bristle(coordinate)[0], bounds=bracket, method="bounded"
        )
        values = problem.values(*fit_bristle(float(optimum.x))[1:])
        return FrictionLaw(name=self.name, structure={}, form=form, values=values)
