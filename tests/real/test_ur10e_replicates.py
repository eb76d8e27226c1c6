"""Repeated sines of the UR10e: the part of the squared error of ParFam-S that repeats."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.fitting.fit import fit_models
from hesr_model.friction.records import predict_record
from hesr_model.inference.replicates import (
    ErrorSplit,
    RobotMotion,
    find_period,
    find_repetitions,
    high_pass_errors,
    split_errors,
)
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription

# Measured before this code, with both errors interpolated to common stamps.
NOISE_BETWEEN_ROWS = [0.11, 0.34, 0.15, 0.50, 0.52, 0.52]
REPEATS_ABOVE_5_HZ_BETWEEN_ROWS = [0.85, 0.64, 0.87, 0.55, 0.33, 0.37]


@pytest.fixture(scope="module")
def splits(
    ur10e_data: Path, ur10e: RobotDescription, ur10e_model: Robot, id_logs: list[Log]
) -> list[tuple[ErrorSplit, ErrorSplit]]:
    """Splits of each joint on its own sine: of all errors, and of those above 5 Hz."""
    body = identify(id_logs, ur10e_model)
    parts = [part for log in id_logs for part in log.parts()]
    training = [friction_records(part, ur10e_model, body) for part in parts]
    records_by_joint = [list(joint_records) for joint_records in zip(*training, strict=True)]
    model = fit_models(["parfam_s"], records_by_joint, robot="ur10e", seed=0)["parfam_s"]
    pairs = []
    for j, law in enumerate(model.laws):
        log = Log.read(ur10e_data / f"friction_sine_joint{j + 1}.csv", ur10e)
        records = friction_records(log, ur10e_model, body)
        trajectory = RobotMotion(
            t=log.t,
            q=np.column_stack([record.q for record in records]),
            dq=np.column_stack([record.dq for record in records]),
        )
        repetitions = find_repetitions([trajectory])
        assert find_period(repetitions) == pytest.approx(10.0, abs=1e-3)
        assert {len(repetition.places) for repetition in repetitions} <= {5, 6}
        error = (records[j].tau - predict_record(law, records[j]))[:, None]
        fast_error = high_pass_errors(log.t, error)
        assert fast_error is not None
        (split,) = split_errors([log.t], [error], repetitions)
        (fast_split,) = split_errors([log.t], [fast_error], repetitions)
        pairs.append((split, fast_split))
    return pairs


def test_noise_is_that_of_the_measurement_before(
    splits: list[tuple[ErrorSplit, ErrorSplit]],
) -> None:
    noise = [1.0 - split.smooth for split, _ in splits]
    repeats = [fast_split.smooth for _, fast_split in splits]
    assert noise == pytest.approx(NOISE_BETWEEN_ROWS, abs=0.06)
    assert repeats == pytest.approx(REPEATS_ABOVE_5_HZ_BETWEEN_ROWS, abs=0.06)


def test_more_repeats_at_the_same_instant_than_between_rows(
    splits: list[tuple[ErrorSplit, ErrorSplit]],
) -> None:
    # Rows are 10 ms apart on ticks of 2 ms; what changes faster repeats at the same tick.
    for split, fast_split in splits:
        assert split.low > split.smooth
        assert fast_split.low > fast_split.smooth
        assert split.high - split.low < 0.25
