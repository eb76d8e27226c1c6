"""Fit laws to all joints of a robot, each joint and law in a process of its own."""

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
from hesr_model.fitting.checkpoint import keep, key_of, read_kept
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
    """Fit one law to the records of one joint, with one BLAS thread: bit-reproducible.

    Parameters
    ----------
    law : name in the registry.
    records : records of one joint.
    seed : of the generator; joints with equal data and seed get equal laws.
    options : hyper-parameters of the estimator's constructor.

    Raises
    ------
    ArtifactError
        If the law is unknown.
    FitError
        If the records do not determine the law, or lack what it needs.
    """
    chosen = estimator(law)
    try:
        configured = chosen(**(options or {}))
    except TypeError as error:
        raise FitError(f"law '{law}' does not take these options ({error}).") from error
    for need in chosen.needs:
        if any(getattr(record, need) is None for record in records):
            raise FitError(
                f"joint '{records[0].joint}': law '{law}' needs the key '{need}', which the robot "
                "file does not give."
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
    """Fit one law to every joint of a robot.

    Parameters
    ----------
    law : name in the registry, as `hesr laws` lists them.
    logs : the records of one log each, as `residual.friction_records` returns them.
    seed : of the fit: same logs, same seed, same model.
    options : hyper-parameters of the law's estimator.
    robot : name that the model carries.
    workers : processes. With more than one, joints are fitted in fresh processes, which do not
        import the calling script.

    Raises
    ------
    ArtifactError
        If the law is unknown.
    FitError
        If no log is given, or the logs are of different joints; if the records do not determine the
        law, or lack what it needs.
    """
    if not logs:
        raise FitError(f"law '{law}': there is no log to fit it to; give the records of one.")
    joints = [tuple(record.joint for record in log) for log in logs]
    for own in joints[1:]:
        if own != joints[0]:
            raise FitError(
                f"law '{law}': one log is of the joints {', '.join(joints[0])}, another one of "
                f"{', '.join(own)}; all must be of the same."
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
    """Fit several laws to every joint.

    Parameters
    ----------
    laws : names in the registry, or names of variants.
    records : for each joint its records, one for each training log.
    robot : name of the robot.
    seed : of every fit.
    options : hyper-parameters by law or variant.
    variants : name in the registry of each variant, a law with other options.
    provenance : JSON data that the models carry.
    workers : processes; one for each core where not given, none of its own for 1.
    progress : told how far the fits are, `progress.PARTS` for each, by starts and candidates.
    left_out : told of each law that the records do not determine, and why; the others are fitted
        nevertheless. Where not given, the first such law ends it all.
    kept : folder into which each joint's law is written when it is fitted, and from which it is
        read where it stands there already, so that a run that was killed goes on.
    per_log : what may differ by log and is taken out of the records first
        (`hesr_model.fitting.day_offsets`); it stands in the models' provenance, and their
        training errors are without it.

    Returns
    -------
    Model by name of the law or variant. The result does not depend on `workers`.

    Raises
    ------
    ArtifactError
        If a law is unknown.
    FitError
        If the records do not determine a law, or none of them where `left_out` is given.
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
    with TemporaryDirectory(prefix="hesr-") as told:
        jobs = {
            (law, joint): partial(
                _fitted,
                registered[law],
                of_joint,
                kept=kept,
                told=Path(told, f"{law}.{joint}"),
                seed=seed,
                options=(options or {}).get(law),
            )
            for law in laws
            for joint, of_joint in enumerate(records)
        }
        files = [Path(told, f"{law}.{joint}") for law, joint in jobs]
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
    told: Path,
    seed: int,
    options: Mapping[str, Any] | None,
) -> FrictionLaw | FitError:
    """Fit one law to one joint, or return why that cannot be: the other fits go on."""
    name = f"{law}.{records[0].joint}.{key_of(law, records, seed, options)}.json"
    path = kept / "".join(c if c.isalnum() or c in "._-" else "_" for c in name) if kept else None
    tell = into_file(told)
    fitted = read_kept(path) if path else None
    if fitted is None:
        try:
            with steps_told(tell):
                fitted = fit_joint(law, records, seed=seed, options=options)
        except FitError as error:
            return error
        if path:
            period = float(np.median(np.concatenate([np.diff(r.t) for r in records])))
            keep(path, fitted, records[0], round(period, 9))
    tell(1, 1)
    return fitted
