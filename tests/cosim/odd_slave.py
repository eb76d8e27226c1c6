"""A PythonFMU with parameters of every type; its output is NaN after 0.3 s without an error."""

import math

from pythonfmu import (
    Boolean,
    Fmi2Causality,
    Fmi2Slave,
    Fmi2Variability,
    Integer,
    Real,
    String,
)


class Odd(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u = 0.0
        self.y = 0.0
        self.on = False
        self.times = 1
        self.text = "x"
        parameter = {
            "causality": Fmi2Causality.parameter,
            "variability": Fmi2Variability.fixed,
        }
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))
        self.register_variable(Boolean("on", **parameter))
        self.register_variable(Integer("times", **parameter))
        self.register_variable(String("text", **parameter))

    def do_step(self, current_time, step_size):
        late = current_time + step_size > 0.25
        self.y = math.nan if late else len(self.text) * self.times * self.on + 0.0
        return True
