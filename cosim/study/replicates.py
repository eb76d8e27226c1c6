"""Replicates in the logs of a study: the part of each law's squared error that repeats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np

from cosim.study.scores import LogRecords, Predictions, select_records
from cosim.study.study import Study
from fmu_src.friction.predictions import Records, predict_model
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.replicates import (
    ErrorSplit,
    Repetition,
    RobotMotion,
    count_rows,
    find_period,
    find_repetitions,
    high_pass_errors,
    split_errors,
)
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json

REPLICATES = "replicates.json"
TRAINING = "training logs"  # name of the training logs among the test sets

_MAX_ERROR = 1e100  # [N.m] of a law that diverged; its square would overflow

Torques = Mapping[str, Sequence[Sequence[Array]]]  # (N,) [N.m] by law, [joint][log]


@dataclass(frozen=True, kw_only=True)
class Replicates:
    """Parts of the squared errors of laws on motions that repeat.

    Attributes
    ----------
    joints : names of the joints.
    count : number of replicates of a motion, median over its windows.
    rows, all_rows : repeated rows, and all rows of the logs.
    period : median time [s] between replicates in a log; None if they are in different logs.
    laws : splits by law, one per joint.
    fast : the same for errors above 5 Hz; empty if the rows are too slow for them.
    """

    joints: tuple[str, ...]
    count: float
    rows: int
    all_rows: int
    period: float | None
    laws: Mapping[str, tuple[ErrorSplit, ...]]
    fast: Mapping[str, tuple[ErrorSplit, ...]]


def write_replicates(
    folder: Path,
    study: Study,
    records: LogRecords,
    models: Mapping[str, FrictionModel],
    predictions: Predictions,
) -> dict[str, Replicates | None]:
    """Split the errors on each test set and on the training logs; write and return the splits.

    None marks logs without replicates, of whose errors nothing may be called noise.
    """
    replicates: dict[str, Replicates | None] = {}
    for test, names in study.logs.test.items():
        replicates[test] = split_by_replicates(select_records(names, records), predictions[test])
    if TRAINING not in replicates:
        training_records = select_records(study.logs.training, records)
        repetitions = find_repetitions(_collect_trajectories(training_records))
        torques = {}
        if repetitions:  # predictions take time
            for law_name, model in models.items():
                torques[law_name] = predict_model(model, training_records)
        replicates[TRAINING] = _split(training_records, torques, repetitions)
    saved_replicates = {}
    for name, test_replicates in replicates.items():
        saved_replicates[name] = to_json(test_replicates) if test_replicates else None
    write_json(folder / REPLICATES, saved_replicates)
    return replicates


def read_replicates(folder: Path) -> dict[str, Replicates | None]:
    """Read the splits of a run; results of earlier versions have none."""
    path = folder / REPLICATES
    if not path.is_file():
        return {}
    replicates: dict[str, Replicates | None] = {}
    for name, saved in read_json(path).items():
        replicates[name] = None
        if saved is not None:
            description = f"the replicates in {name!r}"
            replicates[name] = from_json(Replicates, saved, path, description)
    return replicates


def split_by_replicates(records: Records, torques: Torques) -> Replicates | None:
    """Split the errors of predicted torques on logs; None if no motion repeats."""
    return _split(records, torques, find_repetitions(_collect_trajectories(records)))


def _collect_trajectories(records: Records) -> list[RobotMotion]:
    """Return the motion of all joints, by log."""
    return [_stack_joints(log_records) for log_records in zip(*records, strict=True)]


def _stack_joints(log_records: Sequence[FrictionRecord]) -> RobotMotion:
    return RobotMotion(
        t=log_records[0].t,
        q=np.column_stack([record.q for record in log_records]),
        dq=np.column_stack([record.dq for record in log_records]),
    )


def _split(
    records: Records, torques: Torques, repetitions: Sequence[Repetition]
) -> Replicates | None:
    """Split the errors of the laws that did not diverge; None without such laws or repetitions."""
    law_names = [law_name for law_name in torques if _is_bounded(records, torques[law_name])]
    if not repetitions or not law_names:
        return None
    times = [record.t for record in records[0]]
    splits_by_joint = []
    fast_splits_by_joint = []
    for j, joint_records in enumerate(records):
        joint_torques = [torques[law_name][j] for law_name in law_names]
        errors = _stack_errors(joint_records, joint_torques)
        splits_by_joint.append(split_errors(times, errors, repetitions))
        fast_errors = [high_pass_errors(*pair) for pair in zip(times, errors, strict=True)]
        known_errors = [error for error in fast_errors if error is not None]
        if len(known_errors) == len(errors):
            fast_splits_by_joint.append(split_errors(times, known_errors, repetitions))
    if not all(splits_by_joint):  # too few windows repeat
        return None
    return Replicates(
        joints=tuple(joint_records[0].joint for joint_records in records),
        count=median(len(repetition.places) for repetition in repetitions),
        rows=count_rows(times, repetitions),
        all_rows=sum(len(t) for t in times),
        period=find_period(repetitions),
        laws=_group_by_law(law_names, splits_by_joint),
        fast=_group_by_law(law_names, fast_splits_by_joint),
    )


def _stack_errors(
    joint_records: Sequence[FrictionRecord], torques: Sequence[Sequence[Array]]
) -> list[Array]:
    """Return the errors (N, laws) of torques [law][log] of a joint, by log."""
    errors = []
    for k, record in enumerate(joint_records):
        columns = [record.tau - law_torques[k] for law_torques in torques]
        errors.append(np.column_stack(columns))
    return errors


def _is_bounded(records: Records, torques: Sequence[Sequence[Array]]) -> bool:
    """Return whether the torques of a law did not diverge on any log."""
    for joint_records, joint_torques in zip(records, torques, strict=True):
        for record, tau in zip(joint_records, joint_torques, strict=True):
            # Not "any above": a comparison with NaN is false.
            if not np.all(np.abs(record.tau - tau) < _MAX_ERROR):
                return False
    return True


def _group_by_law(
    law_names: Sequence[str], splits_by_joint: Sequence[Sequence[ErrorSplit]]
) -> dict[str, tuple[ErrorSplit, ...]]:
    """Return splits [joint][law] by law, one per joint; empty without joints."""
    if not splits_by_joint:
        return {}
    return dict(zip(law_names, zip(*splits_by_joint, strict=True), strict=True))
