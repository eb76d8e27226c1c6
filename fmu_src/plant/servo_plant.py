"""Plants of robots whose servos and friction were fitted to commands."""

import numpy as np

from fmu_src.friction.validity import require_scale
from fmu_src.plant.plant_fmu import PlantBody, require_fitting
from fmu_src.plant.servo import UNLIMITED, PositionServo
from hesr_model.friction.model import FrictionModel
from hesr_model.robots.robot import Robot

_LEAST_WIDTH = 1e-6  # of the interval of a factor that is 1 by definition


def find_servo_plant(model: FrictionModel, robot: Robot) -> tuple[PlantBody, PositionServo]:
    """Return the bodies, with armature, and the servos of a model that was fitted to commands.

    The links are those of the model file; where gains were stated, they are as heavy as the joints
    that feel them say on average.

    Raises ExportError if nothing fixes the size of torques, or the robot is another one.
    """
    require_fitting(model, robot)
    require_scale(model)
    if not robot.description.rotor_inertia:
        robot = Robot(robot.description.model_copy(update={"rotor_inertia": True}))
    servos = [fitted.servo for fitted in model.servos]
    parameters = robot.nominal_parameters.copy()
    links = slice(0, 10 * robot.links)
    rotors = slice(10 * robot.links, robot.inertial)
    parameters[links] *= _find_body_factor(model)
    parameters[rotors] = [servo.armature for servo in servos]
    plant_body = PlantBody(robot=robot, parameters=parameters)
    plant_body.require_inertia("the fit to commands")
    position_servo = PositionServo(
        kp=tuple(servo.kp for servo in servos),
        ki=tuple(servo.ki for servo in servos),
        kd=tuple(servo.kd for servo in servos),
        torque_limit=tuple(_limit(servo.torque_limit) for servo in servos),
        command_filter=tuple(servo.command_filter for servo in servos),
        speed_limit=tuple(_limit(servo.speed_limit) for servo in servos),
        latency=float(np.median([servo.latency for servo in servos])),
    )
    return plant_body, position_servo


def _limit(value: float | None) -> float:
    return UNLIMITED if value is None else value


def _find_body_factor(model: FrictionModel) -> float:
    """Return the factor of all links: the mean of the joints, weighed by their intervals."""
    factors = []
    weights = []
    for fitted in model.servos:
        width = fitted.intervals.get("body_factor")
        if width is not None and fitted.servo.body_factor > 0.0:
            factors.append(np.log(fitted.servo.body_factor))
            relative_width = max(width / fitted.servo.body_factor, _LEAST_WIDTH)
            weights.append(relative_width**-2)
    return float(np.exp(np.average(factors, weights=weights))) if factors else 1.0
