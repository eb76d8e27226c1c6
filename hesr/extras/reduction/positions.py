"""What the numbers of joints cost in positions, where a servo is known.

Each joint runs under its servo along the measured motion of the others, with its law, with the
numbers, and with the numbers in MuJoCo's own form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cosim.servo.engine import FINE_SUBSTEP, JointEngine
from cosim.servo.record import ServoRecord, read_servo_records
from hesr.extras.reduction.projection import LogRecords, PositionPrice, ReducedJoint
from hesr.extras.reduction.soft_friction import follow_commands
from hesr_model.errors import ExportError
from hesr_model.fitting.estimator import estimator
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record
from hesr_model.friction.servo import JointServo
from hesr_model.laws.baselines import CoulombViscous
from hesr_model.laws.stribeck import F_C, SIGMA_2, TAU_0
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, rms


@dataclass(frozen=True, kw_only=True)
class ServoRun:
    """Servos of all joints, and the records [joint][part of a log] that they run along.

    `is_measured` tells whether the records have the positions that the servos reached; otherwise
    positions are compared with those under the law.
    """

    servos: Sequence[JointServo]
    records: Sequence[Sequence[ServoRecord]]
    is_measured: bool


def read_commands(model: FrictionModel, logs: Sequence[Log], robot: Robot) -> ServoRun:
    """Return the run of a model that was fitted to commands along further logs."""
    return ServoRun(
        servos=[fitted.servo for fitted in model.servos],
        records=read_servo_records(logs, robot, robot.nominal_parameters),
        is_measured=True,
    )


def assume_servos(
    kp: Sequence[float], logs: Sequence[Log], robot: Robot, body: RigidBody | None
) -> ServoRun:
    """Return the run of servos with gains [N.m/rad] along logs with torque.

    Logs without commands are followed: their positions are the commands.
    """
    parameters = robot.nominal_parameters if body is None else body.parameters_for(robot)
    armatures = parameters[10 * robot.links : robot.inertial]
    if len(armatures) != robot.n:  # the body has no rotors
        armatures = np.zeros(robot.n)
    servos = [
        JointServo(kp=gain, armature=armature)
        for gain, armature in zip(kp, armatures.tolist(), strict=True)
    ]
    commanded_logs = []
    for log in logs:
        if log.q_cmd is None:
            commanded_logs.append(replace(log, q_cmd=log.q))
        else:
            commanded_logs.append(log)
    records = read_servo_records(commanded_logs, robot, parameters)
    return ServoRun(servos=servos, records=records, is_measured=False)


def predict_friction(model: FrictionModel, run: ServoRun) -> LogRecords:
    """Return the friction of the laws along the motion of logs without torque, [log][joint]."""
    joint_records = []
    for law, servo, records in zip(model.laws, run.servos, run.records, strict=True):
        friction_records = []
        for record in records:
            load = servo.body_factor * record.tau_load + servo.armature * record.ddq
            bare = record.to_friction_record(load, np.zeros_like(load))
            friction_records.append(replace(bare, tau=predict_record(law, bare)))
        joint_records.append(friction_records)
    return list(zip(*joint_records, strict=True))


def find_inertias(run: ServoRun) -> list[float]:
    """Return the mean inertia at each joint over the records [kg.m2]."""
    inertias = []
    for servo, records in zip(run.servos, run.records, strict=True):
        body_inertia = np.concatenate([record.inertia for record in records])
        inertias.append(servo.body_factor * float(np.mean(body_inertia)) + servo.armature)
    return inertias


def add_position_price(
    joint: ReducedJoint, law: FrictionLaw, servo: JointServo, run: ServoRun, j: int
) -> ReducedJoint:
    """Return joint j with the position errors of its law and of its numbers."""
    numbers = {F_C.name: joint.frictionloss, SIGMA_2.name: joint.damping, TAU_0.name: 0.0}
    form = estimator(CoulombViscous.name).form({})
    reduced_law = FrictionLaw(name=CoulombViscous.name, form=form, values=numbers)
    records = run.records[j]
    law_positions = _run_law(law, servo, records, sliding=joint.sliding)
    reduced_positions = _run_law(reduced_law, servo, records, sliding=joint.sliding)
    soft_positions = np.concatenate(
        [follow_commands(joint, record, servo, record.first_speed) for record in records]
    )
    reference = law_positions
    if run.is_measured:
        reference = np.concatenate([record.q for record in records])
    for positions in (law_positions, reduced_positions):
        if not np.all(np.isfinite(positions)):
            raise ExportError(
                f"joint '{joint.name}': it does not follow its commands under this servo; check "
                "its gain and the masses."
            )
    price = PositionPrice(
        kp=servo.kp,
        law=float(rms(law_positions - reference)),
        numbers=float(rms(reduced_positions - reference)),
        in_mujoco=float(rms(soft_positions - reference)),
        is_measured=run.is_measured,
    )
    return replace(joint, positions=price)


def _run_law(
    law: FrictionLaw, servo: JointServo, records: Sequence[ServoRecord], *, sliding: bool
) -> Array:
    """Return the positions (N,) over all records under a law."""
    with JointEngine(law, sliding=sliding) as engine:
        runs = [engine.run(record, servo, law.values, substep=FINE_SUBSTEP) for record in records]
    return np.concatenate(runs)
