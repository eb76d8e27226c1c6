"""A friction FMU of another exporter with HESR's connectors: Coulomb, viscous and load terms."""

import math

from pythonfmu import Fmi2Causality, Fmi2Slave, Real

LEVEL = (9.6, 12.1, 5.5)
VISCOUS = (16.6, 12.5, 4.0)


class Coulomb(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for kind, names in (("input", ("dq", "q", "tau_load")), ("output", ("tau",))):
            for name in names:
                for i in (1, 2, 3):
                    setattr(self, f"{name}{i}", 0.0)
                    self.register_variable(
                        Real(
                            f"{name}[{i}]",
                            causality=getattr(Fmi2Causality, kind),
                            getter=lambda at=f"{name}{i}": getattr(self, at),
                            setter=lambda value, at=f"{name}{i}": setattr(self, at, value),
                        )
                    )

    def exit_initialization_mode(self):
        self.do_step(0.0, 0.0)

    def do_step(self, current_time, step_size):
        for i, (level, viscous) in enumerate(zip(LEVEL, VISCOUS, strict=True), start=1):
            dq, load = getattr(self, f"dq{i}"), getattr(self, f"tau_load{i}")
            level += 0.001 * abs(load)
            setattr(self, f"tau{i}", level * math.tanh(dq / 0.02) + viscous * dq)
        return True
