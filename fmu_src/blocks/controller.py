"""The Controller FMU: velocity commands from desired motion, models and measurements."""

import numpy as np

from fmu_src.blocks.table import content, places, scalar, vector
from fmu_src.interface import Enumeration, Interface, Variable
from fmu_src.package import Content

COMPENSATION = Enumeration(
    name="Compensation",
    items=(
        ("none", "dq_comp = 0"),
        ("torque_error", "dq_comp = exp(-lambda |dq_d|) (Kp e + Kd de/dt), e = tau_d - tau_meas"),
        ("servo_inversion", "dq_comp = C^-1 (tau_d - tau_g), C(s) = Kv + Ki / s of the servo"),
    ),
)

_INPUTS = (
    ("q_d", "rad", "desired position, for the outer loop"),
    ("dq_d", "rad/s", "desired velocity"),
    ("tau_rb", "N.m", "rigid-body torque of the desired motion"),
    ("tau_f", "N.m", "friction torque of the desired motion"),
    ("tau_g", "N.m", "gravity torque at the measured position"),
    ("tau_meas", "N.m", "measured torque"),
    ("q", "rad", "measured position"),
)
_GAINS = (
    ("Kp", "rad/(s.N.m)", "gain of the torque error"),
    ("Kd", "rad/(N.m)", "gain of its derivative"),
    ("Kx", "1/s", "gain of the outer position loop"),
    ("Kv", "N.m.s/rad", "proportional gain of the servo"),
    ("Ki", "N.m/rad", "integral gain of the servo"),
)


def controller(joints: int, *, step: float = 0.005) -> Content:
    """Return the Controller FMU for a number of joints that samples every `step` [s]."""
    zeros = np.zeros(joints)
    gains = [f"{name}[{{}}]" for name, *_ in _GAINS]
    models = ["tau_rb[{}]", "tau_f[{}]", "friction_gain"]
    every = [f"{name}[{{}}]" for name, *_ in _INPUTS]
    outputs = (
        *vector("dq_cmd", "output", "rad/s", "commanded velocity", zeros,
                [*every, *gains, "lambda", "friction_gain", "sample_time", "compensation"]),
        *vector("tau_d", "output", "N.m", "desired torque", zeros, models),
        *vector("dq_comp", "output", "rad/s", "compensation in the command", zeros,
                [*models, "dq_d[{}]", "tau_g[{}]", "tau_meas[{}]", *gains, "lambda",
                 "sample_time", "compensation"]),
    )  # fmt: skip
    table = Interface(
        variables=(
            *(v for n, unit, text in _INPUTS for v in vector(n, "input", unit, text, zeros)),
            *outputs,
            Variable(
                name="compensation",
                role="fixed",
                description="scheme of the compensation",
                enumeration=COMPENSATION,
                start=1.0,
            ),
            scalar("sample_time", "fixed", "s", "time between commands", step),
            scalar("lambda", "tunable", "s/rad", "decay of Kp and Kd with the velocity", 4.0),
            scalar("friction_gain", "tunable", "1", "factor on the friction torque", 1.0),
            *(v for n, unit, text in _GAINS for v in vector(n, "tunable", unit, text, zeros)),
        ),
        own=4 * joints + 1,  # what controller.c remembers
        model_exchange=False,
        directional_derivatives=False,
    )
    names = [name for name, *_ in (*_INPUTS, *_GAINS)] + ["dq_cmd", "tau_d", "dq_comp"]
    first = {name.upper(): f"{name}[1]" for name in names}
    first |= {n.upper(): n for n in ("compensation", "sample_time", "lambda", "friction_gain")}
    schemes = {name.upper(): i for i, (name, _) in enumerate(COMPENSATION.items, start=1)}
    return content(
        table,
        name="Controller",
        text="Velocity commands from desired motion, models and measurements.",
        source="controller.c",
        headers={"control.h": places(table, "CONTROL_H", first, JOINTS=joints, **schemes)},
        step=step,
    )
