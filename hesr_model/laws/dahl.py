"""Dahl basis: parallel elements with rate-independent memory and fixed deflections."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import sympy

from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import Relaxation
from hesr_model.fitting.declarative import OneForm, no_structure
from hesr_model.fitting.estimator import register
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import SIGMA_2, TAU_0

DEFLECTIONS = np.geomspace(2e-4, 5e-2, 5)  # [rad] 1 / kappa: sharp to wide loops
_ELEMENTS = range(1, len(DEFLECTIONS) + 1)


def _define_coefficients(name: str, unit: str, description: str) -> tuple[Coefficient, ...]:
    return tuple(
        Coefficient(name=f"{name}_{i}", unit=unit, description=description.format(element=i))
        for i in _ELEMENTS
    )


_KAPPA = _define_coefficients(
    "kappa", "1/rad", "reciprocal of the sliding deflection of element {element}"
)
_FORCE = _define_coefficients("F", "N.m", "sliding friction of element {element}")
_LOAD = _define_coefficients("mu", "1", "sliding friction of element {element} per load")


@register
class DahlBasis(OneForm):
    """x_i' = kappa_i (v - |v| x_i), tau = sum_i F_i x_i + sigma_2 v + tau_0."""

    name = "dahl"
    title = "Dahl basis"
    order = 80
    classic = True
    load: ClassVar[bool] = False
    relaxed = False

    @classmethod
    def core(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions."""
        no_structure(cls.name, structure)
        elements = []
        torque = sympy.Integer(0)
        for i, kappa, force, rise in zip(_ELEMENTS, _KAPPA, _FORCE, _LOAD, strict=True):
            element = Relaxation(
                name=f"x{i}", unit="1", drive=kappa.symbol * DQ, rate=kappa.symbol * absolute(DQ)
            )
            elements.append(element)
            sliding_friction = force.symbol
            if cls.load:
                sliding_friction += rise.symbol * absolute(TAU_LOAD)
            torque += sliding_friction * element.state
        return LawForm(
            coefficients=(*_KAPPA, *cls._linear_coefficients()),
            memory=tuple(elements),
            output=torque + SIGMA_2.symbol * DQ + TAU_0.symbol,
        )

    @classmethod
    def _linear_coefficients(cls) -> tuple[Coefficient, ...]:
        """Return the coefficients in which the torque is linear, those of elements first."""
        if cls.load:
            return (*_FORCE, *_LOAD, SIGMA_2, TAU_0)
        return (*_FORCE, SIGMA_2, TAU_0)

    def space(self) -> SearchSpace:
        """Solve for all coefficients; F_i, mu_i >= 0, since elements must not drive."""
        linear = self._linear_coefficients()
        element_count = len(linear) - len((SIGMA_2, TAU_0))
        non_negative = 0 if self.relaxed else element_count
        return SearchSpace(
            bounds=(),
            linear=tuple(quantity.name for quantity in linear),
            values=tuple(
                (kappa.name, sympy.Float(1.0 / deflection))
                for kappa, deflection in zip(_KAPPA, DEFLECTIONS, strict=True)
            ),
            non_negative=non_negative,
        )


@register
class DahlBasisLoad(DahlBasis):
    """The Dahl basis with F_i + mu_i |tau_load| in place of F_i, of any sign if `relaxed`."""

    name = "dahl_load"
    title = "Dahl basis+load"
    order = 90
    adds = ("dahl", "load")
    load = True

    def __init__(self, *, relaxed: bool = False) -> None:
        self.relaxed = relaxed


RISE = Coefficient(name="rise", unit="1/(N.m)", description="relative rise of the bounds per load")
RISE_BOUNDS = (1e-4, 1.0)  # [1/(N.m)]


@register
class DahlBasisBound(DahlBasis):
    """x_i' = kappa_i (v - |v| x_i / (1 + rise |tau_load|)): a moving bound gives no energy."""

    name = "dahl_bound"
    title = "Dahl basis, load as bound"
    order = 100
    everyday = False
    limited = True
    typical: ClassVar[Mapping[str, Any]] = {"limited": True}

    @classmethod
    def core(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions."""
        unloaded_form = super().core(structure)
        bound = 1 + RISE.symbol * absolute(TAU_LOAD)
        return replace(
            unloaded_form,
            coefficients=(*unloaded_form.coefficients, RISE),
            memory=tuple(replace(x, rate=x.rate / bound) for x in unloaded_form.relaxations),
        )

    def space(self) -> SearchSpace:
        """Search the rise."""
        return replace(super().space(), bounds=((RISE.name, RISE_BOUNDS),))
