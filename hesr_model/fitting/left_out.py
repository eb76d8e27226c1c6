"""Fit of laws without each fold, and their errors on the rows that the fold left out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import FitError, SimulationError
from hesr_model.fitting.days import (
    Nuisance,
    add_fitted_nuisances,
    estimate_nuisances,
    remove_nuisances,
)
from hesr_model.fitting.fit import load_or_fit
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.inference.choice import PLAIN
from hesr_model.inference.folds import Fold, thin
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.signals import Motion, reversals
from hesr_model.logs.strokes import find_single_speeds
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import (
    find_resting_speed,
    motion_records,
    transform_all_records,
    transform_records,
)
from hesr_model.robots.robot import Robot
from hesr_model.support import parallel
from hesr_model.support.arrays import Array, Integers, Mask
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, report_progress, silent

JointRecords = list[FrictionRecord]  # of one joint, by piece of a log


@dataclass(frozen=True, kw_only=True, eq=False)
class _FoldData:
    """What a fold trains laws on, and what it judges them on."""

    training: list[JointRecords]  # by joint, at friction coordinates
    can_judge: list[bool]  # by joint, whether its training reverses, at more than one speed
    judged_logs: list[int]
    judged_records: list[list[FrictionRecord]]  # by judged log and joint, whole logs
    judged_rows: list[Mask]  # by judged log


def judge_laws(
    laws: Sequence[str],
    motions: Sequence[Motion],
    robot: Robot,
    folds: Sequence[Fold],
    bodies: Sequence[RigidBody],
    *,
    seed: int = 0,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    variants: Mapping[str, str] | None = None,
    per_log: Sequence[Nuisance] = (),
    checkpoints: Path | None = None,
    workers: int | None = None,
    progress: Progress = silent,
) -> LeftOutErrors:
    """Fit laws without each fold and judge them on its rows.

    Laws are predicted over whole logs, so that their states are those of the motion before the
    judged rows, with the causal velocity that users of an FMU have.

    Parameters
    ----------
    laws : laws or variants.
    motions : smoothed logs of the folds.
    folds, bodies : folds, each with the rigid body of its training part.
    per_log : quantities that differ by log; those of judged rows are fitted to them.
    options, variants, seed, checkpoints, workers : see `fit.fit_models`.
    """
    fold_data = []
    for fold, body in zip(folds, bodies, strict=True):
        fold_data.append(_collect_fold(motions, robot, fold, body))
    jobs = []
    labels = []
    with scratch_folder() as folder:
        for law_name in laws:
            for number, data in enumerate(fold_data):
                job = partial(
                    _judge_law,
                    law_name,
                    (variants or {}).get(law_name, law_name),
                    data,
                    seed=seed,
                    options=(options or {}).get(law_name),
                    per_log=tuple(per_log),
                    checkpoints=checkpoints,
                    progress=folder / f"{law_name}.{number}",
                )
                jobs.append(job)
                labels.append(f"{law_name}, fold {number + 1}")
        with parallel.results_of(jobs, workers, names=labels) as results:
            judged = {label: next(results) for label in report_progress(labels, progress)}
    return _assemble(laws, motions, robot, folds, fold_data, judged)


def _collect_fold(
    motions: Sequence[Motion], robot: Robot, fold: Fold, body: RigidBody
) -> _FoldData:
    body = replace(body, covariance=None)  # errors of the load are not needed
    records = [motion_records(thin(piece), robot, body) for piece in fold.training]
    judged_logs = [k for k, rows in enumerate(fold.judged) if rows.any()]
    training = [list(joint_records) for joint_records in zip(*records, strict=True)]
    if training:
        training = transform_all_records(training)
    can_judge = [_can_judge(joint_records) for joint_records in training]
    return _FoldData(
        training=training,
        can_judge=can_judge or [False] * robot.n,
        judged_logs=judged_logs,
        judged_records=[motion_records(motions[k], robot, body) for k in judged_logs],
        judged_rows=[fold.judged[k] for k in judged_logs],
    )


def _can_judge(joint_records: JointRecords) -> bool:
    """Return whether motion can tell laws apart: one way, or at one speed, it cannot.

    At one speed laws differ in rows of reversals alone, and then anywhere else at will.
    """
    resting_speed = find_resting_speed(joint_records)
    if not any(len(reversals(record.dq, resting_speed)) > 0 for record in joint_records):
        return False
    times = [record.t for record in joint_records]
    return not find_single_speeds(times, [record.dq for record in joint_records], resting_speed)


def _judge_law(
    law_name: str,
    estimator_name: str,
    data: _FoldData,
    *,
    seed: int,
    options: Mapping[str, Any] | None,
    per_log: tuple[Nuisance, ...],
    checkpoints: Path | None,
    progress: Path,
) -> list[Array] | FitError:
    """Return the errors (N, n) [N.m] on the judged rows of each judged log, or why not."""
    if not data.training:
        return FitError(f"law '{law_name}': a fold leaves nothing to train on.")
    laws = []
    for joint_records, can_judge in zip(data.training, data.can_judge, strict=True):
        records = joint_records
        if per_log:
            records = remove_nuisances(records, estimate_nuisances(records, per_log))
        # A joint that tells no laws apart is not judged, but must not hide the others.
        joint_law_name = estimator_name if can_judge else PLAIN
        law = load_or_fit(
            joint_law_name,
            records,
            checkpoints=checkpoints,
            progress=progress,
            seed=seed,
            options=options if can_judge else None,
        )
        if isinstance(law, FitError):
            return law
        laws.append(law)
    model = _build_fold_model(law_name, laws, data)
    errors = []
    try:
        for log_records, rows in zip(data.judged_records, data.judged_rows, strict=True):
            errors.append(_predict_errors(model, log_records, rows, per_log))
    except SimulationError as error:
        return FitError(f"law '{law_name}': without a fold {error}")
    return errors


def _build_fold_model(law_name: str, laws: Sequence[FrictionLaw], data: _FoldData) -> FrictionModel:
    """Return the model of the laws [joint] that were fitted to the training part of a fold."""
    first_records = [joint_records[0] for joint_records in data.training]
    coupling = None
    if data.judged_records:
        coupling = data.judged_records[0][0].coupling
    return FrictionModel(
        law=law_name,
        robot="robot",
        joints=tuple(record.joint for record in first_records),
        laws=tuple(laws),
        sliding=tuple(record.sliding for record in first_records),
        coupling=coupling,
        sample_time=float(np.median(np.diff(first_records[0].t))),
    )


def _predict_errors(
    model: FrictionModel,
    log_records: Sequence[FrictionRecord],
    rows: Mask,
    per_log: tuple[Nuisance, ...],
) -> Array:
    """Return predicted less measured friction at joints, (N, n) [N.m], on some rows of a log."""
    with np.errstate(all="ignore"):  # a law may diverge; its errors are then not finite
        torque = model.predict([record.causal for record in log_records])[rows]
    columns = []
    for tau, record in zip(torque.T, log_records, strict=True):
        judged_record = record.rows(rows)
        if per_log:
            (tau,) = add_fitted_nuisances([tau], [judged_record], per_log)
        columns.append(tau - judged_record.tau)
    return np.column_stack(columns)


def _assemble(
    laws: Sequence[str],
    motions: Sequence[Motion],
    robot: Robot,
    folds: Sequence[Fold],
    fold_data: Sequence[_FoldData],
    judged: Mapping[str, list[Array] | FitError],
) -> LeftOutErrors:
    coupling = robot.description.coupling
    joint_errors: dict[str, tuple[Array, ...]] = {}
    errors: dict[str, tuple[Array, ...]] = {}  # at friction coordinates
    failed: dict[str, str] = {}
    for law_name in laws:
        results = [judged[f"{law_name}, fold {number + 1}"] for number in range(len(folds))]
        law_errors = _collect_errors(results, fold_data, motions, robot.n)
        if isinstance(law_errors, FitError):
            failed[law_name] = str(law_errors)
            continue
        joint_errors[law_name] = law_errors
        errors[law_name] = law_errors
        if coupling:
            errors[law_name] = tuple(map(coupling.torque, law_errors))
    return LeftOutErrors(
        joints=robot.description.joints,
        t=tuple(motion.t for motion in motions),
        log_names=tuple(motion.name for motion in motions),
        fold_of_row=tuple(_number_folds(folds, k) for k in range(len(motions))),
        errors=errors,
        joint_errors=joint_errors,
        tau=_collect_signal("tau", fold_data, motions, robot.n),
        dq=_collect_signal("dq", fold_data, motions, robot.n),
        tau_load=_collect_signal("tau_load", fold_data, motions, robot.n),
        counts=np.array([data.can_judge for data in fold_data]),
        failed=failed,
    )


def _collect_errors(
    results: Sequence[list[Array] | FitError],
    fold_data: Sequence[_FoldData],
    motions: Sequence[Motion],
    n: int,
) -> tuple[Array, ...] | FitError:
    """Return the errors (N, n) [N.m] of a law by log, NaN where not judged, or its first failure.

    `results` are those of each fold, by judged log.
    """
    errors = tuple(np.full((len(motion.t), n), np.nan) for motion in motions)
    for data, result in zip(fold_data, results, strict=True):
        if isinstance(result, FitError):
            return result
        for k, rows, values in zip(data.judged_logs, data.judged_rows, result, strict=True):
            errors[k][rows] = values
    return errors


def _number_folds(folds: Sequence[Fold], log: int) -> Integers:
    numbers = np.zeros(len(folds[0].judged[log]), dtype=int)
    for number, fold in enumerate(folds):
        numbers[fold.judged[log]] = number
    return numbers


def _collect_signal(
    name: str, fold_data: Sequence[_FoldData], motions: Sequence[Motion], n: int
) -> tuple[Array, ...]:
    """Return a signal of records by log, (N, n), at friction coordinates, by each fold's body."""
    values = tuple(np.full((len(motion.t), n), np.nan) for motion in motions)
    for data in fold_data:
        for k, log_records, judged in _judged_records(data):
            columns = [getattr(record, name) for record in transform_records(log_records)]
            values[k][judged] = np.column_stack(columns)[judged]
    return values


def _judged_records(data: _FoldData) -> Iterator[tuple[int, list[FrictionRecord], Mask]]:
    yield from zip(data.judged_logs, data.judged_records, data.judged_rows, strict=True)
