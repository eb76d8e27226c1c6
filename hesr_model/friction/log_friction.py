"""Measured friction of logs, for predictions and scores of models."""

from pathlib import Path

import numpy as np

from hesr_model.errors import LogError
from hesr_model.friction.records import rmse
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import RobotLike, to_robot
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg, to_path

LogSource = Log | PathArg


def read_log(log: LogSource, robot: RobotLike | None = None) -> Log:
    """Return a log; a path is read, which needs a robot."""
    if isinstance(log, Log):
        return log
    path: Path = to_path(log, "a log")
    if robot is None:
        raise LogError(
            f"{path}: give 'robot' to read this log.", code="log.robot", where=path, key="robot"
        )
    return Log.read(path, robot)


def separate_friction(
    log: LogSource, body: RigidBody | PathArg, robot: RobotLike | None = None
) -> list[FrictionRecord]:
    """Return the friction of all joints in a log; the robot is by default that of the log."""
    read = read_log(log, robot)
    if robot is None:
        robot = read.robot
    if robot is None:
        raise LogError(
            f"{read.where}: the log does not name its robot; give 'robot'.",
            code="log.robot",
            where=read.where,
            key="robot",
        )
    if not isinstance(body, RigidBody):
        body = RigidBody.read(to_path(body, "'rigid_body'"))
    return friction_records(read, to_robot(robot), body)


def mean_determination(tau: Array, tau_predicted: Array) -> float:
    """Return R2 of predictions (N, n) [N.m], averaged over joints."""
    scores = []
    for error, measured in zip((tau_predicted - tau).T, tau.T, strict=True):
        spread = float(np.std(measured))
        if spread:
            scores.append(1.0 - (rmse(error) / spread) ** 2)
        else:
            scores.append(float(rmse(error) == 0.0))
    return float(np.mean(scores))
