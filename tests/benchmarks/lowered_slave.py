"""Table I as a fast PythonFMU slave: each expression lowered to Python's own numbers."""

import sympy
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

from fmu_src import model_file
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.model import FrictionModel


class LoweredFriction(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        model = FrictionModel.read(model_file("uf850-table1"))
        self.laws = [lowered(law) for law in model.laws]
        self.h, self.dq, self.tau = [0.0] * 3, [0.0] * 3, [0.0] * 3
        for i, _ in enumerate(model.laws, start=1):
            self.register_variable(
                Real(
                    f"dq[{i}]",
                    causality=Fmi2Causality.input,
                    variability=Fmi2Variability.continuous,
                    start=0.0,
                    getter=lambda i=i: self.dq[i - 1],
                    setter=lambda value, i=i: self.dq.__setitem__(i - 1, value),
                )
            )
            self.register_variable(
                Real(
                    f"tau[{i}]",
                    causality=Fmi2Causality.output,
                    getter=lambda i=i: self.tau[i - 1],
                )
            )

    def do_step(self, current_time, step_size):
        for i, (drive, rate, torque) in enumerate(self.laws):
            dq = self.dq[i]
            b, r = drive(dq), rate(dq)
            self.h[i] = h = (1.0 - r * step_size) * self.h[i] + b * step_size
            self.tau[i] = torque(dq, h, b - r * h)
        return True


def lowered(law):
    """Return drive and rate as functions of dq, and the torque as one of dq, h and h'."""
    values = {c.symbol: law.values[c.name] for c in law.form.coefficients}
    (h,) = law.form.relaxations
    drive, rate, torque = (e.subs(values) for e in (h.drive, h.rate, law.form.output))
    dq = INPUTS[0]
    return (
        sympy.lambdify(dq, drive, modules="math"),
        sympy.lambdify(dq, rate, modules="math"),
        sympy.lambdify((dq, h.state, h.derivative), torque, modules="math"),
    )
