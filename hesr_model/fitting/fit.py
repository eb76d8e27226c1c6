"""Fit laws to all joints of a robot, with one process and one checkpoint per joint and law."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.errors import ArtifactError, FitError
from hesr_model.fitting.calibration import calibrate_band
from hesr_model.fitting.days import Nuisance, own_of_logs, remove_nuisances
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.uncertainty import with_pooled_errors, with_standard_errors
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import training_error
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.support import parallel
from hesr_model.support.files import provenance as source_of
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, into_file, silent, steps_told, watched

_LEAST_TORQUE = 1e-100  # [N.m]; squares of smaller ones vanish, of its inverse overflow
_COLUMNS = ("t", "dq", "q", "tau_load", "tau")
_VERSIONED = ("hesr", "numpy", "scipy", "sympy")


def key_of(
    law: str, records: Sequence[FrictionRecord], seed: int, options: Mapping[str, Any] | None
) -> str:
    """Return the hash of law, options, seed, versions and every row."""
    about = [law, dict(options or {}), seed, [version(name) for name in _VERSIONED]]
    key = hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode())
    for record in records:
        key.update(repr((record.joint, record.gear_ratio, record.sliding)).encode())
        for name in _COLUMNS:
            key.update(getattr(record, name).tobytes())
    return key.hexdigest()[:24]


def fit_joint(
    law: str,
    records: Sequence[FrictionRecord],
    *,
    seed: int,
    options: Mapping[str, Any] | None = None,
) -> FrictionLaw:
    """Fit one law to the records of one joint, with one BLAS thread for bit reproducibility.

    Raises ArtifactError if the law is unknown, FitError if the records or `options` do not suit it
    or a coefficient is not finite.
    """
    chosen = estimator(law)
    try:
        configured = chosen(**(options or {}))
    except TypeError as error:
        raise FitError(f"law '{law}' does not take these options ({error}).") from error
    for need in chosen.needs:
        if any(getattr(record, need) is None for record in records):
            raise FitError(
                f"joint '{records[0].joint}': law '{law}' needs the key '{need}'; add it to the "
                "robot file."
            )
    largest = max(float(np.max(np.abs(record.tau))) for record in records)
    if not _LEAST_TORQUE < largest < 1.0 / _LEAST_TORQUE:
        raise FitError(
            f"joint '{records[0].joint}': its friction torque reaches {largest:g}; law '{law}' "
            "cannot be fitted to it; see 'hesr inspect'."
        )
    with threadpool_limits(1):
        try:
            fitted = configured.fit(records, np.random.default_rng(seed))
        except (ArtifactError, np.linalg.LinAlgError) as error:
            said = str(error).rstrip(".")
            raise FitError(
                f"joint '{records[0].joint}': {said}; its torque does not determine the law."
            ) from error
        space = configured.space_of(fitted) if isinstance(configured, OneForm) else None
        return with_standard_errors(fitted, records, space)


def fit(
    law: str,
    *logs: Sequence[FrictionRecord],
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    robot: str = "robot",
    workers: int = 1,
) -> FrictionModel:
    """Fit one law to every joint; each of `logs` has one record per joint, of the same joints."""
    if not logs:
        raise FitError(f"law '{law}': no log given; pass the records of at least one.")
    joints = [tuple(record.joint for record in joint_records) for joint_records in logs]
    for own in joints[1:]:
        if own != joints[0]:
            raise FitError(
                f"law '{law}': logs have different joints, {', '.join(joints[0])} and "
                f"{', '.join(own)}."
            )
    return fit_models(
        [law],
        [list(of_joint) for of_joint in zip(*logs, strict=True)],
        robot=robot,
        seed=seed,
        options={law: dict(options or {})},
        provenance=source_of(files=[], seed=seed),
        workers=workers,
    )[law]


def fit_models(
    laws: Sequence[str],
    records: Sequence[Sequence[FrictionRecord]],
    *,
    robot: str,
    seed: int,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    variants: Mapping[str, str] | None = None,
    provenance: Mapping[str, Any] | None = None,
    workers: int | None = None,
    progress: Progress = silent,
    left_out: Callable[[str, FitError], None] | None = None,
    kept: Path | None = None,
    per_log: Sequence[Nuisance] = (),
) -> dict[str, FrictionModel]:
    """Fit several laws to every joint; return models by name of the law or variant.

    `records` are those of each joint, one per training log; `variants` maps names to laws of the
    registry. Without `left_out` the first law that the records do not determine raises its error.
    `kept` is a folder of checkpoints for killed runs. Nuisances `per_log` are removed first
    (`days`).
    """
    coupling = records[0][0].coupling
    records = all_at_friction(records)
    if per_log:
        own = [own_of_logs(joint_records, per_log) for joint_records in records]
        known = {
            r[0].joint: {log: asdict(n) for log, n in o.items()}
            for r, o in zip(records, own, strict=True)
        }
        records = [remove_nuisances(r, o) for r, o in zip(records, own, strict=True)]
        provenance = {**(provenance or {}), "per_log": known}
    with scratch_folder() as folder:
        jobs = {
            law: [
                partial(
                    _fitted,
                    (variants or {}).get(law, law),
                    joint_records,
                    kept=kept,
                    progress=Path(folder, f"{law}.{joint}"),
                    seed=seed,
                    options=(options or {}).get(law),
                )
                for joint, joint_records in enumerate(records)
            ]
            for law in laws
        }
        plain = _run(jobs, [r[0].joint for r in records], workers, progress, left_out)
    pooled = {law: with_pooled_errors(of_joints) for law, of_joints in plain.items()}
    banded = [
        partial(calibrate_band, law, joint_records)
        for of_joints in pooled.values()
        for law, joint_records in zip(of_joints, records, strict=True)
    ]
    names = [f"{r[0].joint}, {law}" for law in pooled for r in records]
    with parallel.results_of(banded, workers, names=names) as results:
        fitted = {law: tuple(next(results) for _ in records) for law in pooled}
    periods = [float(np.median(np.diff(r.t))) for joint_records in records for r in joint_records]
    left = {law: [e for _, e in of_law if e is not None] for law, of_law in fitted.items()}
    return {
        law: FrictionModel(
            law=law,
            robot=robot,
            joints=tuple(joint_records[0].joint for joint_records in records),
            laws=tuple(own for own, _ in fitted[law]),
            sliding=tuple(joint_records[0].sliding for joint_records in records),
            coupling=coupling,
            sample_time=round(float(np.median(periods)), 9),
            trained=tuple(TrainedRange.of(joint_records) for joint_records in records),
            training_rmse=tuple(map(training_error, plain[law], records)),
            left_out_rmse=tuple(left[law]) if len(left[law]) == len(records) else (),
            provenance=dict(provenance or {}),
        )
        for law in fitted
    }


def _run(
    jobs: Mapping[str, Sequence["partial[FrictionLaw | FitError]"]],
    joints: Sequence[str],
    workers: int | None,
    progress: Progress,
    left_out: Callable[[str, FitError], None] | None,
) -> dict[str, list[FrictionLaw]]:
    every = [job for of_law in jobs.values() for job in of_law]
    done: dict[str, list[FrictionLaw]] = {law: [] for law in jobs}
    failed: dict[str, FitError] = {}
    files = [job.keywords["progress"] for job in every]
    names = [f"{joint}, {law}" for law in jobs for joint in joints]
    with watched(files, progress), parallel.results_of(every, workers, names=names) as results:
        for law, of_law in jobs.items():
            for result in islice(results, len(of_law)):
                if isinstance(result, FrictionLaw):
                    done[law].append(result)
                elif left_out is None:
                    raise result
                else:
                    failed.setdefault(law, result)
    for law, reason in failed.items():
        if left_out is None or len(failed) == len(jobs):
            raise reason
        left_out(law, reason)
    return {law: of_joints for law, of_joints in done.items() if law not in failed}


def _fitted(
    law: str,
    records: Sequence[FrictionRecord],
    *,
    kept: Path | None,
    progress: Path,
    seed: int,
    options: Mapping[str, Any] | None,
) -> FrictionLaw | FitError:
    name = f"{law}.{records[0].joint}.{key_of(law, records, seed, options)}.json"
    path = kept / "".join(c if c.isalnum() or c in "._-" else "_" for c in name) if kept else None
    report = into_file(progress)
    fitted = None
    if path and path.is_file():
        with suppress(ArtifactError):  # incomplete
            fitted = FrictionModel.read(path).laws[0]
    if fitted is None:
        try:
            with steps_told(report):
                fitted = fit_joint(law, records, seed=seed, options=options)
        except FitError as error:
            return error
        if path:
            period = float(np.median(np.concatenate([np.diff(record.t) for record in records])))
            FrictionModel(
                law=fitted.name,
                robot="robot",
                joints=(records[0].joint,),
                laws=(fitted,),
                sliding=(records[0].sliding,),
                sample_time=round(period, 9),
            ).write(path)
    report(1, 1)
    return fitted
