"""Table I as a PythonFMU slave that runs the package's own Python law."""

import numpy as np
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

from fmu_src import model_file
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import LawStepper


class PythonFriction(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        model = FrictionModel.read(model_file("uf850-table1"))
        self.laws = [LawStepper(law) for law in model.laws]
        self.states = [np.array(law.start)[:, None] for law in model.laws]
        self.dq, self.tau = [0.0] * 3, [0.0] * 3
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
        zero, dt = np.zeros(1), np.array([step_size])
        for i, (law, v, x) in enumerate(zip(self.laws, self.dq, self.states, strict=True)):
            [self.tau[i]], self.states[i] = law(dt, np.array([v]), zero, zero, x)
        return True
