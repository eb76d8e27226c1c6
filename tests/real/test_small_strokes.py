"""Measured benches with small strokes, in their true units."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.records import predict_record, rmse
from hesr_model.health.examine import examine
from hesr_model.inference.folds import split_into_folds
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records, require_reversals
from hesr_model.robots.robot import Robot, RobotDescription

EXAMPLES = Path(__file__).parents[3] / "shared" / "examples"
pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(not EXAMPLES.is_dir(), reason="needs the logs in ../shared/examples"),
]


@pytest.mark.parametrize("bench", ["fretting", "cylinder"])
def test_a_bench_with_a_small_stroke_is_not_refused(bench: str) -> None:
    folder = EXAMPLES / bench
    description = RobotDescription.read(folder / "robot.toml")
    logs = [Log.read(path, description) for path in sorted(folder.glob("*.csv"))]
    robot = Robot(description)

    assert not examine(logs, description, robot).findings

    body = identify(logs, robot)
    records = [friction_records(log, robot, body)[0] for log in logs]
    require_reversals(records)
    for fold in split_into_folds(smooth_logs(logs, robot)):
        assert fold.reverses(0)
        speeds = fold.resting_speeds
        assert np.all(speeds < 0.003)


@pytest.mark.parametrize(("law_name", "most"), [("lugre", 0.24), ("parfam_h", 0.22)])
def test_laws_of_a_fretting_rig_fit_in_its_true_units(law_name: str, most: float) -> None:
    """In N, on rows of later cycles, from a start in motion; with bounds of usual joints 0.26."""
    folder = EXAMPLES / "fretting"
    description = RobotDescription.read(folder / "robot.toml")
    log = Log.read(folder / "fretting.csv", description)
    first = log.rows(log.t < 40.0)
    robot = Robot(description)
    body = identify([first], robot)
    (record,) = friction_records(first, robot, body)
    law = fit_joint(law_name, [record], seed=0)
    (later_record,) = friction_records(log.rows(log.t > 110.0), robot, body)
    assert rmse(predict_record(law, later_record) - later_record.tau) < most
