"""Columns of stops and viscous terms over the rows of a joint."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.law import LawForm
from hesr_model.laws.stops.form import (
    DEFLECTIONS,
    LOAD_SCALE,
    SHARES,
    THINNING,
    Structure,
    start_at_rest,
)
from hesr_model.support.arrays import Array

_ANY = (1e-12, 1e12)
VISCOUS = ("1", "v", *SHARES)  # terms of f


def every(kind: str) -> Structure:
    """Return all stops with one bound."""
    return Structure(stops=tuple((kind, node) for node in range(len(DEFLECTIONS))))


def fixed(samples: JointRows) -> dict[str, float]:
    """Return the coefficients that follow from the largest load and speed of a joint."""
    load = float(np.max(np.abs(samples.tau_load)))
    speed = float(np.max(np.abs(samples.dq)))
    thin = {THINNING[k].name: share * speed for k, share in SHARES.items()}
    return {LOAD_SCALE.name: load if load > 0.0 else 1.0, **thin}


def weights(samples: JointRows) -> Array:
    """Return (N,) weights: 0 while the unknown initial deflections of a record matter, then 1.

    A displacement of twice the widest deflection erases them.
    """
    found = np.empty(len(samples.q))
    first = np.flatnonzero(samples.begins)
    for start, end in zip(first, [*first[1:], len(found)], strict=True):
        q = samples.q[start:end]
        way = np.maximum.accumulate(q) - np.minimum.accumulate(q)
        forgotten = way > 2.0 * DEFLECTIONS[-1]
        found[start:end] = forgotten if forgotten.any() else 1.0
    return found


def columns(structure: Structure, numbers: Mapping[str, float], samples: JointRows) -> Array:
    """Return the (N, K) columns [N.m per unit] of a structure's forces and waves."""
    form, space = _posed(structure)
    problem = Separable(form, space, samples, start=start_at_rest(form))
    return problem.columns(problem.point({name: numbers[name] for name in space.names}))[:, :-1]


@lru_cache(maxsize=64)
def _posed(structure: Structure) -> tuple[LawForm, SearchSpace]:
    form = structure.form()
    linear = (*structure.forces, *structure.waves, "tau_0")
    others = tuple((c.name, _ANY) for c in form.coefficients if c.name not in linear)
    return form, SearchSpace(bounds=others, linear=linear)
