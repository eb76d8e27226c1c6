"""Fit laws to all joints of a robot, with one process per joint and law."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.errors import FitError
from hesr_model.fitting.calibration import with_band
from hesr_model.fitting.checkpoint import key_of, read_checkpoint, write_checkpoint
from hesr_model.fitting.day_offsets import Nuisance, OwnOfLog, own_of_logs, without_own
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.uncertainty import with_pooled_errors, with_standard_errors
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import training_error
from hesr_model.friction.registry import estimator
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.support import parallel
from hesr_model.support.progress import Progress, into_file, silent, steps_told, watched
from hesr_model.support.provenance import provenance as source_of
from hesr_model.support.typed_json import to_json


def fit_joint(
    law: str,
    records: Sequence[FrictionRecord],
    *,
    seed: int,
    options: Mapping[str, Any] | None = None,
) -> FrictionLaw:
    """Fit one law to the records of one joint, with one BLAS thread for bit reproducibility.

    `options` are arguments of the estimator. Raises ArtifactError if the law is unknown, and
    FitError if the records do not determine the law or lack a field that it needs.
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
    with threadpool_limits(1):
        fitted = configured.fit(records, np.random.default_rng(seed))
        space = configured.space() if isinstance(configured, OneForm) else None
        return with_standard_errors(fitted, records, space)


def fit(
    law: str,
    *logs: Sequence[FrictionRecord],
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    robot: str = "robot",
    workers: int = 1,
) -> FrictionModel:
    """Fit one law to every joint of a robot; each of `logs` has one record per joint.

    Raises ArtifactError if the law is unknown, and FitError if `logs` is empty, its joints differ,
    or the records do not determine the law or lack a field that it needs.
    """
    if not logs:
        raise FitError(f"law '{law}': no log is given; pass the records of at least one.")
    joints = [tuple(record.joint for record in log) for log in logs]
    for own in joints[1:]:
        if own != joints[0]:
            raise FitError(
                f"law '{law}': one log has the joints {', '.join(joints[0])}, another one has "
                f"{', '.join(own)}; all must have the same."
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
    """Return models by name of the law or variant, independent of `workers`.

    Parameters
    ----------
    laws : names in the registry, or names of variants.
    records : records of each joint, one per training log.
    options : hyper-parameters by law or variant.
    variants : name in the registry of each variant, a law with other options.
    workers : number of processes; one per core by default, no extra process for 1.
    progress : callback with `progress.PARTS` for each fit.
    left_out : callback for each law that the records do not determine, with the reason; other laws
        are still fitted. By default the first such law raises FitError.
    kept : folder of checkpoints, so that a killed run can continue.
    per_log : nuisances of each log that are removed first (`hesr_model.fitting.day_offsets`); they
        are part of the provenance, and training errors are without them.
    """
    registered = {law: (variants or {}).get(law, law) for law in laws}
    coupling = records[0][0].coupling
    records = all_at_friction(records)
    own = {of_joint[0].joint: own_of_logs(of_joint, per_log) for of_joint in records}
    if per_log:
        records = [without_own(of_joint, own[of_joint[0].joint]) for of_joint in records]
        provenance = {**(provenance or {}), "per_log": to_json(_Own(joints=own))["joints"]}
    done: dict[tuple[str, int], FrictionLaw] = {}
    failed: dict[str, FitError] = {}
    with TemporaryDirectory(prefix="hesr-") as folder:
        jobs = {
            (law, joint): partial(
                _fitted,
                registered[law],
                of_joint,
                kept=kept,
                progress=Path(folder, f"{law}.{joint}"),
                seed=seed,
                options=(options or {}).get(law),
            )
            for law in laws
            for joint, of_joint in enumerate(records)
        }
        files = [Path(folder, f"{law}.{joint}") for law, joint in jobs]
        with (
            watched(files, progress),
            parallel.results_of(list(jobs.values()), workers) as results,
        ):
            for law, joint in jobs:
                result = next(results)
                if isinstance(result, FrictionLaw):
                    done[law, joint] = result
                else:
                    failed.setdefault(law, result)
                    if left_out is None:
                        raise result
    for law, reason in failed.items():
        if left_out is None or len(failed) == len(laws):
            raise reason
        left_out(law, reason)
    fitted = {
        law: with_pooled_errors([done[law, joint] for joint in range(len(records))])
        for law in laws
        if law not in failed
    }
    banded = [
        partial(with_band, own, r)
        for of in fitted.values()
        for own, r in zip(of, records, strict=True)
    ]
    with parallel.results_of(banded, workers) as results:
        fitted = {law: [next(results) for _ in records] for law in fitted}
    joints = tuple(of_joint[0].joint for of_joint in records)
    periods = [float(np.median(np.diff(r.t))) for of_joint in records for r in of_joint]
    return {
        law: FrictionModel(
            law=law,
            robot=robot,
            joints=joints,
            laws=tuple(fitted[law]),
            sliding=tuple(of_joint[0].sliding for of_joint in records),
            coupling=coupling,
            sample_time=round(float(np.median(periods)), 9),
            trained=tuple(TrainedRange.of(of_joint) for of_joint in records),
            training_rmse=tuple(
                training_error(done[law, joint], of_joint) for joint, of_joint in enumerate(records)
            ),
            provenance=dict(provenance or {}),
        )
        for law in fitted
    }


@dataclass(frozen=True, kw_only=True)
class _Own:
    joints: Mapping[str, Mapping[str, OwnOfLog]]


def _fitted(
    law: str,
    records: Sequence[FrictionRecord],
    *,
    kept: Path | None,
    progress: Path,
    seed: int,
    options: Mapping[str, Any] | None,
) -> FrictionLaw | FitError:
    """Fit one law to one joint, or return the error so that other fits continue."""
    name = f"{law}.{records[0].joint}.{key_of(law, records, seed, options)}.json"
    path = kept / "".join(c if c.isalnum() or c in "._-" else "_" for c in name) if kept else None
    report = into_file(progress)
    fitted = read_checkpoint(path) if path else None
    if fitted is None:
        try:
            with steps_told(report):
                fitted = fit_joint(law, records, seed=seed, options=options)
        except FitError as error:
            return error
        if path:
            period = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
            write_checkpoint(path, fitted, records[0], round(period, 9))
    report(1, 1)
    return fitted
