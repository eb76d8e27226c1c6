"""MuJoCo's own form of Coulomb friction, a soft constraint: its creep, and the motion with it."""

from typing import Any

import numpy as np

from cosim.servo.record import ServoRecord
from hesr.extras.reduction.projection import ReducedJoint
from hesr_model.friction.servo import JointServo
from hesr_model.robots.mjcf import import_engine
from hesr_model.support.arrays import Array

STEP = 0.002  # [s], MuJoCo's own
DEFAULT_SOLREF = "0.02 1"
SOLREF = "0.004 1"
"""Time constant of two steps, the least that MuJoCo accepts, and damping ratio."""
_HELD_SHARE = 0.5  # of the Coulomb friction
_DURATION = 1.0  # [s], long against any time constant of the constraint
_SMALL_SHARE = 1e-3  # of the inertia that a link keeps beside its armature
_ROUND_OFF = 1e-6  # of the number of steps between two rows


def list_actuator_attributes(servo: JointServo) -> dict[str, str]:
    """Return the attributes of MuJoCo's `<position>` for a servo."""
    attributes = {"kp": f"{servo.kp:.6g}", "kv": f"{servo.kd:.6g}"}
    if servo.torque_limit is not None:
        limit = f"{servo.torque_limit:.6g}"
        attributes |= {"forcelimited": "true", "forcerange": f"-{limit} {limit}"}
    if servo.command_filter > 0.0:
        attributes["timeconst"] = f"{servo.command_filter:.6g}"
    return attributes


def simulate_creep(joint: ReducedJoint, *, solref: str = SOLREF) -> float:
    """Return the speed [rad/s] of a held joint that slips in MuJoCo.

    Parameters
    ----------
    joint : with Coulomb friction and inertia, half of whose friction is applied.
    solref : `solreffriction` of the joint.
    """
    mujoco, model = _build_axis(joint, solref)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = _HELD_SHARE * joint.frictionloss
    mujoco.mj_step(model, data, round(_DURATION / STEP))
    return abs(float(data.qvel[0]))


def follow_commands(
    joint: ReducedJoint, record: ServoRecord, servo: JointServo, first_speed: float
) -> Array:
    """Return the positions (N,) [rad; m] of a joint in MuJoCo along the commands of a log.

    Inertia, bias and its slope change from row to row, as in `cosim.servo.engine`. Steps are at
    most MuJoCo's own, and delays are rounded to them. Infinite if the simulation is unstable.
    """
    mujoco, model = _build_axis(joint, SOLREF, servo)
    data = mujoco.MjData(model)
    data.qpos[0] = record.q[0]
    data.qvel[0] = first_speed
    if model.na:
        data.act[0] = record.q_cmd[0]
    factor = servo.body_factor
    inertia = factor * record.inertia + servo.armature
    slope = factor * record.slope
    constant = factor * record.bias - slope * record.posture
    counts = np.maximum(1, np.ceil(np.diff(record.t) / STEP - _ROUND_OFF)).astype(int)
    positions = np.empty_like(record.q)
    positions[0] = record.q[0]
    link = float(model.body_inertia[1, 2])
    for k, count in enumerate(counts.tolist()):
        step = float(record.t[k + 1] - record.t[k]) / count
        model.opt.timestep = step
        model.dof_armature[0] = inertia[k] - link
        model.dof_M0[0] = inertia[k]  # which MuJoCo takes for bodies like this one
        model.dof_invweight0[0] = 1.0 / inertia[k]
        # The command in force in the middle of a step.
        times = record.t[k] + step * (np.arange(count) + 0.5) - servo.latency
        rows = np.maximum(np.searchsorted(record.t, times, side="right") - 1, 0)
        for command in record.q_cmd[rows].tolist():
            data.ctrl[0] = command
            data.qfrc_applied[0] = -(constant[k] + slope[k] * data.qpos[0])
            mujoco.mj_step(model, data)
        positions[k + 1] = data.qpos[0]
    # MuJoCo begins anew after numbers that are not finite, and counts them.
    if any(warning.number for warning in data.warning):
        return np.full_like(positions, np.inf)
    return positions


def _build_axis(
    joint: ReducedJoint, solref: str, servo: JointServo | None = None
) -> tuple[Any, Any]:
    """Return MuJoCo and its model of one axis without gravity, and with a servo if it has one."""
    mujoco = import_engine()
    kind = "slide" if joint.sliding else "hinge"
    armature = joint.armature or 0.0
    link_inertia = max(joint.inertia - armature, _SMALL_SHARE * joint.inertia)
    actuators = ""
    if servo is not None:
        link_inertia = _SMALL_SHARE * joint.inertia
        attributes = " ".join(
            f'{name}="{value}"' for name, value in list_actuator_attributes(servo).items()
        )
        actuators = f'<actuator><position joint="axis" {attributes}/></actuator>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{STEP!r}" gravity="0 0 0"/><worldbody><body>
        <inertial pos="0 0 0" mass="{link_inertia!r}"
            diaginertia="{link_inertia!r} {link_inertia!r} {link_inertia!r}"/>
        <joint name="axis" type="{kind}" axis="0 0 1" frictionloss="{joint.frictionloss!r}"
            damping="{joint.damping!r}" armature="{armature!r}" solreffriction="{solref}"/>
        </body></worldbody>{actuators}</mujoco>"""
    )
    return mujoco, model
