"""Table I as a PythonFMU slave that runs the package's own Python law."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

from fmu_src import model_file
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import Stepper


class PythonFriction(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        model = FrictionModel.read(model_file("uf850-table1"))
        self.laws = [Stepper(law) for law in model.laws]
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
        self.tau = [law.step(step_size, v) for law, v in zip(self.laws, self.dq, strict=True)]
        return True
