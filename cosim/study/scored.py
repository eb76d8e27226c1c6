"""What a run makes until its laws are scored on the test logs."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosim.study.scores import Comparison
from cosim.study.steps import Job, LogRecords, Predictions
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import RobotLog
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import RobotModel


@dataclass(frozen=True, kw_only=True)
class Scored:
    """What a run makes until its laws are scored on the test logs.

    Attributes
    ----------
    job : the steps of the study.
    robot : its model.
    rigid_body : the identified rigid body.
    files, logs, records : of every log, by name; records by part of the log and joint.
    models : fitted model of each law.
    left_out : why a law of the study was not fitted, by law.
    source : provenance of the laws.
    fmus : path of each law's FMU.
    comparisons : scores of the FMUs on each test set.
    predictions : their torques there.
    """

    job: Job
    robot: RobotModel
    rigid_body: RigidBody
    files: Mapping[str, Path]
    logs: Mapping[str, RobotLog]
    records: LogRecords
    models: Mapping[str, FrictionModel]
    left_out: Mapping[str, str]
    source: Mapping[str, Any]
    fmus: Mapping[str, Path]
    comparisons: Mapping[str, Comparison]
    predictions: Predictions
