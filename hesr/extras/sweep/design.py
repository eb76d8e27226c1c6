"""Designs of a sweep: values of the inputs in each run."""

from itertools import product
from math import prod

import numpy as np
from scipy.special import ndtri

from hesr.extras.sweep.study import MOST_RUNS, Correlated, SweepInput, SweepStudy
from hesr_model.errors import ConfigError
from hesr_model.support.arrays import Array

_EDGE = 2.0**-53  # smallest distance to 0 and 1 of the quantiles of a normal distribution


def chosen(study: SweepStudy) -> Array:
    """Return the values of all inputs, (runs, d).

    "sobol" is Saltelli's design: the blocks A, B and, for each input, A with this input from B
    (Comput. Phys. Commun. 181 (2010) 259-270, table 2, radial form).
    """
    unit = _unit(study)
    columns = [_values(one, unit[:, k]) for k, one in enumerate(study.inputs)]
    at = len(columns)
    for group in study.correlated:
        n = len(group.variables)
        columns += list(_correlated(group, unit[:, at : at + n]).T)
        at += n
    return np.column_stack(columns)


def _unit(study: SweepStudy) -> Array:
    d, runs = len(study.names), study.runs or 0
    if study.design == "grid":
        return _grid(study)
    if study.design == "monte_carlo":
        return np.random.default_rng(study.seed).random((runs, d))
    from scipy.stats import qmc  # slow to import

    rng = np.random.default_rng(study.seed)
    if study.design == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(d, rng=rng).random(runs))
    both = np.asarray(qmc.Sobol(2 * d, rng=rng).random(runs))
    a, b = both[:, :d], both[:, d:]
    mixed = [np.where(np.arange(d) == k, b, a) for k in range(d)]
    return np.concatenate([a, b, *mixed])


def _grid(study: SweepStudy) -> Array:
    places = []
    for one in study.inputs:
        n = len(one.values)
        places.append((np.arange(n) + 0.5) / n if n else np.linspace(0.0, 1.0, one.levels))
    if (count := prod(map(len, places))) > MOST_RUNS:
        raise ConfigError(f"the grid of '{study.name}' has {count:.3g} runs; at most {MOST_RUNS}.")
    return np.array(list(product(*places)))


def _values(one: SweepInput, unit: Array) -> Array:
    if one.values:
        listed: Array = np.array(one.values)
        return listed.take((unit * len(listed)).astype(int), mode="clip")
    if one.low is not None and one.high is not None:
        if one.integer:
            low, high = np.ceil(one.low), np.floor(one.high)
            return np.asarray(np.minimum(low + np.floor(unit * (high - low + 1.0)), high))
        return one.low + unit * (one.high - one.low)
    drawn: Array = (one.mean or 0.0) + (one.std or 0.0) * _normal(unit)
    return np.round(drawn) if one.integer else drawn


def _correlated(group: Correlated, unit: Array) -> Array:
    sizes, axes = np.linalg.eigh(np.array(group.covariance))
    root = (axes * np.sqrt(np.maximum(sizes, 0.0))) @ axes.T
    return np.asarray(np.array(group.mean) + _normal(unit) @ root)


def _normal(unit: Array) -> Array:
    return np.asarray(ndtri(np.clip(unit, _EDGE, 1.0 - _EDGE)))
