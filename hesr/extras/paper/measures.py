"""Measures of the claims: functions of the evidence that return values by label."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import wraps
from typing import Any, cast

import numpy as np
from scipy.special import stdtrit

from cosim.loop.motions import FourierMotion, Motions
from cosim.report.tables.table import joints, title
from fmu_src.friction.built_in import model_file
from hesr.extras.paper.evidence import TWIN, Case, Evidence, Number
from hesr_model.audit.audit import audit
from hesr_model.fitting.fit import fit_joint
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.laws.lugre import LuGre
from hesr_model.laws.parfam import calibrate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.laws import COEFFICIENTS
from hesr_model.motions.excitation import condition
from hesr_model.motions.trajectories import Fourier

Values = Mapping[str, Number]


def _number(value: float | Number) -> Number:
    return value if isinstance(value, Number) else Number(value=float(value))


def _of_joints(of: Callable[..., float | Number]) -> Callable[..., Values]:
    @wraps(of)
    def measure(*about: Any, **options: Any) -> Values:
        found = enumerate(joints(about[0].robot.n))
        return {name: _number(of(*about, joint, **options)) for joint, name in found}

    return measure


def _of_cases(of: Callable[..., float | Number]) -> Callable[..., Values]:
    @wraps(of)
    def measure(e: Evidence, *, truth: str = TWIN, **options: Any) -> Values:
        found = {one: _of_joints(of)(e, case, **options) for one, case in e.cases[truth].items()}
        return {f"{one} {name}": v for one, own in found.items() for name, v in own.items()}

    return measure


def _law(e: Evidence, case: Case, joint: int) -> FrictionLaw:
    return case.models[e.study.literal].laws[joint]


@_of_cases
def errors(
    e: Evidence,
    case: Case,
    joint: int,
    *,
    others: Sequence[str],
    law: str = "",
    test: str = "fourier",
    reversals: bool = False,
) -> Number:
    """Return the RMSE of a law, by default the literal one, over the lowest one of others."""
    return case.ratio(law or e.study.literal, others, test, joint, reversals=reversals)


@_of_cases
def level(_: Evidence, case: Case, joint: int, *, law: str, test: str = "fourier") -> float:
    """Return the RMSE [N.m] of a law."""
    return rmse(np.concatenate(case.errors(law, test, joint)))


@_of_cases
def rise(e: Evidence, case: Case, joint: int, *, low: str, high: str, law: str = "") -> float:
    """Return the RMSE of a law on a band over that on a lower band."""
    errors = (case.errors(law or e.study.literal, band, joint) for band in (low, high))
    below, above = (rmse(np.concatenate(of_band)) for of_band in errors)
    return above / below


@_of_cases
def training(e: Evidence, case: Case, joint: int, *, other: str) -> float:
    """Return the training error of the literal law over that of another one."""
    own, its = (case.models[law].training_rmse[joint] for law in (e.study.literal, other))
    return own / its


def tracking(
    e: Evidence, *, pairs: Sequence[tuple[str, str]], controllers: Sequence[tuple[str, str]]
) -> Values:
    """Return the RMSE of tracking of a law over that of another one, both under controllers.

    The value is the geometric mean over the motions, the interval Student's.
    """
    found: dict[str, Number] = {}
    for one, other in controllers:
        for law, reference in pairs:
            logs = np.log(e.tracked[one][law].rmse / e.tracked[other][reference].rmse)
            half = stdtrit(len(logs) - 1, 0.975) * logs.std(axis=0, ddof=1) / np.sqrt(len(logs))
            ends = np.exp(logs.mean(axis=0) + np.outer([0.0, -1.0, 1.0], half)).T.tolist()
            label = f"{one}, to {title(reference)}," if len(pairs) > 1 else f"{one},"
            numbers = zip(joints(len(ends)), ends, strict=True)
            found |= {f"{label} {j}": Number(value=v, low=a, high=b) for j, (v, a, b) in numbers}
    return found


def base_parameters(e: Evidence) -> Values:
    """Return the number of base parameters without inertias of rotors."""
    return {"": _number(sum(not e.body.names[k].endswith("Ir") for k in e.body.base))}


def conditioning(e: Evidence, *, motion: str, seeds: int) -> Values:
    """Return the condition number of a Fourier motion over the median of random ones."""
    drawn = Motions.read(e.study.twin.motions).motions
    [own] = [m for m in drawn if m.name == motion and isinstance(m, FourierMotion)]
    every = [own.model_copy(update={"seed": s}) for s in (own.seed, *range(1, seeds + 1))]
    motions = (cast(Fourier, m.trajectory()) for m in every)
    first, *others = (condition(e.robot, e.body.base, m) for m in motions)
    return {"": _number(first / float(np.median(others)))}


@_of_joints
def body_error(e: Evidence, joint: int, *, test: str) -> float:
    """Return the RMS error of the rigid-body torque over the RMS of friction."""
    truth = e.recordings[test].truth
    record = e.records[test][0][joint]
    friction = truth.tau_f_true[:, joint]
    return rmse(record.tau_load - truth.tau_meas[:, joint] + friction) / rmse(friction)


@_of_joints
def explained(e: Evidence, joint: int, *, log: str, by: str) -> float:
    """Return the share of a variance: of torque by the body, or of the residual by friction."""
    truth = e.recordings[log].truth.tau_f_true[:, joint]
    record = e.records[log][0][joint]
    left, whole = (
        (record.tau, record.tau + record.tau_load)
        if by == "body"
        else (record.tau - truth, record.tau)
    )
    return 1.0 - float(np.var(left) / np.var(whole))


@_of_cases
def euler_factor(e: Evidence, case: Case, joint: int) -> float:
    """Return 1 - alpha dt of the literal law."""
    return 1.0 - _law(e, case, joint).values["alpha"] * case.models[e.study.literal].sample_time


@_of_cases
def memory(e: Evidence, case: Case, joint: int, *, rest: float) -> float:
    """Return the gap of the torques after sliding both ways and a rest [s], over that before it."""
    law = _law(e, case, joint)
    trained_range = case.models[e.study.literal].trained[joint]
    dq = np.repeat(
        [0.5 * trained_range.speed, 0.0], [400, 1 + round(rest / trained_range.sample_time)]
    )
    t = trained_range.sample_time * np.arange(len(dq))
    gap = predict(law, t=t, dq=dq) - predict(law, t=t, dq=-dq)
    return float(gap[-1] / gap[400])


@_of_cases
def audited(e: Evidence, case: Case, joint: int, *, what: str) -> float:
    """Return a result of the passivity audit of the literal law: energy [J] or step [N.m]."""
    trained_range = case.models[e.study.literal].trained[joint]
    return float(getattr(audit(_law(e, case, joint), trained_range), what))


@_of_joints
def published(e: Evidence, joint: int) -> float:
    """Return the largest energy [J] that a cycle of the law of Table I generates."""
    trained_range = next(iter(e.cases[TWIN].values())).models[e.study.literal].trained[joint]
    return audit(
        FrictionModel.read(model_file("uf850-table1")).laws[joint], trained_range
    ).generated


@_of_cases
def moved(e: Evidence, case: Case, joint: int) -> float:
    """Return alpha after stage 3 over that of stage 1."""
    rows = JointRows.of(case.training[joint], coefficients=COEFFICIENTS)
    features = HysteresisFeatures(samples=rows, discretisation="euler")
    return _law(e, case, joint).values["alpha"] / calibrate.geometric(features)[0]


@_of_cases
def kept(e: Evidence, case: Case, joint: int, *, feature: str = "") -> int:
    """Return the number of coefficients of the literal law, of 9, or of those of a feature."""
    names = [name for name in _law(e, case, joint).values if name not in ("alpha", "beta")]
    return sum(name.endswith(feature) for name in names)


@_of_cases
def recovery(e: Evidence, case: Case, joint: int, *, noise: Sequence[float]) -> float:
    """Return the RMSE of the law found on torques of Table I, over their standard deviation."""
    log = case.training[joint][0]
    law = FrictionModel.read(model_file("uf850-table1")).laws[joint]
    clean = predict(law, t=log.t, dq=log.dq)
    tau = clean + noise[joint] * np.random.default_rng(e.study.seed).normal(size=len(clean))
    variant = e.study.variants[e.study.literal]
    found = fit_joint(
        variant.law, [replace(log, tau=tau)], seed=e.study.seed, options=variant.options
    )
    return rmse(predict(found, t=log.t, dq=log.dq) - clean) / float(np.std(clean))


@_of_cases
def starts(e: Evidence, case: Case, joint: int, *, count: int, within: float) -> float:
    """Return the share of random starts whose local search finds the best fit of LuGre."""
    rows = JointRows.of(case.training[joint], coefficients=COEFFICIENTS)
    problem = Separable(LuGre.core({}), LuGre().space(), rows)
    low, high = problem.bounds.T
    points = np.random.default_rng(e.study.seed).uniform(low, high, (count, len(low)))
    ends = (problem.solve(problem.polish(point, evaluations=60))[1] for point in points)
    found = np.sqrt(np.array([*ends]) / len(rows.tau))
    best = min(case.models["lugre"].training_rmse[joint], float(found.min()))
    return float(np.mean(found <= within * best))
