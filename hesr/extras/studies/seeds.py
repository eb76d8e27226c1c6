"""Prediction part of a twin's study over random draws, and on alternative plants."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from cosim.loop.excite import (
    Recording,
    export_twin,
    load_arm,
    record_directions,
    record_motions,
    twin_plant,
)
from cosim.loop.motions import FourierMotion, Motions, MotionSpec, SweepMotion
from cosim.study import scores
from cosim.study.results import Seeds, SeedScores, Spread
from cosim.study.scores import MEASURED_START, ORACLE, REFERENCE, Errors, transpose_records
from cosim.study.study import Study
from fmu_src.arm.plant import Plant, servo_signals
from hesr_model.errors import ArgumentError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import score
from hesr_model.rigid_body.choice import identify_from_logs
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, report_progress, silent

MIN_DRAWS = 2
LEVEL = 0.15
"""Standard deviation of the logarithm of Coulomb friction."""
VISCOSITY = 0.3
"""Standard deviation of the logarithm of viscous friction."""
_MIN_AMPLITUDE = 0.8  # factor on that of motions other than Fourier series
_MAX_TRIES = 100  # draws of a Fourier motion within the limits
_UPPER_QUANTILE = 0.975


def run_seeds(
    path: Path, seeds: int, *, laws: Sequence[str] = (), progress: Progress = silent
) -> Seeds:
    """Run the prediction part of a twin's study over draws; the first has the study's seed."""
    study = Study.read(path)
    law_names = tuple(laws or study.laws)
    _require_draws(study, path, seeds, law_names)
    jobs = [
        partial(simulate_draw, study, study.seed + draw_index, law_names)
        for draw_index in range(seeds)
    ]
    names = [f"draw {number}" for number in range(1, seeds + 1)]
    with parallel.results_of(jobs, names=names) as results:
        draws = [next(results) for _ in report_progress(jobs, progress)]
    reference = REFERENCE if REFERENCE in law_names else law_names[0]
    tests = {}
    for test in study.logs.test:
        tests[test] = _summarise_scores([draw[test] for draw in draws], reference)
    return Seeds(
        seeds=seeds,
        joints=RobotDescription.read(study.robot).joints,
        reference=reference,
        tests=tests,
    )


def _require_draws(study: Study, path: Path, seeds: int, law_names: Sequence[str]) -> None:
    """Refuse a study whose draws cannot be simulated or compared."""
    if study.twin is None:
        raise ArgumentError(f"{path}: 'seeds' needs a digital twin; this study has measured logs.")
    if study.twin.truth is not None:
        raise ArgumentError(
            f"{path}: 'seeds' needs the friction of the MJCF; remove the key 'twin.truth'."
        )
    if not study.logs.test:
        raise ArgumentError(f"{path}: 'seeds' needs test sets; add the table 'logs.test'.")
    if seeds < MIN_DRAWS:
        raise ArgumentError(f"'seeds' is {seeds}; at least {MIN_DRAWS} are needed.")
    if not law_names:
        raise ArgumentError(f"{path}: 'seeds' needs the key 'laws', or 'quick'.")


def simulate_draw(study: Study, seed: int, laws: Sequence[str]) -> Errors:
    """Return the errors of laws and true friction on the test sets of one draw."""
    assert study.twin is not None
    rng = np.random.default_rng(seed)
    plant = Plant.read(study.twin.plant)
    noise_seed = int(rng.integers(2**31))
    joint_count = len(plant.joints)
    # The order of draws decides the numbers of a seed.
    levels = np.exp(rng.normal(0.0, LEVEL, joint_count))
    viscosities = np.exp(rng.normal(0.0, VISCOSITY, joint_count))
    arm_recordings: list[Recording] = []
    with load_arm(plant, signals=servo_signals(plant, levels, viscosities)) as arm:
        for motion in Motions.read(study.twin.motions).motions:
            drawn_motion = _draw_motion(motion, arm.limits, rng)
            arm_recordings += record_directions(arm, drawn_motion, noise_seed)
    return compute_errors(study, arm_recordings, laws, partial(fit_models, seed=seed, workers=1))


def compute_errors(
    study: Study,
    recordings: Sequence[Recording],
    laws: Sequence[str],
    fit: Callable[..., dict[str, FrictionModel]],
) -> Errors:
    """Return the errors of laws and true friction on the test sets of a twin's logs."""
    logs = {recording.log.name: recording.log for recording in recordings}
    truths = {recording.log.name: recording.truth.tau_f_true for recording in recordings}
    robot = Robot(RobotDescription.read(study.robot))
    body = identify_from_logs(
        [logs[name] for name in study.logs.identification],
        robot,
        study.body_option,
        reversed_logs=[logs[name] for name in study.logs.reversed],
    )

    def select_records(names: Sequence[str]) -> list[list[FrictionRecord]]:
        return transpose_records([friction_records(logs[name], robot, body) for name in names])

    models = fit(
        laws,
        select_records(study.logs.training),
        robot=robot.description.name,
        options=study.options,
    )
    errors: dict[str, dict[str, list[float]]] = {}
    for test, names in study.logs.test.items():
        test_records = select_records(names)
        predictions = scores.predict_models(models, scores.make_causal(test_records))
        test_truths = [truths[name] for name in names]
        predictions[ORACLE] = [_select_joint(test_truths, j) for j in range(len(test_records))]
        errors[test] = {
            law_name: _compute_rmse(test_records, law_predictions)
            for law_name, law_predictions in predictions.items()
        }
    return errors


def _select_joint(torques: Sequence[Array], j: int) -> list[Array]:
    """Return the torque (N,) of joint j on each log, of those (N, n) of all joints."""
    return [torque[:, j] for torque in torques]


def _compute_rmse(
    records: Sequence[Sequence[FrictionRecord]], predictions: Sequence[Sequence[Array]]
) -> list[float]:
    """Return the RMS error [N.m] of predictions [joint][log] on each joint."""
    return [
        score(joint_records, tau_predicted).rmse
        for joint_records, tau_predicted in zip(records, predictions, strict=True)
    ]


def _draw_motion(motion: MotionSpec, limits: Array, rng: np.random.Generator) -> MotionSpec:
    """Draw another motion of the same kind, within the limits (n, 2) [rad]."""
    if not isinstance(motion, FourierMotion):
        factor = float(rng.uniform(_MIN_AMPLITUDE, 1.0))
        changes = {"amplitude": tuple(factor * amplitude for amplitude in motion.amplitude)}
        if isinstance(motion, SweepMotion):
            changes["swing"] = tuple(factor * swing for swing in motion.swing)
        return motion.model_copy(update=changes)
    for _ in range(_MAX_TRIES):
        drawn_motion = motion.model_copy(update={"seed": int(rng.integers(2**31))})
        trajectory = drawn_motion.trajectory()
        q = trajectory.sample(np.linspace(0.0, trajectory.duration, 4000))[0]
        if np.all((q > limits[:, 0]) & (q < limits[:, 1])):
            return drawn_motion
    return motion


def _summarise_scores(draws: Sequence[Mapping[str, Sequence[float]]], reference: str) -> SeedScores:
    """Return the spreads of RMS errors, and of their ratios to those of the reference."""
    reference_rmse = np.array([draw[reference] for draw in draws])
    rmse = {}
    ratios = {}
    for law_name in draws[0]:
        law_rmse = np.array([draw[law_name] for draw in draws])
        rmse[law_name] = _compute_spreads(law_rmse)
        if law_name != reference:
            # Ratios are averaged as logarithms.
            ratios[law_name] = _compute_spreads(np.log(law_rmse / reference_rmse), np.exp)
    return SeedScores(rmse=rmse, ratios=ratios)


def _compute_spreads(
    values: Array, transform: Callable[[Array], Array] = np.asarray
) -> tuple[Spread, ...]:
    """Return `transform` of mean and Student's 95 % interval of each column (seeds, n)."""
    seed_count = len(values)
    means = values.mean(axis=0)
    quantile = stdtrit(seed_count - 1, _UPPER_QUANTILE)
    half_widths = quantile * values.std(axis=0, ddof=1) / np.sqrt(seed_count)
    rows = transform(np.column_stack([means, means - half_widths, means + half_widths]))
    return tuple(Spread(mean=mean, low=low, high=high) for mean, low, high in rows.tolist())


def evaluate_truths(
    study: Study, path: Path, laws: Sequence[str], *, progress: Progress = silent
) -> dict[str, Errors]:
    """Return the errors of laws by alternative plant of the twin, refitted to each.

    The twin's bristles favour bristle laws.
    """
    twin = study.twin
    assert twin is not None
    errors: dict[str, Errors] = {}
    fit = partial(fit_models, seed=study.seed, report_left_out=lambda *_: None)
    for truth in report_progress(twin.truths, progress, str):
        with scratch_folder() as folder:
            plant, signals = twin_plant(twin.model_copy(update={"truth": truth}), path, folder)
            arm = export_twin(plant, folder, signals)
            truth_recordings = list(record_motions(Motions.read(twin.motions), plant, fmu=arm))
        errors_by_test = compute_errors(study, truth_recordings, laws, fit)
        errors[truth] = {
            test: _remove_measured_starts(test_errors)
            for test, test_errors in errors_by_test.items()
        }
    return errors


def _remove_measured_starts(
    test_errors: Mapping[str, Sequence[float]],
) -> dict[str, Sequence[float]]:
    return {
        law_name: rmse
        for law_name, rmse in test_errors.items()
        if not law_name.endswith(MEASURED_START)
    }
