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
from hesr_model.errors import FitError
from hesr_model.fitting.joint_rows import log_of_rows
from hesr_model.fitting.local_search import search_locally
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse, training_error
from hesr_model.inference.covariance import Covariance
from hesr_model.logs.signals import MOVING
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.support.arrays import Array, Integers

Nuisance = Literal["offset", "level"]
_ROUNDS = 30
_LEAST = 0.2
_MOST = 5.0  # of a level


@dataclass(frozen=True, kw_only=True)
class OwnOfLog:
    """Level of friction [1] and offset [N.m; N] of a log."""

    level: float = 1.0
    offset: float = 0.0


def own_of_logs(
    records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> dict[str, OwnOfLog]:
    """Estimate the nuisances of each log of a joint by name; a single log has none."""
    logs = list(dict.fromkeys(record.log for record in records))
    own = [OwnOfLog() for _ in logs]
    if len(logs) > 1 and wanted:
        log = log_of_rows(records)
        torque = np.concatenate([r.tau for r in records])
        dq = np.concatenate([r.dq for r in records])
        weights = np.bincount(log) / len(log)
        columns = np.column_stack([np.tanh(dq / MOVING), dq, np.ones_like(dq)])
        for _ in range(_ROUNDS):
            level, offset = _of_rows(own, log)
            law = np.linalg.lstsq(level[:, None] * columns, torque - offset, rcond=None)[0]
            own = _fitted(columns @ law, torque, log, wanted)
            mean = (
                float(weights @ [nuisances.level for nuisances in own])
                if "level" in wanted
                else 1.0
            )
            shift = (
                float(weights @ [nuisances.offset for nuisances in own])
                if "offset" in wanted
                else 0.0
            )
            own = [
                OwnOfLog(level=nuisances.level / mean, offset=nuisances.offset - shift)
                for nuisances in own
            ]
    return dict(zip(logs, own, strict=True))


def remove_nuisances(
    records: Sequence[FrictionRecord], own: Mapping[str, OwnOfLog]
) -> list[FrictionRecord]:
    """Return records without the nuisances of their logs."""
    return [
        replace(record, tau=(record.tau - own[record.log].offset) / own[record.log].level)
        for record in records
    ]


def add_fitted_nuisances(
    predicted: Sequence[Array], records: Sequence[FrictionRecord], wanted: Sequence[Nuisance]
) -> list[Array]:
    """Return predictions (N,) [N.m] with fitted nuisances of each log; these are not blind."""
    log = log_of_rows(records)
    whole = np.concatenate(predicted)
    own = _fitted(whole, np.concatenate([record.tau for record in records]), log, wanted)
    ends = np.cumsum([len(torque) for torque in predicted])
    level, offset = _of_rows(own, log)
    return np.split(level * whole + offset, ends[:-1])


def _of_rows(own: Sequence[OwnOfLog], log: Integers) -> Array:
    return np.array([[nuisances.level, nuisances.offset] for nuisances in own])[log].T


def _fitted(
    predicted: Array, torque: Array, log: Integers, wanted: Sequence[Nuisance]
) -> list[OwnOfLog]:
    rows = (log == k for k in range(log[-1] + 1))
    return [own_of_log(predicted[own], torque[own], wanted) for own in rows]


def own_of_log(predicted: Array, torque: Array, wanted: Sequence[Nuisance]) -> OwnOfLog:
    """Solve for the nuisances of a log, from predicted and measured torque (N,) [N.m]."""
    if "level" not in wanted:
        return OwnOfLog(offset=float(np.mean(torque - predicted)))
    columns = [predicted, np.ones_like(predicted)][: 2 if "offset" in wanted else 1]
    x = np.linalg.lstsq(np.column_stack(columns), torque, rcond=None)[0]
    level = float(np.clip(x[0], _LEAST, _MOST))
    offset = float(np.mean(torque - level * predicted)) if "offset" in wanted else 0.0
    return OwnOfLog(level=level, offset=offset)


_NOISE_ROUNDS = 3  # of the noise
_FACTOR = 2.0  # largest change of coefficients within memory or a function
_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the change, tried until the law is passive
_RANK = 1e-8  # relative variance of directions that the earlier fits do not know
_MOST_MEMORY = 0.995  # largest autocorrelation
_LEAST_NOISE = 1e-12  # [N.m] of the noise


def prior_of(models: Sequence[FrictionModel]) -> FrictionModel:
    """Return a model whose laws have mean and spread of those of `models`, for a further day.

    The covariance is the mean one plus (1 + 1/K) times the scatter of K models of one structure.

    Raises FitError for laws without a covariance, or of different joints or structures.
    """
    first = models[0]
    for model in models:
        if model.thermal or any(law.covariance is None for law in model.laws):
            raise FitError(
                f"friction model '{model.law}': its coefficients have no covariance or depend on "
                "temperature; adapt laws of 'hesr fit', other than networks and 'temperature'."
            )
        if _kind(model) != _kind(first):
            raise FitError(
                f"friction model '{model.law}': joints or structures of its laws differ from the "
                "first; adapt the first to the logs of the second instead."
            )
    if len(models) == 1:
        return first
    laws = [_mean(of_joint) for of_joint in zip(*(model.laws for model in models), strict=True)]
    return replace(first, laws=tuple(laws))


def _kind(model: FrictionModel) -> tuple[object, ...]:
    return model.joints, model.coupling, [(law.name, law.form) for law in model.laws]


def _mean(laws: Sequence[FrictionLaw]) -> FrictionLaw:
    known = [law.covariance for law in laws if law.covariance is not None]
    names = [n for n in known[0].names if all(n in covariance.names for covariance in known)]
    places = [[covariance.names.index(n) for n in names] for covariance in known]
    own = [covariance.matrix[np.ix_(at, at)] for covariance, at in zip(known, places, strict=True)]
    values = np.array([[law.values[n] for n in names] for law in laws])
    scatter = np.atleast_2d(np.cov(values, rowvar=False))
    mean = dict(zip(names, map(float, values.mean(axis=0)), strict=True))
    return _with(laws[0], mean, np.mean(own, axis=0) + (1.0 + 1.0 / len(laws)) * scatter)


def _with(law: FrictionLaw, values: Mapping[str, float], covariance: Array) -> FrictionLaw:
    none = np.zeros_like(covariance)
    names = tuple(values)
    found = Covariance(names=names, within=covariance, between=1.0, degrees=0.0, carried=none)
    errors = dict(zip(values, map(float, found.standard_errors), strict=True))
    stated = {n: errors[n] for n in law.standard_errors if n in errors}
    return replace(law, values={**law.values, **values}, covariance=found, standard_errors=stated)


def adapt(
    prior: FrictionModel, records: Sequence[Sequence[FrictionRecord]]
) -> tuple[FrictionModel, list[str]]:
    """Adapt the laws of `prior_of` to records [joint][log]; return them and a sentence per joint.

    Raises FitError if the joints differ.
    """
    joints = tuple(joint_records[0].joint for joint_records in records)
    if joints != prior.joints:
        raise FitError(
            f"the log has the joints {', '.join(joints)}, but the prior {', '.join(prior.joints)}."
        )
    moved = all_at_friction(records)
    laws = [_adapt_law(prior, k, joint_records) for k, joint_records in enumerate(moved)]
    errors = tuple(map(training_error, laws, moved))
    seconds = sum(float(np.ptp(record.t)) for record in moved[0])
    model = replace(prior, laws=tuple(laws), training_rmse=errors, left_out_rmse=())
    return model, [
        f"{joint}: error over {seconds:.3g} s {training_error(law, joint_records):.3g} -> "
        f"{error:.3g}"
        for joint, law, joint_records, error in zip(joints, prior.laws, moved, errors, strict=True)
    ]


def _adapt_law(prior: FrictionModel, k: int, records: Sequence[FrictionRecord]) -> FrictionLaw:
    law = prior.laws[k]
    covariance = law.covariance
    assert covariance is not None
    limits = _limits(law, covariance.names)
    if not limits:
        return law
    names, (low, high) = tuple(limits), np.array(list(limits.values())).T
    first = np.array([law.values[n] for n in names])
    known = covariance.of_another_log
    sizes = np.sqrt(np.maximum(np.diag(known), np.finfo(float).tiny))
    shares, ways = np.linalg.eigh(known / np.outer(sizes, sizes))
    root = (ways / np.sqrt(np.maximum(shares, _RANK * shares[-1]))).T / sizes  # root' root = P^-1
    adapted = [covariance.names.index(name) for name in names]
    root, sizes = root[:, adapted], sizes[adapted]

    def at(point: Array) -> FrictionLaw:
        moved = dict(zip(names, map(float, point), strict=True))
        return replace(law, values={**law.values, **moved})

    def error(point: Array) -> Array:
        moved = at(point)
        return np.concatenate([predict_record(moved, record) - record.tau for record in records])

    torque = np.concatenate([record.tau for record in records])
    best = first
    for _ in range(_NOISE_ROUNDS):
        noise = _noise(error(best))

        def residual(point: Array, noise: float = noise) -> Array:
            return np.concatenate([error(point) / noise, root @ (point - first)])

        found = search_locally(
            residual,
            best,
            bounds=(low, high),
            scale=sizes,
            magnitude=float(np.linalg.norm(torque) / noise),
            evaluations=20,
        )
        best = found.x
    if prior.trained and certify(law, prior.trained[k]).verdict == "proven":
        tried = (first + share * (best - first) for share in _SHARES)
        passive = (x for x in tried if certify(at(x), prior.trained[k]).verdict == "proven")
        best = next(passive, first)
    moved = dict(zip(names, map(float, best), strict=True))
    return _with(law, moved, np.linalg.pinv(found.jac.T @ found.jac, hermitian=True))


def _limits(law: FrictionLaw, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return bounds of adapted coefficients: half to twice if nonlinear, else of the same sign."""
    form = law.form
    found = {}
    memory = set().union(*(part.free_symbols for element in form.memory for part in element.parts))
    still = {
        DQ: 0,
        **{s: 0 for element in form.memory for s in (element.state, element.derivative)},
    }
    for name in names:
        symbol = sympy.Symbol(name, real=True)
        value = law.values[name]
        slope = form.output.diff(symbol)
        if symbol in memory or symbol in slope.free_symbols:
            if set(law.structure) <= {"ripple"}:
                low, high = sorted((value / _FACTOR, value * _FACTOR))
                found[name] = low, high
        elif slope.subs(still) != 0:
            found[name] = -np.inf, np.inf
        else:
            found[name] = (0.0, np.inf) if value > 0.0 else (-np.inf, 0.0)
    return found


def _noise(residual: Array) -> float:
    """Return the standard deviation of independent errors that determine a mean as well."""
    power = float(residual @ residual)
    memory = float(residual[1:] @ residual[:-1]) / power if power else 0.0
    memory = float(np.clip(memory, 0.0, _MOST_MEMORY))
    return rmse(residual) * float(np.sqrt((1.0 + memory) / (1.0 - memory))) + _LEAST_NOISE
