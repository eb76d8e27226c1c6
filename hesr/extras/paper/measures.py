"""Measures of the claims: functions of the evidence that return values by label."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from itertools import product
from typing import Any, cast

import numpy as np
from scipy.special import stdtrit

from cosim.loop.motions import FourierMotion, Motions
from cosim.report.tables.table import joints, title
from hesr.extras.paper.evidence import TWIN, Case, Evidence, Number
from hesr_model.audit.attack import attack
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.lugre import LuGre
from hesr_model.laws.parfam import calibrate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.laws import COEFFICIENTS
from hesr_model.motions.excitation import condition
from hesr_model.motions.trajectories import Fourier
from hesr_model.support.arrays import Array

Values = Mapping[str, Number]
CASE_MEASURES: set[str] = set()
"""Measures that can be taken for every true friction, and on measured logs."""
_TEST_OPTIONS = ("test", "low", "high")  # name test sets
_SLIDING_ROWS = 400  # of steady sliding before a rest


def _as_number(value: float | Number) -> Number:
    if isinstance(value, Number):
        return value
    return Number(value=float(value))


def _measure_joints(measure_joint: Callable[..., float | Number]) -> Callable[..., Values]:
    @wraps(measure_joint)
    def measure(evidence: Evidence, *case: Case, **options: Any) -> Values:
        joint_count = len(case[0].training_records) if case else evidence.robot.n
        return {
            name: _as_number(measure_joint(evidence, *case, j, **options))
            for j, name in enumerate(joints(joint_count))
        }

    return measure


def _measure_cases(measure_case: Callable[..., float | Number]) -> Callable[..., Values]:
    @wraps(measure_case)
    def measure(evidence: Evidence, *, truth: str = TWIN, **options: Any) -> Values:
        # Measured robots have no chirps.
        tests = {options[key] for key in _TEST_OPTIONS if key in options}
        values: dict[str, Number] = {}
        for motion, case in evidence.cases[truth].items():
            if tests <= set(case.tests):
                joint_values = _measure_joints(measure_case)(evidence, case, **options)
                values |= {f"{motion} {name}": value for name, value in joint_values.items()}
        return values

    CASE_MEASURES.add(measure_case.__name__)
    return measure


def _literal_law(evidence: Evidence, case: Case, j: int) -> FrictionLaw:
    return case.models[evidence.study.literal].laws[j]


@_measure_cases
def errors(
    evidence: Evidence,
    case: Case,
    j: int,
    *,
    others: Sequence[str],
    law: str = "",
    test: str = "fourier",
    reversals: bool = False,
) -> Number:
    """Return the RMSE of a law, by default the literal one, over the lowest one of others."""
    return case.ratio(law or evidence.study.literal, others, test, j, reversals=reversals)


@_measure_cases
def level(_: Evidence, case: Case, j: int, *, law: str, test: str = "fourier") -> float:
    """Return the RMSE [N.m] of a law."""
    return rmse(np.concatenate(case.errors(law, test, j)))


@_measure_cases
def rise(evidence: Evidence, case: Case, j: int, *, low: str, high: str, law: str = "") -> float:
    """Return the RMSE of a law on a band over that on a lower band."""
    law_name = law or evidence.study.literal
    lower_rmse = rmse(np.concatenate(case.errors(law_name, low, j)))
    upper_rmse = rmse(np.concatenate(case.errors(law_name, high, j)))
    return upper_rmse / lower_rmse


@_measure_cases
def training(evidence: Evidence, case: Case, j: int, *, other: str) -> float:
    """Return the training error of the literal law over that of another one."""
    literal_error = case.models[evidence.study.literal].training_rmse[j]
    return literal_error / case.models[other].training_rmse[j]


def tracking(
    evidence: Evidence, *, pairs: Sequence[tuple[str, str]], controllers: Sequence[tuple[str, str]]
) -> Values:
    """Return the RMSE of tracking of a law over that of another one, both under controllers.

    The value is the geometric mean over the motions, the interval Student's.
    """
    ratios: dict[str, Number] = {}
    for (controller, other_controller), (law_name, reference) in product(controllers, pairs):
        errors = evidence.tracked[controller][law_name].rmse
        other_errors = evidence.tracked[other_controller][reference].rmse
        joint_ratios = _average_ratios(errors / other_errors)
        label = f"{controller},"
        if len(pairs) > 1:
            label = f"{controller}, to {title(reference)},"
        for joint_name, ratio in zip(joints(len(joint_ratios)), joint_ratios, strict=True):
            ratios[f"{label} {joint_name}"] = ratio
    return ratios


def _average_ratios(ratios: Array) -> list[Number]:
    """Return the geometric mean of ratios (M, n) and Student's 95 % interval by column."""
    log_ratios = np.log(ratios)
    motion_count = len(log_ratios)
    quantile = stdtrit(motion_count - 1, 0.975)
    half_widths = quantile * log_ratios.std(axis=0, ddof=1) / np.sqrt(motion_count)
    means = log_ratios.mean(axis=0)
    # Values, then lower and upper ends.
    rows = np.exp(means + np.outer([0.0, -1.0, 1.0], half_widths))
    return [Number(value=value, low=low, high=high) for value, low, high in rows.T.tolist()]


def base_parameters(evidence: Evidence) -> Values:
    """Return the number of base parameters without inertias of rotors."""
    base_names = [evidence.body.names[k] for k in evidence.body.base]
    return {"": _as_number(sum(not name.endswith("Ir") for name in base_names))}


def conditioning(evidence: Evidence, *, motion: str, seeds: int) -> Values:
    """Return the condition number of a Fourier motion over the median of random ones."""
    twin_motions = Motions.read(evidence.study.twin.motions).motions
    [fourier_motion] = [
        twin_motion
        for twin_motion in twin_motions
        if twin_motion.name == motion and isinstance(twin_motion, FourierMotion)
    ]
    conditions = []
    for seed in (fourier_motion.seed, *range(1, seeds + 1)):
        seeded_motion = fourier_motion.model_copy(update={"seed": seed})
        fourier = cast(Fourier, seeded_motion.trajectory())
        conditions.append(condition(evidence.robot, evidence.body.base, fourier))
    condition_number, *random_conditions = conditions
    return {"": _as_number(condition_number / float(np.median(random_conditions)))}


@_measure_joints
def body_error(evidence: Evidence, j: int, *, test: str) -> float:
    """Return the RMS error of the rigid-body torque over the RMS of friction."""
    truth = evidence.recordings[test].truth
    record = evidence.records[test][0][j]
    friction = truth.tau_f_true[:, j]
    return rmse(record.tau_load - truth.tau_meas[:, j] + friction) / rmse(friction)


@_measure_joints
def explained(evidence: Evidence, j: int, *, log: str, by: str) -> float:
    """Return the share of a variance: of torque by the body, or of the residual by friction."""
    truth = evidence.recordings[log].truth.tau_f_true[:, j]
    record = evidence.records[log][0][j]
    if by == "body":
        unexplained = record.tau
        total = record.tau + record.tau_load
    else:
        unexplained = record.tau - truth
        total = record.tau
    return 1.0 - float(np.var(unexplained) / np.var(total))


@_measure_cases
def memory(evidence: Evidence, case: Case, j: int, *, rest: float) -> float:
    """Return the gap of the torques after sliding both ways and a rest [s], over that before it."""
    law = _literal_law(evidence, case, j)
    trained_range = case.models[evidence.study.literal].trained[j]
    rest_rows = round(rest / trained_range.sample_time)
    dq = np.repeat([0.5 * trained_range.speed, 0.0], [_SLIDING_ROWS, 1 + rest_rows])
    t = trained_range.sample_time * np.arange(len(dq))
    gap = predict(law, t=t, dq=dq) - predict(law, t=t, dq=-dq)
    return float(gap[-1] / gap[_SLIDING_ROWS])


@_measure_cases
def generated(evidence: Evidence, case: Case, j: int) -> float:
    """Return the largest energy [J] that a cycle of the literal law generates."""
    trained_range = case.models[evidence.study.literal].trained[j]
    return _find_generated_energy(_literal_law(evidence, case, j), trained_range)


@_measure_joints
def published(evidence: Evidence, j: int) -> float:
    """Return the largest energy [J] that a cycle of the law of Table I generates."""
    first_case = next(iter(evidence.cases[TWIN].values()))
    trained_range = first_case.models[evidence.study.literal].trained[j]
    return _find_generated_energy(FrictionModel.read("uf850-table1").laws[j], trained_range)


def _find_generated_energy(law: FrictionLaw, trained_range: TrainedRange) -> float:
    """Return the energy [J] of the cycle that generates most, of sines and several tones."""
    cycle, _ = attack(law, trained_range)
    return 0.0 if cycle is None else cycle.energy


@_measure_cases
def moved(evidence: Evidence, case: Case, j: int) -> float:
    """Return alpha after stage 3 over that of stage 1."""
    rows = JointRows.from_records(case.training_records[j], coefficients=COEFFICIENTS)
    features = HysteresisFeatures(rows=rows, discretisation="euler")
    first_alpha = calibrate.estimate_from_loop(features)[0]
    return _literal_law(evidence, case, j).values["alpha"] / first_alpha


@_measure_cases
def kept(evidence: Evidence, case: Case, j: int, *, feature: str = "") -> int:
    """Return the number of coefficients of the literal law, of 9, or of those of a feature."""
    names = [
        name for name in _literal_law(evidence, case, j).values if name not in ("alpha", "beta")
    ]
    return sum(name.endswith(feature) for name in names)


@_measure_cases
def recovery(evidence: Evidence, case: Case, j: int, *, noise: Sequence[float]) -> float:
    """Return the RMSE of the law found on torques of Table I, over their standard deviation."""
    record = case.training_records[j][0]
    law = FrictionModel.read("uf850-table1").laws[j]
    true_torque = predict(law, t=record.t, dq=record.dq)
    generator = np.random.default_rng(evidence.study.seed)
    noisy_torque = true_torque + noise[j] * generator.normal(size=len(true_torque))
    variant = evidence.study.variants[evidence.study.literal]
    fitted_law = fit_joint(
        variant.law,
        [replace(record, tau=noisy_torque)],
        seed=evidence.study.seed,
        options=variant.options,
    )
    error = predict(fitted_law, t=record.t, dq=record.dq) - true_torque
    return rmse(error) / float(np.std(true_torque))


@_measure_cases
def starts(evidence: Evidence, case: Case, j: int, *, count: int, within: float) -> float:
    """Return the share of random starts whose local search finds the best fit of LuGre."""
    rows = JointRows.from_records(case.training_records[j], coefficients=COEFFICIENTS)
    problem = Separable(LuGre.core({}), LuGre().space(), rows)
    lower, upper = problem.bounds.T
    points = np.random.default_rng(evidence.study.seed).uniform(lower, upper, (count, len(lower)))
    final_costs = []
    for point in points:
        _, cost = problem.solve(problem.polish(point, evaluations=60))
        final_costs.append(cost)
    final_errors = np.sqrt(np.array(final_costs) / len(rows.tau))
    best_error = min(case.models["lugre"].training_rmse[j], float(final_errors.min()))
    return float(np.mean(final_errors <= within * best_error))
