"""Controller of section V.D: velocity commands from desired motion, models and measurements.

    dq_cmd = dq_d + dq_comp + Kx (q_d - q),   tau_d = tau_rb + friction_gain tau_f

with dq_comp from one of three schemes. A command is held over a sample, so the inverse of the servo
acts at mid-sample on average.
"""

from dataclasses import replace

import sympy

from fmu_src.blocks.block import block
from fmu_src.export.package import Content
from hesr_model.equations.component import (
    Choice,
    Component,
    Equation,
    Parameter,
    Quantity,
    Requirement,
    previous,
)
from hesr_model.equations.functions import absolute
from hesr_model.equations.memory import DT

_Q = Quantity(name="q", unit="rad", description="measured position")
_TIME_CONSTANT = Parameter(
    name="time_constant",
    unit="s",
    description="time constant of the low-pass; 0 for none",
    tunable=False,
)


def velocity_equations() -> Component:
    """Return backward differences and a first-order low-pass filter of one joint."""
    tau = _TIME_CONSTANT.symbol
    share = sympy.Piecewise((1 - sympy.exp(-DT / tau), tau > 0), (1, True))
    speed = (_Q.symbol - previous("position")) / DT
    return Component(
        inputs=(_Q,),
        shared=(_TIME_CONSTANT,),
        equations=(
            Equation(name="dq", unit="rad/s", description="velocity of the last step", output=True,
                     expression=previous("dq") + share * (speed - previous("dq")),
                     start=sympy.Integer(0)),
            Equation(name="position", unit="rad", expression=_Q.symbol, start=_Q.symbol),
        ),
        requirements=(
            Requirement(name="time_constant", condition=tau >= 0, text="not be negative"),
        ),
    )  # fmt: skip


def velocity(joints: int, *, step: float = 0.005) -> Content:
    """Return the Velocity FMU for a number of joints with preferred step `step` [s]."""
    return block(
        velocity_equations(),
        joints,
        name="Velocity",
        text="Velocity of measured positions: backward differences and a low-pass.",
        step=step,
        example={"time_constant": 4.0 * step},
        notes=(
            "dt is the length of the step. The block gives the measured velocity to a friction law "
            "that must follow the measured motion, not the desired one.",
        ),
    )


COMPENSATION = Choice(
    name="compensation",
    description="scheme of the compensation",
    start=1.0,
    items=(
        ("none", "dq_comp = 0"),
        ("torque_error", "dq_comp = exp(-lambda |dq_d|) (Kp e + Kd de/dt), e = tau_d - tau_meas"),
        ("servo_inversion", "dq_comp = C^-1 (tau_d - tau_g), C(s) = Kv + Ki / s of the servo"),
    ),
)

_INPUTS = (
    Quantity(name="q_d", unit="rad", description="desired position, for the outer loop"),
    Quantity(name="dq_d", unit="rad/s", description="desired velocity"),
    Quantity(name="tau_rb", unit="N.m", description="rigid-body torque of the desired motion"),
    Quantity(name="tau_f", unit="N.m", description="friction torque of the desired motion"),
    Quantity(name="tau_g", unit="N.m", description="gravity torque at the measured position"),
    Quantity(name="tau_meas", unit="N.m", description="measured torque"),
    Quantity(name="q", unit="rad", description="measured position"),
)
_GAINS = (
    Parameter(name="Kp", unit="rad/(s.N.m)", description="gain of the torque error"),
    Parameter(name="Kd", unit="rad/(N.m)", description="gain of its derivative"),
    Parameter(name="Kx", unit="1/s", description="gain of the outer position loop"),
    Parameter(name="Kv", unit="N.m.s/rad", description="proportional gain of the servo"),
    Parameter(name="Ki", unit="N.m/rad", description="integral gain of the servo"),
)
_SAMPLE_TIME = Parameter(
    name="sample_time", unit="s", description="time between commands", tunable=False
)
_LAMBDA = Parameter(
    name="lambda", unit="s/rad", description="decay of Kp and Kd with the velocity", start=4.0
)
_FRICTION_GAIN = Parameter(
    name="friction_gain", unit="1", description="factor on the friction torque", start=1.0
)


def controller_equations(step: float) -> Component:
    """Return the equations of one joint, with `step` [s] as the default sample time."""
    q_d, dq_d, tau_rb, tau_f, tau_g, tau_meas, q = (i.symbol for i in _INPUTS)
    kp, kd, kx, kv, ki = (gain.symbol for gain in _GAINS)
    sample = _SAMPLE_TIME.symbol
    decay = _LAMBDA.symbol
    gain = _FRICTION_GAIN.symbol
    tau_d = Quantity(name="tau_d", unit="N.m", description="desired torque").symbol
    e, integral = sympy.symbols("e integral", real=True)
    rate = (e - previous("e")) / sample
    torque_error = sympy.exp(-decay * absolute(dq_d)) * (kp * e + kd * rate)
    servo_inversion = (tau_d - tau_g - ki * integral) / (kv + ki * sample / 2)
    inverting = sympy.Eq(COMPENSATION.symbol, 3)
    return Component(
        inputs=_INPUTS,
        parameters=_GAINS,
        shared=(COMPENSATION, replace(_SAMPLE_TIME, start=step), _LAMBDA, _FRICTION_GAIN),
        equations=(
            Equation(name="dq_cmd", unit="rad/s", description="commanded velocity", output=True,
                     expression=dq_d + sympy.Symbol("dq_comp", real=True) + kx * (q_d - q)),
            Equation(name="tau_d", unit="N.m", description="desired torque", output=True,
                     expression=tau_rb + gain * tau_f),
            Equation(name="dq_comp", unit="rad/s", description="compensation in the command",
                     output=True, start=sympy.Integer(0),
                     expression=COMPENSATION.case({"torque_error": torque_error,
                                                   "servo_inversion": servo_inversion})),
            Equation(name="e", unit="N.m", expression=tau_d - tau_meas, start=e),
            # At rest the servo's integral holds the torque.
            Equation(name="integral", unit="rad",
                     expression=previous("integral") + sample * previous("dq_comp"),
                     start=sympy.Piecewise(((tau_d - tau_g) / ki, ki > 0), (0, True))),
        ),
        sample_time=_SAMPLE_TIME.name,
        requirements=(
            Requirement(name="sample_time", condition=sample > 0, text="be positive"),
            Requirement(name="Kv", condition=sympy.Or(~inverting, kv > 0),
                        text="be positive for servo_inversion"),
            Requirement(name="Ki", condition=sympy.Or(~inverting, ki >= 0),
                        text="not be negative for servo_inversion"),
        ),
    )  # fmt: skip


_CONTROLLER_NOTES = (
    "The motion q_d is that of now; dq_d and the motion behind tau_rb and tau_f are ahead by the "
    "preview, the latency of the servo plus half a sample, if compensation is servo_inversion. "
    "Otherwise the preview is 0.",
    "The servo of the arm makes the torque Kv (dq_cmd - dq) + Ki times the integral of dq_cmd - dq "
    "and compensates gravity. Its inverse therefore needs tau_g: the rigid-body torque at the "
    "measured position, at rest.",
    "Kp, Kd and lambda act if compensation is torque_error, Kv and Ki if it is servo_inversion, "
    "and Kx always. Kv and Ki are those of the servo; do not tune them.",
    "previous(x) is x at the last sample; samples are sample_time apart.",
)


def controller(joints: int, *, step: float = 0.005) -> Content:
    """Return the Controller FMU for a number of joints with sample time `step` [s]."""
    return block(
        controller_equations(step),
        joints,
        name="Controller",
        text="Velocity commands from desired motion, models and measurements.",
        step=step,
        example={"compensation": 3.0, "Kv": 100.0, "Ki": 500.0, "Kx": 5.0, "friction_gain": 0.9},
        notes=_CONTROLLER_NOTES,
    )
