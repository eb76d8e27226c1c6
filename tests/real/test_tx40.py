"""A measured log of motors, one motor moving two joints."""

from pathlib import Path

import numpy as np
import pytest

from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.predictions import predict_fmu
from hesr_model.fitting.fit import fit
from hesr_model.logs.rest import MOVING
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import moving
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription

LOG = Path(__file__).parents[2].parent / "shared" / "data" / "tx40" / "tx40_first.csv"
TRAINED = 0.6
RELAXED = {"relaxed": True}
"""Options of LuGre: static friction below Coulomb friction allowed, as in lubricated gears."""

Records = list[FrictionRecord]


@pytest.fixture(scope="module")
def coupled() -> RobotDescription:
    return RobotDescription.read(Path(__file__).with_name("tx40.toml"))


@pytest.fixture(scope="module")
def log(coupled: RobotDescription) -> Log:
    if not LOG.is_file():
        pytest.skip(f"the measured TX40 log is not next to the repository, at {LOG}")
    return Log.read(LOG, coupled)


def trained(
    log: Log, robot: RobotDescription, *, last: bool = False, physical: bool = False
) -> tuple[Records, Records]:
    """Records of the first 60 % and of the rest, or of the last part and the earlier one, and a
    body."""
    model = Robot(robot)
    rows = round((1.0 - TRAINED if last else TRAINED) * len(log.t))
    parts = log.rows(slice(rows)), log.rows(slice(rows, None))
    train, test = parts[::-1] if last else parts
    body = identify([train], model, physical=physical)
    return friction_records(train, model, body), friction_records(test, model, body)


def errors(predicted: np.ndarray, records: Records) -> np.ndarray:
    measured = np.column_stack([record.tau for record in records])
    return np.asarray(np.sqrt(np.mean((predicted - measured) ** 2, axis=0)))


def test_one_friction_of_motor_6_describes_both_of_its_joints(
    coupled: RobotDescription, log: Log, tmp_path: Path
) -> None:
    first, rest = trained(log, coupled)
    model = fit("lugre", first, robot=coupled.name, options=RELAXED)
    fmu = export_bare(model, tmp_path / "lugre.fmu")
    found = errors(
        np.column_stack([of_joint[0] for of_joint in predict_fmu(fmu, [[r] for r in rest])]), rest
    )
    # The same joint torques without information about motors.
    alone = coupled.model_copy(update={"transmission": None})
    first, rest = trained(log, alone)
    uncoupled = errors(fit("lugre", first, robot=coupled.name, options=RELAXED).predict(rest), rest)
    assert found[4] <= 1.8
    assert found[4] <= 0.5 * uncoupled[4]
    assert found[5] <= 1.0
    assert np.all(found[:4] <= 1.1 * uncoupled[:4])


@pytest.mark.parametrize("last", [False, True])
def test_a_physical_body_predicts_either_end_of_the_motion(
    last: bool, coupled: RobotDescription, log: Log
) -> None:
    """Three seconds determine the plain body badly: J5 would be 2.1 N.m off at the start."""
    found = {}
    for robot in (coupled, coupled.model_copy(update={"transmission": None})):
        train, test = trained(log, robot, last=last, physical=True)
        found[robot.transmission is None] = errors(
            fit("lugre", train, robot=robot.name, options=RELAXED).predict(test), test
        )
    assert found[False][4] <= 1.8
    assert found[False][4] <= 0.55 * found[True][4]
    assert found[False][5] <= 0.8
    assert np.all(found[False][:4] <= 1.1 * found[True][:4])


@pytest.mark.parametrize("law", ["lugre", "parfam_s"])
def test_bands_cover_left_out_blocks_at_the_joints(
    law: str, coupled: RobotDescription, log: Log
) -> None:
    """Of the rows in motion, on each joint; each block of several splits is left out in turn.

    The share of one split into quarters of these 3 s has a standard error of about 0.02, found from
    the scatter of its blocks: only the mean of splits tells a band of another width.
    """
    records, _ = trained(log, coupled, physical=True)
    splits = [share_inside(law, coupled, records, blocks) for blocks in (4, 6, 8)]
    shares = np.mean(splits, axis=0)
    assert np.all((shares >= 0.92) & (shares <= 0.98)), splits
    assert 0.94 <= np.mean(shares) <= 0.97, splits


def share_inside(law: str, robot: RobotDescription, records: Records, blocks: int) -> np.ndarray:
    """Return shares (joints,) of rows in motion within the bands of fits without their block."""
    labels = np.arange(len(records[0].t)) * blocks // len(records[0].t)
    inside: list[list[np.ndarray]] = [[] for _ in records]
    for k in range(blocks):
        first, *_, last = np.flatnonzero(labels == k)
        parts = [part for part in (slice(first), slice(last + 1, None)) if len(labels[part])]
        model = fit(law, *([r.rows(part) for r in records] for part in parts), robot=robot.name)
        for held, record, low, high in zip(
            inside, records, *(end.T for end in model.predict_band(records)), strict=True
        ):
            rows = (labels == k) & moving(record.dq, MOVING)
            held.append(((record.tau >= low) & (record.tau <= high))[rows])
    return np.array([np.concatenate(held).mean() for held in inside])
