"""Maxwell-slip law: ten stops in parallel, as a user would write it."""

import numpy as np

from hesr_model.equations.memory import Stop
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import Coefficient, LawForm
from hesr_model.laws.stribeck import SIGMA_2, TAU_0

FORCES = [Coefficient(name=f"F_{i}", unit="N.m", description="element") for i in range(1, 11)]
STOPS = [
    Stop(name=f"x{i}", unit="1", velocity=DQ, deflection=float(w), bound=1)
    for i, w in enumerate(np.geomspace(3e-5, 1e-2, 10), start=1)
]


class MaxwellSlip(OneForm):
    name, title = "maxwell_slip", "Maxwell-slip"

    @staticmethod
    def core(_structure):
        torque = sum(f.symbol * x.state for f, x in zip(FORCES, STOPS, strict=True))
        output = torque + SIGMA_2.symbol * DQ + TAU_0.symbol
        return LawForm(coefficients=(*FORCES, SIGMA_2, TAU_0), memory=(*STOPS,), output=output)

    def space(self):
        linear = (*(f.name for f in FORCES), "sigma_2", "tau_0")
        return SearchSpace(bounds=(), linear=linear, non_negative=11)
