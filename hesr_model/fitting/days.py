"""Laws over days: nuisances of each log, and adaptation of a fitted law to seconds of a new log.

    tau = level_k f(...) + offset_k    in log k,    mean of the levels 1, of the offsets 0

    minimise    sum_t (tau_t - f_t(c))^2 / s^2  +  (c - c_0)' P^-1 (c - c_0)
    s^2 = (1 + r) / (1 - r) of the residual's mean square,    r: its autocorrelation at one sample

c are the coefficients, c_0 those of an earlier fit and P their covariance in another log, or mean
and spread of several fits; nonlinear ones of a structure that the data chose are held. The maximum
a posteriori is found within bounds, and drawn towards c_0 until the law is proven passive if that
of c_0 is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import sympy

from hesr_model.audit.certificate import certify
from hesr_model.equations.memory import find_read_symbols
from hesr_model.errors import FitError
from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.fitting.local_search import search_locally
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse, training_error
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.covariance import Covariance
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.residual import find_resting_speed, transform_all_records
from hesr_model.support.arrays import Array, Integers

Nuisance = Literal["offset", "level"]
_NUISANCE_ROUNDS = 30
_MIN_LEVEL = 0.2
_MAX_LEVEL = 5.0


@dataclass(frozen=True, kw_only=True)
class LogNuisances:
    """Level of friction [1] and offset [N.m; N] of a log."""

    level: float = 1.0
    offset: float = 0.0


def estimate_nuisances(
    joint_records: Sequence[FrictionRecord], kinds: Sequence[Nuisance]
) -> dict[str, LogNuisances]:
    """Estimate the nuisances of each log of a joint by name; a single log has none."""
    log_names = list(dict.fromkeys(record.log for record in joint_records))
    log_nuisances = [LogNuisances() for _ in log_names]
    if len(log_names) < 2 or not kinds:
        return dict(zip(log_names, log_nuisances, strict=True))
    log_of_row = log_of_rows(joint_records)
    tau = np.concatenate([record.tau for record in joint_records])
    dq = np.concatenate([record.dq for record in joint_records])
    row_shares = np.bincount(log_of_row) / len(log_of_row)
    # Alternate between a Coulomb-viscous law common to all logs and the nuisances of each.
    direction = np.tanh(dq / find_resting_speed(joint_records))
    columns = np.column_stack([direction, dq, np.ones_like(dq)])
    for _ in range(_NUISANCE_ROUNDS):
        level, offset = _expand_to_rows(log_nuisances, log_of_row)
        coefficients = np.linalg.lstsq(level[:, None] * columns, tau - offset, rcond=None)[0]
        log_nuisances = _solve_each_log(columns @ coefficients, tau, log_of_row, kinds)
        log_nuisances = _normalise(log_nuisances, row_shares, kinds)
    return dict(zip(log_names, log_nuisances, strict=True))


def _normalise(
    log_nuisances: Sequence[LogNuisances], row_shares: Array, kinds: Sequence[Nuisance]
) -> list[LogNuisances]:
    """Return nuisances with a mean level of 1 and a mean offset of 0 over all rows.

    The common law takes up the mean ones; without a convention they are not determined.
    """
    mean_level = 1.0
    mean_offset = 0.0
    if "level" in kinds:
        mean_level = float(row_shares @ [nuisances.level for nuisances in log_nuisances])
    if "offset" in kinds:
        mean_offset = float(row_shares @ [nuisances.offset for nuisances in log_nuisances])
    return [
        LogNuisances(level=nuisances.level / mean_level, offset=nuisances.offset - mean_offset)
        for nuisances in log_nuisances
    ]


def remove_nuisances(
    joint_records: Sequence[FrictionRecord], nuisances: Mapping[str, LogNuisances]
) -> list[FrictionRecord]:
    """Return records without the nuisances of their logs."""
    remaining_records = []
    for record in joint_records:
        log_nuisances = nuisances[record.log]
        tau = (record.tau - log_nuisances.offset) / log_nuisances.level
        remaining_records.append(replace(record, tau=tau))
    return remaining_records


def add_fitted_nuisances(
    predictions: Sequence[Array], joint_records: Sequence[FrictionRecord], kinds: Sequence[Nuisance]
) -> list[Array]:
    """Return predictions (N,) [N.m] with fitted nuisances of each log; these are not blind."""
    log_of_row = log_of_rows(joint_records)
    tau_predicted = np.concatenate(predictions)
    tau = np.concatenate([record.tau for record in joint_records])
    nuisances = _solve_each_log(tau_predicted, tau, log_of_row, kinds)
    ends = np.cumsum([len(prediction) for prediction in predictions])
    level, offset = _expand_to_rows(nuisances, log_of_row)
    return np.split(level * tau_predicted + offset, ends[:-1])


def _expand_to_rows(log_nuisances: Sequence[LogNuisances], log_of_row: Integers) -> Array:
    """Return level and offset of each row's log, (2, N)."""
    by_log = np.array([[nuisances.level, nuisances.offset] for nuisances in log_nuisances])
    return by_log[log_of_row].T


def _solve_each_log(
    tau_predicted: Array, tau: Array, log_of_row: Integers, kinds: Sequence[Nuisance]
) -> list[LogNuisances]:
    log_nuisances = []
    for k in range(log_of_row[-1] + 1):
        is_of_log = log_of_row == k
        log_nuisances.append(solve_nuisances(tau_predicted[is_of_log], tau[is_of_log], kinds))
    return log_nuisances


def solve_nuisances(tau_predicted: Array, tau: Array, kinds: Sequence[Nuisance]) -> LogNuisances:
    """Solve for the nuisances of a log, from predicted and measured torque (N,) [N.m]."""
    if "level" not in kinds:
        return LogNuisances(offset=float(np.mean(tau - tau_predicted)))
    columns = [tau_predicted]
    if "offset" in kinds:
        columns.append(np.ones_like(tau_predicted))
    solution = np.linalg.lstsq(np.column_stack(columns), tau, rcond=None)[0]
    level = float(np.clip(solution[0], _MIN_LEVEL, _MAX_LEVEL))
    if "offset" not in kinds:
        return LogNuisances(level=level)
    # Not that of the solution, whose level may be outside the limits.
    return LogNuisances(level=level, offset=float(np.mean(tau - level * tau_predicted)))


_NOISE_ROUNDS = 3  # of the estimate of the noise
_MAX_FACTOR = 2.0  # largest change of coefficients within memory or a function
_CHANGE_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the change, tried until the law is passive
_MIN_RELATIVE_VARIANCE = 1e-8  # relative variance of directions that the earlier fits do not know
_MAX_AUTOCORRELATION = 0.995
_MIN_NOISE = 1e-12  # [N.m]


def build_prior(models: Sequence[FrictionModel]) -> FrictionModel:
    """Return a model whose laws have mean and spread of those of `models`, for a further day.

    The covariance is the mean one plus (1 + 1/K) times the scatter of K models of one structure.

    Raises FitError for laws without a covariance, or of different joints or structures.
    """
    first_model = models[0]
    for model in models:
        if model.thermal or any(law.covariance is None for law in model.laws):
            raise FitError(
                f"friction model '{model.law}': its coefficients have no covariance or depend on "
                "temperature; adapt laws of 'hesr fit', other than networks and 'temperature'."
            )
        if _describe_kind(model) != _describe_kind(first_model):
            raise FitError(
                f"friction model '{model.law}': joints or structures of its laws differ from the "
                "first; adapt the first to the logs of the second instead."
            )
    if len(models) == 1:
        return first_model
    laws_by_joint = zip(*[model.laws for model in models], strict=True)
    return replace(first_model, laws=tuple(map(_average_laws, laws_by_joint)))


def _describe_kind(model: FrictionModel) -> tuple[object, ...]:
    return model.joints, model.coupling, [(law.name, law.form) for law in model.laws]


def _average_laws(laws: Sequence[FrictionLaw]) -> FrictionLaw:
    """Return a law with the mean coefficients, and with their spread beside the mean covariance."""
    covariances = [law.covariance for law in laws if law.covariance is not None]
    names = list(covariances[0].names)
    for covariance in covariances[1:]:
        names = [name for name in names if name in covariance.names]
    matrices = []
    for covariance in covariances:
        indices = [covariance.names.index(name) for name in names]
        matrices.append(covariance.matrix[np.ix_(indices, indices)])
    values = np.array([_list_values(law, names) for law in laws])
    scatter = np.atleast_2d(np.cov(values, rowvar=False))
    mean = dict(zip(names, map(float, values.mean(axis=0)), strict=True))
    # A further day differs from the mean of K days by 1 + 1/K times the scatter of days.
    further_scatter = (1.0 + 1.0 / len(laws)) * scatter
    return _replace_coefficients(laws[0], mean, np.mean(matrices, axis=0) + further_scatter)


def _list_values(law: FrictionLaw, names: Sequence[str]) -> list[float]:
    return [law.values[name] for name in names]


def _replace_coefficients(
    law: FrictionLaw, values: Mapping[str, float], covariance: Array
) -> FrictionLaw:
    zeros = np.zeros_like(covariance)
    names = tuple(values)
    new_covariance = Covariance(
        names=names, within=covariance, between=1.0, degrees=0.0, carried=zeros
    )
    errors = dict(zip(values, map(float, new_covariance.standard_errors), strict=True))
    stated_errors = {name: errors[name] for name in law.standard_errors if name in errors}
    return replace(
        law,
        values={**law.values, **values},
        covariance=new_covariance,
        standard_errors=stated_errors,
    )


def adapt(
    prior_model: FrictionModel, records: Sequence[Sequence[FrictionRecord]]
) -> tuple[FrictionModel, list[str]]:
    """Adapt laws of `build_prior` to records [joint][log]; return them and sentences by joint.

    Raises FitError if the joints differ.
    """
    joints = tuple(joint_records[0].joint for joint_records in records)
    if joints != prior_model.joints:
        raise FitError(
            f"the log has the joints {', '.join(joints)}, but the prior "
            f"{', '.join(prior_model.joints)}."
        )
    transformed_records = transform_all_records(records)
    laws = [
        _adapt_law(prior_model, j, joint_records)
        for j, joint_records in enumerate(transformed_records)
    ]
    errors = tuple(map(training_error, laws, transformed_records))
    seconds = sum(float(np.ptp(record.t)) for record in transformed_records[0])
    model = replace(prior_model, laws=tuple(laws), training_rmse=errors, left_out_rmse=())
    sentences = []
    for j, joint in enumerate(joints):
        prior_error = training_error(prior_model.laws[j], transformed_records[j])
        sentences.append(
            f"{joint}: error over {seconds:.3g} s {prior_error:.3g} -> {errors[j]:.3g}"
        )
    return model, sentences


def _adapt_law(
    prior_model: FrictionModel, j: int, joint_records: Sequence[FrictionRecord]
) -> FrictionLaw:
    law = prior_model.laws[j]
    covariance = law.covariance
    assert covariance is not None
    limits = _bound_coefficients(law, covariance.names)
    if not limits:
        return law
    names = tuple(limits)
    lower, upper = np.array(list(limits.values())).T
    prior_point = np.array(_list_values(law, names))
    adapted = [covariance.names.index(name) for name in names]
    prior_covariance = covariance.of_another_log
    prior_deviations = np.sqrt(np.maximum(np.diag(prior_covariance), np.finfo(float).tiny))
    root = _invert_to_root(prior_covariance, prior_deviations)[:, adapted]

    def build_law(point: Array) -> FrictionLaw:
        changed_values = dict(zip(names, map(float, point), strict=True))
        return replace(law, values={**law.values, **changed_values})

    def error(point: Array) -> Array:
        changed_law = build_law(point)
        return np.concatenate(
            [predict_record(changed_law, record) - record.tau for record in joint_records]
        )

    tau = np.concatenate([record.tau for record in joint_records])
    best = prior_point
    for _ in range(_NOISE_ROUNDS):
        noise = _estimate_noise(error(best))

        def residual(point: Array, noise: float = noise) -> Array:
            return np.concatenate([error(point) / noise, root @ (point - prior_point)])

        optimum = search_locally(
            residual,
            best,
            bounds=(lower, upper),
            scale=prior_deviations[adapted],
            magnitude=float(np.linalg.norm(tau) / noise),
            evaluations=20,
        )
        best = optimum.x
    if prior_model.trained and _is_proven(law, prior_model.trained[j]):
        optimal_change = best - prior_point
        best = prior_point
        for share in _CHANGE_SHARES:
            candidate = prior_point + share * optimal_change
            if _is_proven(build_law(candidate), prior_model.trained[j]):
                best = candidate
                break
    adapted_values = dict(zip(names, map(float, best), strict=True))
    posterior_covariance = np.linalg.pinv(optimum.jac.T @ optimum.jac, hermitian=True)
    return _replace_coefficients(law, adapted_values, posterior_covariance)


def _is_proven(law: FrictionLaw, trained_range: TrainedRange) -> bool:
    return certify(law, trained_range).verdict == "proven"


def _invert_to_root(covariance: Array, deviations: Array) -> Array:
    """Return R with R' R = P^-1 for a covariance P and the roots of its diagonal.

    Directions that P hardly knows have a least variance, so that the prior does not fix them.
    """
    eigenvalues, directions = np.linalg.eigh(covariance / np.outer(deviations, deviations))
    variances = np.maximum(eigenvalues, _MIN_RELATIVE_VARIANCE * eigenvalues[-1])
    return np.asarray((directions / np.sqrt(variances)).T / deviations)


def _bound_coefficients(law: FrictionLaw, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return bounds of adapted coefficients: half to twice if nonlinear, else of the same sign."""
    form = law.form
    limits = {}
    memory_symbols = find_read_symbols(form.memory)
    at_rest = {DQ: 0}
    for element in form.memory:
        at_rest[element.state] = 0
        at_rest[element.derivative] = 0
    for name in names:
        symbol = sympy.Symbol(name, real=True)
        value = law.values[name]
        slope = form.output.diff(symbol)
        if symbol in memory_symbols or symbol in slope.free_symbols:
            if set(law.structure) <= {"ripple"}:
                lower, upper = sorted((value / _MAX_FACTOR, value * _MAX_FACTOR))
                limits[name] = lower, upper
        elif slope.subs(at_rest) != 0:  # of a torque at rest, whose sign may change
            limits[name] = -np.inf, np.inf
        elif value > 0.0:
            limits[name] = 0.0, np.inf
        else:
            limits[name] = -np.inf, 0.0
    return limits


def _estimate_noise(residual: Array) -> float:
    """Return the standard deviation of independent errors that determine a mean as well."""
    power = float(residual @ residual)
    autocorrelation = 0.0
    if power:
        autocorrelation = float(residual[1:] @ residual[:-1]) / power
    autocorrelation = float(np.clip(autocorrelation, 0.0, _MAX_AUTOCORRELATION))
    widening = float(np.sqrt((1.0 + autocorrelation) / (1.0 - autocorrelation)))
    return rmse(residual) * widening + _MIN_NOISE
