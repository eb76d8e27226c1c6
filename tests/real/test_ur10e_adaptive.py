"""Adaptive friction of a UR10e over several days, starting from the law of the training logs."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from ur10e_logs import IDENTIFICATION

from hesr.extras.adaptive.monitor import Follower
from hesr_model.fitting.fit import fit
from hesr_model.friction.records import rmse
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription

DAYS = (
    "test_ptp_10_points",
    *(f"friction_sine_joint{k}" for k in range(1, 7)),
    "test_fourier_20s_8harm",
    "test_fourier_20s_7harm",
    "test_fourier_40s_12harm",
)
"""Logs without a fit of any law, in the order of their days."""

MOVES = 0.1
"""[rad/s] Maximum speed of joints without information, which cannot improve."""


Days = Callable[[Sequence[str]], list[list[FrictionRecord]]]


@pytest.fixture(scope="module")
def read(ur10e_data: Path, ur10e: RobotDescription, ur10e_model: Robot, id_logs: list[Log]) -> Days:
    """Records [log][joint] of logs by name."""
    body = identify(id_logs, ur10e_model)

    def records(names: Sequence[str]) -> list[list[FrictionRecord]]:
        logs = (Log.read(ur10e_data / f"{name}.csv", ur10e) for name in names)
        return [friction_records(log, ur10e_model, body) for log in logs]

    return records


def ratios(
    law: str, training: Sequence[Sequence[FrictionRecord]], days: Sequence[Sequence[FrictionRecord]]
) -> tuple[np.ndarray, np.ndarray]:
    """Return [log][joint] error of the adaptive law over that of the fixed law, and the moving
    joints."""
    follower = Follower(fit(law, *training))
    found = [
        [
            rmse(one.outputs["tau"] - one.record.tau) / rmse(one.tau_fixed - one.record.tau)
            for one in follower.follow(day)
        ]
        for day in days
    ]
    moved = [[np.abs(record.dq).max() > MOVES for record in day] for day in days]
    return np.array(found), np.array(moved)


@pytest.mark.soak
@pytest.mark.parametrize("law", ["parfam_s", "lugre_load"])
def test_moving_joints_improve_and_none_gets_worse(read: Days, law: str) -> None:
    found, moved = ratios(law, read(IDENTIFICATION), read(DAYS))
    assert found.max() <= 1.01
    assert np.exp(np.log(found[moved]).mean()) <= 0.98


def test_a_day_left_out_of_training_improves(read: Days) -> None:
    """The criterion that selected the filter's constants, for one of the days."""
    long, middle, short = read(IDENTIFICATION)
    found, _ = ratios("lugre_load", [long, middle], [short])
    assert found.max() <= 1.01
    assert np.exp(np.log(found).mean()) <= 0.98
