"""Prediction part of a twin's study over random draws, and on alternative plants."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from cosim.loop.excite import Recording, export_twin, loaded_arm, recorded, recordings, twin_plant
from cosim.loop.motions import FourierMotion, Motions, MotionSpec, SweepMotion
from cosim.study import scores
from cosim.study.results import Seeds, SeedScores, Spread
from cosim.study.scores import MEASURED_START, ORACLE, REFERENCE, Errors, by_joint
from cosim.study.study import Study
from fmu_src.arm.plant import Plant, servo_signals
from hesr_model.errors import ConfigError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import score
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, counted, silent

LEAST = 2  # draws
LEVEL = 0.15
VISCOSITY = 0.3
"""Standard deviations of the logarithms of Coulomb and viscous friction."""
_AMPLITUDE = 0.8  # minimum, of motions other than Fourier series
_TRIES = 100  # draws of a Fourier motion within the limits
_UPPER = 0.975  # quantile


def run_seeds(
    path: Path, seeds: int, *, laws: Sequence[str] = (), progress: Progress = silent
) -> Seeds:
    """Run the prediction part of a twin's study over draws; the first has the study's seed."""
    study = Study.read(path)
    if study.twin is None:
        raise ConfigError(f"{path}: --seeds needs a digital twin; this study has measured logs.")
    if study.twin.truth is not None:
        raise ConfigError(
            f"{path}: --seeds needs the friction of the MJCF; remove the key 'twin.truth'."
        )
    if seeds < LEAST:
        raise ConfigError(f"--seeds is {seeds}; at least {LEAST} are needed.")
    named = tuple(laws or study.laws)
    if not named:
        raise ConfigError(f"{path}: --seeds needs the key 'laws', or --quick.")
    jobs = [partial(one_draw, study, study.seed + k, named) for k in range(seeds)]
    with parallel.results_of(jobs, names=[f"draw {k + 1}" for k in range(seeds)]) as results:
        drawn = [next(results) for _ in counted(jobs, progress)]
    reference = REFERENCE if REFERENCE in named else named[0]
    return Seeds(
        seeds=seeds,
        joints=RobotDescription.read(study.robot).joints,
        reference=reference,
        tests={test: _scores([d[test] for d in drawn], reference) for test in study.logs.test},
    )


def one_draw(study: Study, seed: int, laws: Sequence[str]) -> Errors:
    """Return the errors of laws and true friction on the test sets of one draw."""
    assert study.twin is not None
    rng = np.random.default_rng(seed)
    plant = Plant.read(study.twin.plant)
    noise_seed = int(rng.integers(2**31))
    joints = len(plant.joints)
    levels, rates = (np.exp(rng.normal(0.0, sd, joints)) for sd in (LEVEL, VISCOSITY))
    with loaded_arm(plant, signals=servo_signals(plant, levels, rates)) as arm:
        found = [
            recording
            for motion in Motions.read(study.twin.motions).motions
            for recording in recorded(arm, _drawn(motion, arm.limits, rng), noise_seed)
        ]
    return errors_on(study, found, laws, partial(fit_models, seed=seed, workers=1))


def errors_on(
    study: Study,
    recordings: Sequence[Recording],
    laws: Sequence[str],
    fit: Callable[..., dict[str, FrictionModel]],
) -> Errors:
    """Return the errors of laws and true friction on the test sets of a twin's logs."""
    logs = {found.log.name: found.log for found in recordings}
    truths = {found.log.name: found.truth.tau_f_true for found in recordings}
    robot = Robot(RobotDescription.read(study.robot))
    body = identify(
        [logs[name] for name in study.logs.identification],
        robot,
        reversed_logs=[logs[name] for name in study.logs.reversed],
        physical=study.physical,
    )

    def of_logs(names: Sequence[str]) -> list[list[FrictionRecord]]:
        return by_joint([friction_records(logs[name], robot, body) for name in names])

    models = fit(
        laws, of_logs(study.logs.training), robot=robot.description.name, options=study.options
    )
    errors: dict[str, dict[str, list[float]]] = {}
    for test, names in study.logs.test.items():
        tested = of_logs(names)
        predicted = scores.predict_models(models, scores.causal(tested))
        predicted[ORACLE] = [[truths[name][:, k] for name in names] for k in range(len(tested))]
        errors[test] = {
            law: [
                score(joint_records, p).rmse
                for joint_records, p in zip(tested, of_law, strict=True)
            ]
            for law, of_law in predicted.items()
        }
    return errors


def _drawn(motion: MotionSpec, limits: Array, rng: np.random.Generator) -> MotionSpec:
    """Draw another motion of the same kind, within the limits (n, 2) [rad]."""
    if not isinstance(motion, FourierMotion):
        factor = float(rng.uniform(_AMPLITUDE, 1.0))
        keys = ("amplitude", "swing") if isinstance(motion, SweepMotion) else ("amplitude",)
        smaller = {key: tuple(factor * a for a in getattr(motion, key)) for key in keys}
        return motion.model_copy(update=smaller)
    for _ in range(_TRIES):
        own = motion.model_copy(update={"seed": int(rng.integers(2**31))})
        trajectory = own.trajectory()
        q = trajectory.sample(np.linspace(0.0, trajectory.duration, 4000))[0]
        if np.all((q > limits[:, 0]) & (q < limits[:, 1])):
            return own
    return motion


def _scores(drawn: Sequence[Mapping[str, Sequence[float]]], reference: str) -> SeedScores:
    rmse = {law: np.array([of[law] for of in drawn]) for law in drawn[0]}
    logarithms = {law: np.log(of / rmse[reference]) for law, of in rmse.items()}
    return SeedScores(
        rmse={law: _spreads(of) for law, of in rmse.items()},
        ratios={law: _spreads(of, np.exp) for law, of in logarithms.items() if law != reference},
    )


def _spreads(values: Array, shown: Callable[[Array], Array] = np.asarray) -> tuple[Spread, ...]:
    """Return `shown` of mean and Student's 95 % interval of each column (seeds, n)."""
    count = len(values)
    means = values.mean(axis=0)
    halves = stdtrit(count - 1, _UPPER) * values.std(axis=0, ddof=1) / np.sqrt(count)
    rows = shown(np.column_stack([means, means - halves, means + halves]))
    return tuple(Spread(mean=mean, low=low, high=high) for mean, low, high in rows.tolist())


def under_truths(
    study: Study, path: Path, laws: Sequence[str], *, progress: Progress = silent
) -> dict[str, Errors]:
    """Return the errors of laws by alternative plant of the twin, refitted to each.

    The twin's bristles favour bristle laws.
    """
    twin = study.twin
    assert twin is not None
    errors: dict[str, Errors] = {}
    fit = partial(fit_models, seed=study.seed, left_out=lambda *_: None)
    for truth in counted(twin.truths, progress, str):
        with scratch_folder() as folder:
            plant, signals = twin_plant(twin.model_copy(update={"truth": truth}), path, folder)
            arm = export_twin(plant, folder, signals)
            found = list(recordings(Motions.read(twin.motions), plant, fmu=arm))
        errors[truth] = {
            test: {law: rmse for law, rmse in of_test.items() if not law.endswith(MEASURED_START)}
            for test, of_test in errors_on(study, found, laws, fit).items()
        }
    return errors
