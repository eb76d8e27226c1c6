"""Servo friction of BAM (better actuator models), M1 to M6: maps of velocity and load.

Source: M. Duclusaud, G. Passault, V. Padois, O. Ly, Extended friction models for the physics
simulation of servo actuators, 2024 (arXiv 2410.08650), and the documentation of BAM.

With e = exp(-|v/v_s|^alpha), alpha 1, 2 or 3, and the load L, the torque is sgn(v) times

    M1  F_c                             M2  F_c + F_e e
    M3  F_c + mu |L|                    M4  F_c + mu |L| + e (F_e + mu_e |L|)
    M5  M4 with separate mu, mu_e for the driving and the driven motor
    M6  M5 + e nu L^2, with separate nu

plus viscous friction and an offset. BAM weighs the motor torque, K_m, against the load, K_e. The
motor torque is load plus friction tau, so tau = F_c + |(K_m + K_e) L + K_m tau|, solved for tau, is
a level per load of (K_m + K_e)/(1 -+ K_m), for the driving and the driven motor. These two are
fitted.
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import sympy

from hesr_model.equations.functions import absolute, positive, sgn
from hesr_model.errors import ArtifactError
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.laws.stribeck import F_C, SIGMA_2, TAU_0, V_S, VELOCITY_BOUNDS
from hesr_model.rigid_body.friction_record import FrictionRecord

ALPHAS = (1, 2, 3)  # candidate exponents of the Stribeck curve
_USUAL_ALPHA = 2
_STRIBECK_FACTOR = sympy.Symbol("e", real=True)  # stands for exp(-|v/v_s|^alpha)
_AHEAD = positive(sgn(DQ) * TAU_LOAD)  # load in the direction of motion: the motor drives
_BACK = positive(-sgn(DQ) * TAU_LOAD)  # load against it: the motor is driven
_LOAD_SIZE = absolute(TAU_LOAD)


def _term(name: str, unit: str, description: str, expression: sympy.Expr) -> tuple[Any, sympy.Expr]:
    return Coefficient(name=name, unit=unit, description=description), expression


_LEVEL = _term("F_c", F_C.unit, F_C.description, sympy.Integer(1))
_RISE = _term("F_e", "N.m", "rise of friction at rest", _STRIBECK_FACTOR)
_LOAD = _term("mu", "1", "friction per load", _LOAD_SIZE)
_LOAD_RISE = _term("mu_e", "1", "its rise at rest", _STRIBECK_FACTOR * _LOAD_SIZE)
_DRIVING = (
    _term("mu_d", "1", "friction per load, driving motor", _AHEAD),
    _term("mu_e_d", "1", "its rise at rest, driving motor", _STRIBECK_FACTOR * _AHEAD),
    _term("mu_b", "1", "friction per load, driven motor", _BACK),
    _term("mu_e_b", "1", "its rise at rest, driven motor", _STRIBECK_FACTOR * _BACK),
)
_SQUARE_TEXT = "rise at rest per square of the load"
_SQUARES = (
    _term("nu_d", "1/(N.m)", f"{_SQUARE_TEXT}, driving motor", _STRIBECK_FACTOR * _AHEAD**2),
    _term("nu_b", "1/(N.m)", f"{_SQUARE_TEXT}, driven motor", _STRIBECK_FACTOR * _BACK**2),
)


class _Bam(OneForm):
    """A model above: a sum of terms times sgn(v), viscous friction and an offset."""

    terms: ClassVar[tuple[tuple[Coefficient, sympy.Expr], ...]]
    everyday = False
    classic = True

    @classmethod
    def core(cls, structure: Mapping[str, Any]) -> LawForm:
        cls._require_choices(structure)
        alpha = structure.get("alpha", _USUAL_ALPHA)
        stribeck_factor = sympy.exp(-((absolute(DQ) / V_S.symbol) ** alpha))
        level = sum(coefficient.symbol * factor for coefficient, factor in cls.terms)
        level = level.xreplace({_STRIBECK_FACTOR: stribeck_factor})
        coefficients = [coefficient for coefficient, _ in cls.terms]
        coefficients += [SIGMA_2, TAU_0]
        if cls._has_rise():
            coefficients.append(V_S)
        return LawForm(
            coefficients=tuple(coefficients),
            output=level * sgn(DQ) + SIGMA_2.symbol * DQ + TAU_0.symbol,
        )

    @classmethod
    def _require_choices(cls, structure: Mapping[str, Any]) -> None:
        """Raise ArtifactError unless a structure chooses at most the exponent, if there is one."""
        keys: set[str] = set()
        choices = "nothing"
        if cls._has_rise():
            keys = {"alpha"}
            choices = f"'alpha', one of {', '.join(map(str, ALPHAS))}"
        if structure.keys() - keys or structure.get("alpha", _USUAL_ALPHA) not in ALPHAS:
            raise ArtifactError(
                f"law '{cls.name}' has {choices} to choose, found {dict(structure)}."
            )

    def space(self) -> SearchSpace:
        bounds = []
        if self._has_rise():
            bounds.append((V_S.name, VELOCITY_BOUNDS))
        non_negative = [coefficient.name for coefficient, _ in self.terms]
        non_negative.append(SIGMA_2.name)
        return SearchSpace(
            bounds=tuple(bounds),
            linear=(*non_negative, TAU_0.name),
            non_negative=len(non_negative),
        )

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Fit with each exponent and keep the least squares."""
        if not self._has_rise():
            return super().fit(records, rng)
        rows = JointRows.from_records(records, coefficients=len(self.core({}).coefficients))
        space = self.space().scale_to_joint(is_prismatic=rows.sliding)
        fits = []
        for alpha in ALPHAS:
            problem = Separable(self.core({"alpha": alpha}), space, rows)
            point = problem.polish(problem.search(rng))
            fits.append((problem.solve(point)[1], alpha, problem, point))
        _, alpha, problem, point = min(fits, key=lambda fit: fit[0])
        return self.finish({"alpha": alpha}, problem, point)

    @classmethod
    def _has_rise(cls) -> bool:
        return any(factor.has(_STRIBECK_FACTOR) for _, factor in cls.terms)


def _register(
    number: int, *level: tuple[Coefficient, sympy.Expr], chosen_from_commands: bool = False
) -> None:
    @register
    class Model(_Bam):
        __doc__ = _Bam.__doc__
        name = f"bam_m{number}"
        title = f"BAM M{number}"
        order = 190 + 10 * number
        terms = level
        from_commands = chosen_from_commands


_register(1, _LEVEL)
_register(2, _LEVEL, _RISE)
_register(3, _LEVEL, _LOAD, chosen_from_commands=True)
_register(4, _LEVEL, _RISE, _LOAD, _LOAD_RISE, chosen_from_commands=True)
_register(5, _LEVEL, _RISE, *_DRIVING)
_register(6, _LEVEL, _RISE, *_DRIVING, *_SQUARES)
