"""Friction of the joints of an MJCF, as laws: for tests of parameters that others chose.

A joint of MuJoCo 4 has, with the speed v of the joint and u = gear v of an actuator (XML reference,
body/joint and actuator/dcmotor),

    frictionloss sgn(v) + v (d_0 + d_1 |v| + d_2 v^2)
    + sum over its dcmotors: gear (stiffness z + damping z'),
      z' = u - stiffness |u| / g(u) z,   g = coulomb + (static - coulomb) exp(-(u / stribeck)^2)

where d adds those of the joint and, times gear^2, those of its actuators. Torques of position alone
(springs, cogging) neither take nor give energy over a cycle, and are left out; so are the
electrical branches, which a voltage drives.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import sympy

from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ConfigError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.mjcf import compile_model, import_engine

LAW_NAME = "mujoco"
# Places in actuator_dynprm.
_STIFFNESS = 5
_MICRO_DAMPING = 6
# Places in actuator_biasprm.
_COULOMB = 3
_STATIC = 4
_STRIBECK = 5


@dataclass(frozen=True, kw_only=True)
class _DcMotor:
    """Numbers of a bristle at its actuator, and the gear to the joint."""

    gear: float
    stiffness: float
    micro_damping: float
    coulomb: float
    static: float
    stribeck: float


def read_mujoco_friction(path: Path) -> FrictionModel:
    """Return the friction of all hinges and slides of an MJCF that have any.

    Raises ConfigError if MuJoCo cannot compile it, a bristle has no force, or nothing rubs.
    """
    mj_model = compile_model(path)
    joints = []
    laws = []
    sliding = []
    kinds = import_engine().mjtJoint
    for j in range(mj_model.njnt):
        kind = kinds(mj_model.jnt_type[j])
        if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            continue
        name = mj_model.joint(j).name or f"joint{j}"
        form = _build_form(mj_model, j, f"{path}: joint '{name}'")
        if form.output == 0:
            continue
        joints.append(name)
        laws.append(FrictionLaw(name=LAW_NAME, form=form, values={}))
        sliding.append(kind == kinds.mjJNT_SLIDE)
    if not joints:
        raise ConfigError(f"{path}: no joint has frictionloss, damping or a bristle of a dcmotor.")
    return FrictionModel(
        law=path.stem,
        robot=path.stem,
        joints=tuple(joints),
        laws=tuple(laws),
        sliding=tuple(sliding),
        sample_time=float(mj_model.opt.timestep),
    )


def _build_form(mj_model: Any, j: int, subject: str) -> LawForm:
    """Return the friction of a joint with numbers in place of coefficients."""
    dof = int(mj_model.jnt_dofadr[j])
    actuators = list(_find_actuators(mj_model, j))
    gears = [float(mj_model.actuator_gear[k, 0]) for k in actuators]
    coefficients = np.concatenate([[mj_model.dof_damping[dof]], mj_model.dof_dampingpoly[dof]])
    for k, gear in zip(actuators, gears, strict=True):
        actuator_coefficients = np.concatenate(
            [[mj_model.actuator_damping[k]], mj_model.actuator_dampingpoly[k]]
        )
        coefficients = coefficients + gear**2 * actuator_coefficients
    output = sympy.Float(float(mj_model.dof_frictionloss[dof])) * sgn(DQ)
    for power, coefficient in enumerate(coefficients.tolist()):
        output += sympy.Float(coefficient) * DQ * absolute(DQ) ** power
    bristles = []
    for number, motor in enumerate(_find_motors(mj_model, actuators, gears), start=1):
        if motor.coulomb <= 0.0 or motor.static <= 0.0:
            raise ConfigError(f"{subject}: the levels of its bristle must be positive.")
        bristle = _build_bristle(f"z{number}", motor)
        bristles.append(bristle)
        output += motor.gear * motor.stiffness * bristle.state
        output += motor.gear * motor.micro_damping * bristle.derivative
    return LawForm(coefficients=(), memory=tuple(bristles), output=output)


def _find_actuators(mj_model: Any, j: int) -> Iterator[int]:
    """Yield the actuators that act on a joint."""
    transmissions = import_engine().mjtTrn
    for k in range(len(mj_model.actuator_trntype)):  # some have no control
        transmission = transmissions(mj_model.actuator_trntype[k])
        is_of_joint = transmission in (
            transmissions.mjTRN_JOINT,
            transmissions.mjTRN_JOINTINPARENT,
        )
        if is_of_joint and mj_model.actuator_trnid[k, 0] == j:
            yield k


def _find_motors(mj_model: Any, actuators: list[int], gears: list[float]) -> Iterator[_DcMotor]:
    """Yield the dcmotors with a bristle among actuators."""
    kinds = import_engine().mjtDyn
    for k, gear in zip(actuators, gears, strict=True):
        dynamics = mj_model.actuator_dynprm[k]
        levels = mj_model.actuator_biasprm[k]
        is_motor = kinds(mj_model.actuator_dyntype[k]) == kinds.mjDYN_DCMOTOR
        if is_motor and dynamics[_STIFFNESS] > 0.0 and gear:
            yield _DcMotor(
                gear=gear,
                stiffness=float(dynamics[_STIFFNESS]),
                micro_damping=float(dynamics[_MICRO_DAMPING]),
                coulomb=float(levels[_COULOMB]),
                static=float(levels[_STATIC]),
                stribeck=float(levels[_STRIBECK]),
            )


def _build_bristle(name: str, motor: _DcMotor) -> Relaxation:
    """Return the bristle z of a dcmotor over the speed of the joint, in LuGre's form."""
    level = sympy.Integer(1)
    if motor.stribeck > 0.0:
        speed = sympy.Float(motor.stribeck / abs(motor.gear))
        rise = sympy.Float(motor.static / motor.coulomb) - 1
        level += rise * sympy.exp(-((DQ / speed) ** 2))
    rate = sympy.Float(motor.stiffness * abs(motor.gear) / motor.coulomb)
    return Relaxation(
        name=name, unit="rad", drive=motor.gear * DQ, rate=rate * absolute(DQ) / level
    )
