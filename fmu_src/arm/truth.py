"""The true friction of an MJCF as a friction model."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import mujoco
import sympy

from fmu_src.arm.signals import passive_motors
from fmu_src.arm.table import LossTable
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.mjcf import compiled

_COEFFICIENTS = (
    ("stiffness", "N.m/rad", "bristle stiffness"),
    ("coulomb", "N.m", "Coulomb friction"),
    ("static", "N.m", "static friction"),
    ("stribeck", "rad/s", "Stribeck velocity"),
    ("damping", "N.m.s/rad", "viscous friction"),
    ("cogging", "N.m", "amplitude of the ripple"),
    ("poles", "1/rad", "ripples in a radian"),
    ("phase", "rad", "phase of the ripple"),
)
_OF_LOSSES = (
    ("constant", "N.m", "dry friction"),
    ("load", "1", "share of the load"),
    ("direct", "N.m", "direct effect of speed"),
    ("speed", "rad/s", "reference speed"),
    ("evolution", "N.m", "effect of age"),
    ("age", "s", "reference age"),
    ("slip", "rad", "slip distance that renews contacts"),
    ("longest", "s", "upper bound of the age"),
    ("viscous", "N.m.s/rad", "viscous friction"),
)


def true_friction(
    mjcf: Path, joints: Sequence[str], *, sample_time: float, losses: LossTable | None = None
) -> FrictionModel:
    """Return the friction of an MJCF's passive dcmotors, or losses and damping, as laws by joint.

    Each dcmotor is a LuGre element without micro-damping, with viscous friction and cogging:

        z' = v - stiffness |v| / g(v) z,  g = coulomb + (static - coulomb) exp(-(v / stribeck)^2)
        tau = stiffness z + damping v - cogging sin(poles q + phase)
    """
    model = compiled(mjcf)
    slide = mujoco.mjtJoint.mjJNT_SLIDE
    return FrictionModel(
        law="true_friction",
        robot=mjcf.stem,
        joints=tuple(joints),
        laws=tuple(
            _of_losses(losses, i, float(model.joint(joint).damping[0]))
            if losses
            else _law(model, passive_motors(model, joint))
            for i, joint in enumerate(joints)
        ),
        sliding=tuple(bool(model.joint(joint).type[0] == slide) for joint in joints),
        sample_time=sample_time,
    )


def _of_losses(losses: LossTable, i: int, viscous: float) -> FrictionLaw:
    coefficients = [Coefficient(name=n, unit=u, description=d) for n, u, d in _OF_LOSSES]
    values = losses.of_joint(i) | {"viscous": viscous}
    constant, load, direct, speed, evolution, reference, slip, longest, viscous_ = (
        c.symbol for c in coefficients
    )
    rate = absolute(DQ) / slip + 1 / longest
    age = Relaxation(name="s", unit="s", drive=sympy.Integer(1), rate=rate)
    level = constant + load * absolute(TAU_LOAD) + direct * sympy.log(1 + absolute(DQ) / speed)
    level += evolution * sympy.log(1 + age.state / reference)
    output = sgn(DQ) * level + viscous_ * DQ
    form = LawForm(coefficients=tuple(coefficients), memory=(age,), output=output)
    return FrictionLaw(name="true_friction", form=form, values=values)


def _law(model: Any, actuators: Sequence[int]) -> FrictionLaw:
    coefficients: list[Coefficient] = []
    values: dict[str, float] = {}
    relaxations: list[Relaxation] = []
    torque = sympy.Integer(0)
    for number, i in enumerate(actuators, start=1):
        bias, dynamics = model.actuator_biasprm[i], model.actuator_dynprm[i]
        numbers = (dynamics[5], *bias[3:6], model.actuator_damping[i], *bias[:3])
        own = [
            Coefficient(name=f"{name}_{number}", unit=unit, description=f"{text}, element {number}")
            for name, unit, text in _COEFFICIENTS
        ]
        coefficients += own
        values |= {c.name: float(x) for c, x in zip(own, numbers, strict=True)}
        stiffness, coulomb, static, stribeck, damping, cogging, poles, phase = (
            c.symbol for c in own
        )
        level = coulomb + (static - coulomb) * sympy.exp(-((DQ / stribeck) ** 2))
        element = Relaxation(
            name=f"z{number}", unit="rad", drive=DQ, rate=stiffness * absolute(DQ) / level
        )
        relaxations.append(element)
        torque += stiffness * element.state + damping * DQ - cogging * sympy.sin(poles * Q + phase)
    form = LawForm(coefficients=tuple(coefficients), memory=tuple(relaxations), output=torque)
    return FrictionLaw(name="true_friction", form=form, values=values)
