"""Rigid body from commands: the model file's links, with the armature that servos turn."""

from collections.abc import Sequence

import numpy as np

from cosim.servo.interval import NORMAL_QUANTILE
from cosim.servo.model import fit_from_commands
from fmu_src.plant.servo_plant import find_servo_plant
from hesr_model.errors import FitError
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.baselines import CoulombViscous
from hesr_model.laws.stribeck import F_C, SIGMA_2
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.base_parameters import base_columns, dependence
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, silent


def identify_from_commands(
    logs: Sequence[Log], robot: Robot, *, progress: Progress = silent
) -> RigidBody:
    """Identify armature, servo and friction of every joint from commands and positions.

    The links are those of the model file; where gains were stated, they are as heavy as the joints
    feel them. The residual is the position error times the gain.

    Parameters
    ----------
    logs : logs with commanded positions.
    robot : robot of the logs.
    progress : called with joints done and in total.

    Raises
    ------
    FitError
        If nothing fixes the size of torques, or commands do not explain the motion.
    """
    model = fit_from_commands(logs, robot, CoulombViscous.name, progress=progress)
    sentences = model.provenance["from_commands"]
    if any(fitted.scale == "none" for fitted in model.servos):
        said = next(sentence for sentence in sentences if "one factor" in sentence)
        raise FitError(f"{said}; a body in N.m needs one of these.")
    plant_body, servo = find_servo_plant(model, robot)
    plant_robot = plant_body.robot
    parameters = plant_body.parameters
    base = base_columns(plant_robot)
    errors = _find_errors(model, plant_robot, parameters)
    base_map = dependence(plant_robot, base)
    position_rmse = np.array([fitted.position_rmse for fitted in model.servos])
    friction = [[law.values[F_C.name], law.values[SIGMA_2.name], 0.0] for law in model.laws]
    return RigidBody(
        robot=robot.name,
        joints=robot.joints,
        names=plant_robot.parameter_names,
        parameters=parameters,
        base=base,
        standard_errors=np.sqrt(base_map**2 @ errors**2),
        condition=1.0,
        ridge=0.0,
        friction=np.array(friction),
        rmse=np.array(servo.kp) * position_rmse,
        rows=sum(len(log.t) for log in logs),
        logs=tuple(log.name for log in logs),
        method="stacked",
        weighting="ols",
        kind="nominal",
        sentence="\n".join(sentences),
    )


def _find_errors(model: FrictionModel, robot: Robot, parameters: Array) -> Array:
    """Return standard errors (P,): of links by the model's masses, of armatures by their fit."""
    errors = robot.description.scale.body_error * np.abs(parameters)
    rotors = slice(10 * robot.links, robot.inertial)
    widths = [fitted.intervals.get("armature", 0.0) for fitted in model.servos]
    errors[rotors] = np.array(widths) / NORMAL_QUANTILE
    return errors
