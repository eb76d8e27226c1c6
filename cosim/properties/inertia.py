"""The inertia of a robot's joints, for experiments in which torque moves them."""

from collections.abc import Mapping

import numpy as np

from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import RobotModel
from hesr_model.support.arrays import Array

INERTIA: Mapping[str, tuple[float, ...]] = {"uf850": (3.0, 3.0, 0.6)}
"""Inertia of the joints of robots that come with HESR, the others at rest [kg.m2]."""


def standing_inertia(
    robot: RobotModel, body: RigidBody, model: FrictionModel
) -> tuple[float, ...] | None:
    """Return the inertia of each joint about its axis in the middle of the trained positions.

    That of the list above where the robot stands there, else the diagonal of the identified mass
    matrix [kg.m2]; None where that is not positive, as few data may leave it.
    """
    if body.robot in INERTIA:
        return INERTIA[body.robot]
    n = robot.n
    middle = np.array([seen.middle for seen in model.trained]) if model.trained else np.zeros(n)
    q: Array = np.tile(middle, (n + 1, 1))
    still = np.zeros_like(q)
    # One joint accelerates at a time, and none in the last row, which is gravity alone.
    torque = robot.torque(body.parameters, q, still, np.eye(n + 1, n))
    found = np.diag(torque[:n] - torque[n])
    return tuple(map(float, found)) if np.all(found > 0.0) else None
