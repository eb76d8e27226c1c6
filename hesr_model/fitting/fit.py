"""Fit laws to all joints of a robot, with one process and one checkpoint per joint and law."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits

from hesr_model.errors import ArtifactError, ConfigError, FitError, LogError, SimulationError
from hesr_model.fitting.calibration import calibrate_band
from hesr_model.fitting.days import Nuisance, estimate_nuisances, remove_nuisances
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import Estimator, estimator, is_of_session, to_law_name
from hesr_model.fitting.motion_scale import fit_in_own_units
from hesr_model.fitting.reach import require_bounded_torque
from hesr_model.fitting.uncertainty import add_standard_errors, pool_errors
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import training_error
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import transform_all_records
from hesr_model.support import parallel
from hesr_model.support.files import provenance as source_of
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, make_file_progress, silent, steps_told, watched

_T = TypeVar("_T")
_MIN_TORQUE = 1e-100  # [N.m]; squares of smaller ones vanish, of its inverse overflow
_COLUMNS = ("t", "dq", "q", "tau_load", "tau")
_VERSIONED_PACKAGES = ("hesr", "numpy", "scipy", "sympy")


def compute_key(
    law_name: str,
    joint_records: Sequence[FrictionRecord],
    seed: int,
    options: Mapping[str, Any] | None,
) -> str:
    """Return the hash of law, options, seed, versions and every row."""
    fingerprint = [
        law_name,
        dict(options or {}),
        seed,
        [version(name) for name in _VERSIONED_PACKAGES],
    ]
    key = hashlib.sha256(json.dumps(fingerprint, sort_keys=True, default=str).encode())
    for record in joint_records:
        key.update(repr((record.joint, record.gear_ratio, record.sliding)).encode())
        for name in _COLUMNS:
            key.update(getattr(record, name).tobytes())
    return key.hexdigest()[:24]


def fit_joint(
    law_name: str,
    joint_records: Sequence[FrictionRecord],
    *,
    seed: int,
    options: Mapping[str, Any] | None = None,
) -> FrictionLaw:
    """Fit one law to the records of one joint, with one BLAS thread for bit reproducibility.

    Raises ArtifactError if the law is unknown, FitError if the records or `options` do not suit it
    or a coefficient is not finite.
    """
    estimator_class = estimator(law_name)
    try:
        law_estimator = estimator_class(**(options or {}))
    except TypeError as error:
        raise FitError(f"law '{law_name}' does not take these options ({error}).") from error
    for need in estimator_class.needs:
        if any(getattr(record, need) is None for record in joint_records):
            raise FitError(
                f"joint '{joint_records[0].joint}': law '{law_name}' needs the key '{need}'; add "
                "it to the robot file."
            )
    largest = max(float(np.max(np.abs(record.tau))) for record in joint_records)
    # Nothing is too small for a baseline.
    smallest = -1.0 if estimator_class.baseline else _MIN_TORQUE
    if not smallest < largest < 1.0 / _MIN_TORQUE:
        raise FitError(
            f"joint '{joint_records[0].joint}': its friction torque reaches {largest:g}; law "
            f"'{law_name}' cannot be fitted to it; check the column and its unit."
        )

    def fit_law(records: Sequence[FrictionRecord]) -> FrictionLaw:
        law = law_estimator.fit(records, np.random.default_rng(seed))
        _require_law(law_name, law)
        space = None
        if isinstance(law_estimator, OneForm):
            space = law_estimator.build_fitted_space(law)
        return add_standard_errors(law, records, space)

    with threadpool_limits(1), _fail_as_fit_error(law_name, joint_records[0].joint):
        law = fit_in_own_units(law_estimator, joint_records, fit_law)
        _require_finite_errors(law)
        require_bounded_torque(law, joint_records)
        return law


def _require_law(law_name: str, law: object) -> None:
    """Raise ConfigError if the method `fit` of a law's class returns something else."""
    if not isinstance(law, FrictionLaw):
        raise ConfigError(
            f"law '{law_name}': 'fit' returns {type(law).__name__}; expected FrictionLaw.",
            code="law.class.fit",
            key="fit",
        )


@contextmanager
def _fail_as_fit_error(law_name: str, joint: str) -> Iterator[None]:
    """Raise as FitError what a law without a solution raises, and silence NumPy.

    Trials of a search may diverge; that the coefficients, standard errors and torques of the result
    are finite is checked.
    """
    with np.errstate(all="ignore"):
        try:
            yield
        except LogError as error:  # names joint and remedy
            raise FitError(str(error), code=error.code, key=error.key) from error
        except (ArtifactError, SimulationError) as error:
            reason = str(error).rstrip(".")
            raise FitError(
                f"joint '{joint}': {reason}; its torque does not determine the law."
            ) from error
        except (np.linalg.LinAlgError, ArithmeticError) as error:
            reason = str(error).rstrip(".")
            raise FitError(
                f"joint '{joint}': the equations of law '{law_name}' have no solution ({reason}); "
                "its torque does not determine the law."
            ) from error


def _require_finite_errors(law: FrictionLaw) -> None:
    errors = [np.array(list(law.standard_errors.values()))]
    if law.covariance is not None:
        errors.append(law.covariance.matrix.ravel())
    if not np.all(np.isfinite(np.concatenate(errors))):
        raise ArtifactError(f"law '{law.name}': its standard errors are not finite.")


def fit(
    law: str | type[Estimator],
    *logs: Sequence[FrictionRecord],
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    robot: str = "robot",
    workers: int = 1,
) -> FrictionModel:
    """Fit one law to every joint; each of `logs` has one record per joint, of the same joints.

    A `law` is given by name or class.
    """
    law_name = to_law_name(law)
    if not logs:
        raise FitError(f"law '{law_name}': no log given; pass the records of at least one.")
    joints = [_list_joints(log_records) for log_records in logs]
    for other_joints in joints[1:]:
        if other_joints != joints[0]:
            raise FitError(
                f"law '{law_name}': logs have different joints, {', '.join(joints[0])} and "
                f"{', '.join(other_joints)}."
            )
    return fit_models(
        [law_name],
        [list(joint_records) for joint_records in zip(*logs, strict=True)],
        robot=robot,
        seed=seed,
        options={law_name: dict(options or {})},
        provenance=source_of(files=[], seed=seed),
        workers=workers,
    )[law_name]


def _list_joints(log_records: Sequence[FrictionRecord]) -> tuple[str, ...]:
    return tuple(record.joint for record in log_records)


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
    report_left_out: Callable[[str, FitError], None] | None = None,
    checkpoints: Path | None = None,
    per_log: Sequence[Nuisance] = (),
) -> dict[str, FrictionModel]:
    """Fit several laws to every joint; return models by name of the law or variant.

    `records` are those of each joint, one per training log; `variants` maps names to laws of the
    registry. Without `report_left_out` the first law that the records do not determine raises its
    error.
    `checkpoints` is a folder of checkpoints for killed runs. Nuisances `per_log` are removed first
    (`days`).
    """
    variants = variants or {}
    options = options or {}
    coupling = records[0][0].coupling
    records = transform_all_records(records)
    origin = dict(provenance or {})
    if per_log:
        records, nuisance_values = _remove_all_nuisances(records, per_log)
        origin["per_log"] = nuisance_values
    with scratch_folder() as folder:
        jobs = []
        for law_name in dict.fromkeys(laws):  # a repeated law once
            for j, joint_records in enumerate(records):
                progress_file = Path(folder, f"{law_name}.{j}")
                fit_law = partial(
                    load_or_fit,
                    variants.get(law_name, law_name),
                    joint_records,
                    checkpoints=checkpoints,
                    progress=progress_file,
                    seed=seed,
                    options=options.get(law_name),
                )
                jobs.append(_FitJob(law_name, joint_records[0].joint, fit_law, progress_file))
        fitted_laws, failures = _run_jobs(
            jobs, workers, progress, stops_at_failure=report_left_out is None
        )
    calibrated, calibration_failures = _calibrate_laws(fitted_laws, records, workers)
    failures |= calibration_failures
    failed_laws = [law_name for law_name in laws if law_name in failures]
    for law_name in failed_laws:
        if report_left_out is None or not calibrated:
            raise failures[law_name]
        report_left_out(law_name, failures[law_name])
    sample_time = _find_sample_time(records)
    trained = tuple(map(TrainedRange.from_records, records))
    first_records = [joint_records[0] for joint_records in records]
    models = {}
    for law_name, joint_laws in calibrated.items():
        models[law_name] = FrictionModel(
            law=law_name,
            robot=robot,
            joints=tuple(record.joint for record in first_records),
            laws=tuple(joint_law.law for joint_law in joint_laws),
            sliding=tuple(record.sliding for record in first_records),
            coupling=coupling,
            sample_time=sample_time,
            trained=trained,
            training_rmse=tuple(joint_law.training_rmse for joint_law in joint_laws),
            left_out_rmse=_list_left_out_errors(joint_laws),
            provenance=dict(origin),
        )
    return models


def _find_sample_time(records: Sequence[Sequence[FrictionRecord]]) -> float:
    """Return the median sample period [s] over records [joint][log]."""
    periods = []
    for joint_records in records:
        periods += [float(np.median(np.diff(record.t))) for record in joint_records]
    return round(float(np.median(periods)), 9)


def _remove_all_nuisances(
    records: Sequence[Sequence[FrictionRecord]], per_log: Sequence[Nuisance]
) -> tuple[list[list[FrictionRecord]], dict[str, Any]]:
    """Return records without what differs by log, and its values by joint and log."""
    remaining_records = []
    nuisance_values = {}
    for joint_records in records:
        nuisances = estimate_nuisances(joint_records, per_log)
        remaining_records.append(remove_nuisances(joint_records, nuisances))
        nuisance_values[joint_records[0].joint] = {
            log: asdict(log_nuisances) for log, log_nuisances in nuisances.items()
        }
    return remaining_records, nuisance_values


def _list_left_out_errors(joint_laws: Sequence["_CalibratedLaw"]) -> tuple[float, ...]:
    """Return the errors [N.m] on left-out logs by joint; none unless all joints have one."""
    errors = [
        joint_law.left_out_rmse for joint_law in joint_laws if joint_law.left_out_rmse is not None
    ]
    return tuple(errors) if len(errors) == len(joint_laws) else ()


class _CalibratedLaw(NamedTuple):
    """Law of a joint with its band, and its errors [N.m]; `left_out_rmse` is None if unknown."""

    law: FrictionLaw
    training_rmse: float
    left_out_rmse: float | None


def _calibrate_laws(
    fitted_laws: Mapping[str, Sequence[FrictionLaw]],
    records: Sequence[Sequence[FrictionRecord]],
    workers: int | None,
) -> tuple[dict[str, list[_CalibratedLaw]], dict[str, FitError]]:
    """Pool the errors of all joints of a law and fit its bands; return laws and failures."""
    joints = [joint_records[0].joint for joint_records in records]
    pooled_laws, failures = _pool_laws(fitted_laws, joints)
    calibrations = []
    names = []
    for law_name, joint_laws in pooled_laws.items():
        for law, joint_records in zip(joint_laws, records, strict=True):
            calibrations.append(partial(_calibrate, law_name, law, joint_records))
            names.append(f"{joint_records[0].joint}, {law_name}")
    calibrated: dict[str, list[_CalibratedLaw]] = {law_name: [] for law_name in pooled_laws}
    with parallel.results_of(calibrations, workers, names=names) as results:
        for law_name, calibrated_laws in calibrated.items():
            for result in islice(results, len(records)):
                if isinstance(result, FitError):
                    failures.setdefault(law_name, result)
                else:
                    calibrated_laws.append(result)
    return _select_successes(calibrated, failures), failures


def _pool_laws(
    fitted_laws: Mapping[str, Sequence[FrictionLaw]], joints: Sequence[str]
) -> tuple[dict[str, list[FrictionLaw]], dict[str, FitError]]:
    """Pool the errors of the joints of each law; return laws [joint] and failures."""
    pooled_laws: dict[str, list[FrictionLaw]] = {}
    failures: dict[str, FitError] = {}
    for law_name, joint_laws in fitted_laws.items():
        try:
            with _fail_as_fit_error(law_name, ", ".join(joints)):
                pooled = pool_errors(joint_laws)
                for law in pooled:
                    _require_finite_errors(law)
        except FitError as error:
            failures[law_name] = error
        else:
            pooled_laws[law_name] = pooled
    return pooled_laws, failures


def _select_successes(
    fitted_laws: Mapping[str, _T], failures: Mapping[str, FitError]
) -> dict[str, _T]:
    """Return the entries of the laws that did not fail."""
    return {law_name: entry for law_name, entry in fitted_laws.items() if law_name not in failures}


def _calibrate(
    law_name: str, law: FrictionLaw, joint_records: Sequence[FrictionRecord]
) -> _CalibratedLaw | FitError:
    try:
        with _fail_as_fit_error(law_name, joint_records[0].joint):
            law_with_band, left_out_rmse = calibrate_band(law, joint_records)
            training_rmse = training_error(law, joint_records)
            if not np.isfinite(training_rmse):
                raise ArtifactError(f"law '{law_name}': its torque diverges on the training logs.")
    except FitError as error:
        return error
    return _CalibratedLaw(law_with_band, training_rmse, left_out_rmse)


class _FitJob(NamedTuple):
    """Fit of a law to a joint, which writes its progress to a file."""

    law_name: str
    joint: str
    run: "partial[FrictionLaw | FitError]"
    progress_file: Path


def _run_jobs(
    jobs: Sequence[_FitJob], workers: int | None, progress: Progress, *, stops_at_failure: bool
) -> tuple[dict[str, list[FrictionLaw]], dict[str, FitError]]:
    """Return the laws of all joints, and the first failure of each law that has one."""
    fitted_laws: dict[str, list[FrictionLaw]] = {job.law_name: [] for job in jobs}
    failures: dict[str, FitError] = {}
    files = [job.progress_file for job in jobs]
    names = [f"{job.joint}, {job.law_name}" for job in jobs]
    runs = [job.run for job in jobs]
    with watched(files, progress), parallel.results_of(runs, workers, names=names) as results:
        for job, result in zip(jobs, results, strict=True):
            if isinstance(result, FrictionLaw):
                fitted_laws[job.law_name].append(result)
            elif stops_at_failure:
                raise result
            else:
                failures.setdefault(job.law_name, result)
    return _select_successes(fitted_laws, failures), failures


def load_or_fit(
    law_name: str,
    joint_records: Sequence[FrictionRecord],
    *,
    checkpoints: Path | None,
    progress: Path,
    seed: int,
    options: Mapping[str, Any] | None,
) -> FrictionLaw | FitError:
    """Return the fitted law of a joint, from its checkpoint if it has one, or why it has none."""
    checkpoint = None
    # The key does not contain the expressions of a law, which a session can define anew.
    if checkpoints and not is_of_session(law_name):
        key = compute_key(law_name, joint_records, seed, options)
        file_name = f"{law_name}.{joint_records[0].joint}.{key}.json"
        checkpoint = checkpoints / "".join(
            c if c.isalnum() or c in "._-" else "_" for c in file_name
        )
    report = make_file_progress(progress)
    law = None
    if checkpoint and checkpoint.is_file():
        with suppress(ArtifactError):  # incomplete
            law = FrictionModel.read(checkpoint).laws[0]
    if law is None:
        try:
            with steps_told(report):
                law = fit_joint(law_name, joint_records, seed=seed, options=options)
        except FitError as error:
            return error
        if checkpoint:
            _write_checkpoint(checkpoint, law, joint_records)
    report(1, 1)
    return law


def _write_checkpoint(
    path: Path, law: FrictionLaw, joint_records: Sequence[FrictionRecord]
) -> None:
    """Write the law of one joint as a model."""
    steps = np.concatenate([np.diff(record.t) for record in joint_records])
    model = FrictionModel(
        law=law.name,
        robot="robot",
        joints=(joint_records[0].joint,),
        laws=(law,),
        sliding=(joint_records[0].sliding,),
        sample_time=round(float(np.median(steps)), 9),
    )
    model.write(path)
