"""Baselines: what every user has without a friction model that is worth its name.

A study always has them, so that its recommendation can be judged against them. They can be fitted
to any log, also to one of constant speed, on which other laws are not determined.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy

from hesr_model.equations.functions import sgn
from hesr_model.errors import FitError
from hesr_model.fitting.declarative import no_structure
from hesr_model.fitting.estimator import Estimator, register
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.stribeck import F_C, SIGMA_2, TAU_0
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array, find_independent_columns


def fit_coulomb_viscous(dq: Array, tau: Array) -> tuple[float, float, float]:
    """Return Coulomb friction, viscous friction, both >= 0, and offset by least squares.

    What the motion does not separate is 0: viscous friction at one speed, and the offset of a
    motion in one direction, whose torque counts as Coulomb friction.

    Parameters
    ----------
    dq, tau : (N,) velocity [rad/s] and torque [N.m], N >= 1.

    Returns
    -------
    tuple
        F_c [N.m], sigma_2 [N.m.s/rad] and tau_0 [N.m].
    """
    columns = np.stack([np.sign(dq), dq, np.ones_like(dq)], axis=1)
    free_columns = [0, 1, 2]
    while True:
        is_independent = find_independent_columns(columns[:, free_columns])
        fitted_columns = [free_columns[k] for k in np.flatnonzero(is_independent)]
        coefficients = np.zeros(3)
        if fitted_columns:
            coefficients[fitted_columns] = np.linalg.lstsq(columns[:, fitted_columns], tau)[0]
        # In units of torque, so that the two can be compared.
        forces = coefficients[:2] * np.sqrt(np.mean(columns[:, :2] ** 2, axis=0))
        if forces.min() >= 0.0:
            return float(coefficients[0]), float(coefficients[1]), float(coefficients[2])
        free_columns.remove(int(np.argmin(forces)))


class _Baseline(Estimator):
    """A law of one form that the rows of any log determine."""

    expressions: ClassVar[LawForm]

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions; raise ArtifactError for structure data."""
        no_structure(cls.name, structure)
        return cls.expressions

    @staticmethod
    @abstractmethod
    def estimate(dq: Array, tau: Array) -> tuple[float, ...]:
        """Return the coefficients of rows (N,) of velocity [rad/s] and torque [N.m]."""

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Return the law of least squares; raise FitError for fewer rows than coefficients."""
        del rng
        dq = np.concatenate([record.dq for record in records])
        tau = np.concatenate([record.tau for record in records])
        coefficients = self.expressions.coefficients
        if len(tau) < len(coefficients):
            raise FitError(
                f"joint '{records[0].joint}': {len(tau)} rows for {len(coefficients)} "
                "coefficients; more data needed."
            )
        names = [quantity.name for quantity in coefficients]
        values = dict(zip(names, self.estimate(dq, tau), strict=True))
        return FrictionLaw(name=self.name, form=self.expressions, values=values)


@register
class NoFriction(_Baseline):
    """tau = 0: the rigid body alone."""

    name = "none"
    title = "No friction"
    order = 1
    baseline = True
    quick = True
    proposed = True
    from_commands = True
    expressions = LawForm(coefficients=(), output=sympy.S.Zero)

    @staticmethod
    def estimate(dq: Array, tau: Array) -> tuple[float, ...]:
        """Return no coefficients."""
        del dq, tau
        return ()


@register
class Constant(_Baseline):
    """tau = tau_0: the mean torque that the rigid body leaves."""

    name = "constant"
    title = "Constant"
    order = 2
    baseline = True
    quick = True
    proposed = True
    expressions = LawForm(coefficients=(TAU_0,), output=TAU_0.symbol)

    @staticmethod
    def estimate(dq: Array, tau: Array) -> tuple[float, ...]:
        """Return the mean torque."""
        del dq
        return (float(np.mean(tau)),)


@register
class CoulombViscous(_Baseline):
    """tau = F_c sgn(v) + sigma_2 v + tau_0, F_c, sigma_2 >= 0."""

    name = "coulomb_viscous"
    title = "Coulomb + viscous"
    order = 3
    baseline = True
    classic = True
    quick = True
    proposed = True
    from_commands = True
    expressions = LawForm(
        coefficients=(F_C, SIGMA_2, TAU_0),
        output=F_C.symbol * sgn(DQ) + SIGMA_2.symbol * DQ + TAU_0.symbol,
    )

    @staticmethod
    def estimate(dq: Array, tau: Array) -> tuple[float, ...]:
        """Return Coulomb and viscous friction and the offset."""
        return fit_coulomb_viscous(dq, tau)
