"""Adaptation of a fitted law to seconds of a new log: its coefficients' covariance is the prior.

    minimise    sum_t (tau_t - f_t(c))^2 / s^2  +  (c - c_0)' P^-1 (c - c_0)
    s^2 = (1 + r) / (1 - r) of the residual's mean square,    r: its autocorrelation at one sample

c are the coefficients, c_0 those of an earlier fit and P their covariance in another log, or mean
and spread of several fits; nonlinear ones of a structure that the data chose are held. The maximum
a posteriori is found within bounds, and drawn towards c_0 until the law is proven passive if that
of c_0 is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import sympy
from scipy.optimize import least_squares

from hesr_model.audit.certificate import certify
from hesr_model.errors import FitError
from hesr_model.friction.inputs import DQ
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import predict_record, rmse, training_error
from hesr_model.inference.covariance import Covariance
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.support.arrays import Array

_ROUNDS = 3  # of the noise
_FACTOR = 2.0  # largest change of coefficients within memory or a function
_SHARES = (1.0, 0.5, 0.25, 0.1)  # of the change, tried until the law is passive
_RANK = 1e-8  # relative variance of directions that the earlier fits do not know
_MOST_MEMORY = 0.995  # largest autocorrelation
_LEAST = 1e-12  # [N.m] of the noise


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
    names = [n for n in known[0].names if all(n in one.names for one in known)]
    places = [[one.names.index(n) for n in names] for one in known]
    own = [one.matrix[np.ix_(at, at)] for one, at in zip(known, places, strict=True)]
    values = np.array([[law.values[n] for n in names] for law in laws])
    scatter = np.atleast_2d(np.cov(values, rowvar=False))
    mean = dict(zip(names, map(float, values.mean(axis=0)), strict=True))
    covariance = np.mean(own, axis=0) + (1.0 + 1.0 / len(laws)) * scatter
    return _with(laws[0], mean, covariance)


def _with(law: FrictionLaw, values: Mapping[str, float], covariance: Array) -> FrictionLaw:
    none = np.zeros_like(covariance)
    found = Covariance(
        names=tuple(values), within=covariance, between=1.0, degrees=0.0, carried=none
    )
    errors = dict(zip(values, map(float, found.standard_errors), strict=True))
    stated = {n: errors[n] for n in law.standard_errors if n in errors}
    return replace(law, values={**law.values, **values}, covariance=found, standard_errors=stated)


def adapt(
    prior: FrictionModel, records: Sequence[Sequence[FrictionRecord]]
) -> tuple[FrictionModel, list[str]]:
    """Adapt the laws of `prior_of` to records [joint][log]; return them and a sentence per joint.

    Raises FitError if joints differ.
    """
    if (joints := tuple(of_joint[0].joint for of_joint in records)) != prior.joints:
        raise FitError(
            f"the log has the joints {', '.join(joints)}, but the prior {', '.join(prior.joints)}."
        )
    moved = all_at_friction(records)
    laws = [_adapted(prior, k, of_joint) for k, of_joint in enumerate(moved)]
    errors = tuple(map(training_error, laws, moved))
    seconds = sum(float(np.ptp(r.t)) for r in moved[0])
    model = replace(prior, laws=tuple(laws), training_rmse=errors, left_out_rmse=())
    return model, [
        f"{joint}: error over {seconds:.3g} s {training_error(law, of_joint):.3g} -> {error:.3g}"
        for joint, law, of_joint, error in zip(joints, prior.laws, moved, errors, strict=True)
    ]


def _adapted(prior: FrictionModel, k: int, records: Sequence[FrictionRecord]) -> FrictionLaw:
    law = prior.laws[k]
    covariance = law.covariance
    if covariance is None:
        raise TypeError("the prior needs a covariance")
    if not (limits := _limits(law, covariance.names)):
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
        return np.concatenate([predict_record(moved, r) - r.tau for r in records])

    best = first
    for _ in range(_ROUNDS):
        noise = _noise(error(best))

        def residual(point: Array, noise: float = noise) -> Array:
            return np.concatenate([error(point) / noise, root @ (point - first)])

        found = least_squares(
            residual, best, bounds=(low, high), x_scale=sizes, diff_step=1e-6, max_nfev=20
        )
        best = found.x
    if prior.trained and certify(law, prior.trained[k]).verdict == "proven":
        tried = (first + share * (best - first) for share in _SHARES)
        passive = (x for x in tried if certify(at(x), prior.trained[k]).verdict == "proven")
        best = next(passive, first)
    moved = dict(zip(names, map(float, best), strict=True))
    return _with(law, moved, np.linalg.pinv(found.jac.T @ found.jac, hermitian=True))


def _limits(law: FrictionLaw, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Return the bounds of each coefficient that is adapted.

    Nonlinear ones stay between half and twice their value, others keep their sign, but for offset
    and ripple: torques at rest without memory.
    """
    form, found = law.form, {}
    memory = set().union(*(part.free_symbols for m in form.memory for part in m.parts))
    still = {DQ: 0, **{s: 0 for m in form.memory for s in (m.state, m.derivative)}}
    for name in names:
        symbol, value = sympy.Symbol(name, real=True), law.values[name]
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
    return rmse(residual) * float(np.sqrt((1.0 + memory) / (1.0 - memory))) + _LEAST
