"""A PythonFMU with inputs and outputs of every type; each output repeats its input."""

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real, String


class Typed(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.gain, self.r, self.i, self.b, self.s = 1.0, 0.0, 0, False, "none"
        self.ro, self.io, self.bo, self.so = 0.0, 0, False, "start"
        parameter = {"causality": Fmi2Causality.parameter, "variability": Fmi2Variability.tunable}
        self.register_variable(Real("gain", **parameter))
        discrete = {"variability": Fmi2Variability.discrete}
        kinds = ((Real, "r"), (Integer, "i"), (Boolean, "b"), (String, "s"))
        for kind, name in kinds:
            more = {} if kind is Real else discrete
            self.register_variable(kind(name, causality=Fmi2Causality.input, **more))
            self.register_variable(kind(f"{name}o", causality=Fmi2Causality.output, **more))

    def do_step(self, current_time, step_size):
        self.ro, self.io, self.bo, self.so = self.gain * self.r, self.i, self.b, self.s
        return True
