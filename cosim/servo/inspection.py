"""What logs without torque say before a fit."""

from collections.abc import Sequence

import numpy as np

from cosim.servo.current import read_current
from cosim.servo.record import read_servo_records
from cosim.servo.start import delay_commands, find_start
from hesr_model.errors import FitError
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot


def describe_currents(logs: Sequence[Log], robot: Robot) -> list[str]:
    """Return what the currents without a sign of all joints are, by the measured servo errors.

    Joints that hardly move are left out.
    """
    if any(log.current_size is None for log in logs):
        return []
    kind = robot.description.servo.kind
    sentences = []
    for records in read_servo_records(logs, robot, robot.nominal_parameters):
        try:
            latency = find_start(records, kind).latency
        except FitError:
            continue
        errors = [delay_commands(record, latency) - record.q for record in records]
        blocks = np.zeros(sum(len(record.t) for record in records), dtype=int)
        reading = read_current(records, errors, blocks)
        assert reading is not None
        sentences.append(f"{records[0].joint}: {reading.sentence}")
    return sentences


def require_motion_by_commands(logs: Sequence[Log], robot: Robot) -> None:
    """Raise FitError if a joint moves too little for a fit to its commands."""
    kind = robot.description.servo.kind
    for records in read_servo_records(logs, robot, robot.nominal_parameters):
        find_start(records, kind)
