"""ParFam-HX: ParFam-H with the inputs and the memory that measured joints turn out to need."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from hesr_model.friction.audit import explodes
from hesr_model.friction.described import Described
from hesr_model.friction.estimator import register
from hesr_model.friction.evaluate import Array
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.lugre import STATIC_RATIO_BOUNDS
from hesr_model.friction.parfam import calibrate, evolve, family
from hesr_model.friction.parfam.features import HysteresisFeatures
from hesr_model.friction.samples import Samples
from hesr_model.friction.separable import SearchSpace, Separable, left_out_cost
from hesr_model.friction.stribeck import V_S, VELOCITY_BOUNDS
from hesr_model.friction.trained import TrainedRange
from hesr_model.residual import FrictionRecord

MEMORY_BOUNDS = (0.05, 2000.0)
"""Bounds of kappa [1/rad]: from no memory in position to one of a milliradian."""
REST_SPEED = 1e-3
"""Speed below which the state holds [rad/s]."""
UNIT_GAIN = 0.05
"""A unit, five coefficients, stays if it lowers the mean square on left-out rows by this share."""
STATE_GAIN = 0.04
"""So does memory in time beside that in position, two coefficients more."""
_ROWS = 3000


@dataclass(frozen=True, kw_only=True, eq=False)
class _Trial:
    """A structure with its problem and the point found in it."""

    structure: Mapping[str, Any]
    problem: Separable
    point: Array

    def law(self) -> FrictionLaw:
        """Return the law at the point."""
        unknowns, _ = self.problem.solve(self.point)
        values = self.problem.values(self.point, unknowns)
        return FrictionLaw(
            name="trial", structure=self.structure, form=self.problem.form, values=values
        )


@register
class ParFamHX(Described):
    """ParFam-H with a generalised state, load, a Stribeck term, motor ripple and an initial state.

        h'  = alpha gate (tanh(beta v) - h) + kappa (v - |v| h),  gate = 1 - exp(-(v/v_0)^2)
        tau = c . (1, v, h, h', h |tau_load|, h exp(-(v/v_s)^2)) + c_g g(theta . (1, v, h, h'))
              + sum_k a_k cos(k N (q - lag v)) + b_k sin(k N (q - lag v))

    Linear terms, the unit and the ripple's orders stay only where left-out logs gain from them.

    Parameters
    ----------
    memory : use a state with memory in position, otherwise that of eq. 9.
    load : allow the load term.
    bump : allow the Stribeck term.
    functions : functions g that are tried; none for no unit.
    ripple : allow motor ripple.
    initial_state : let the first torque samples of a log set the start of h.
    starts : random starts for each g.
    """

    name = "parfam_hx"
    title = "ParFam-HX"
    equation = (
        "ParFam-H + c_load h |tau_load| + c_bump h exp(-(dq/v_s)^2) + ripple, "
        "h' = alpha gate (tanh(beta dq) - h) + kappa (dq - |dq| h)"
    )

    def __init__(
        self,
        *,
        memory: bool = True,
        load: bool = True,
        bump: bool = True,
        functions: Sequence[str] = ("tanh", "sin"),
        ripple: bool = True,
        initial_state: bool = True,
        starts: int = 24,
    ) -> None:
        self.memory = memory
        self.linear = (
            *family.FEATURES,
            *(["h_load"] if load else []),
            *(["h_bump"] if bump else []),
        )
        self.functions = tuple(functions)
        self.ripple = ripple  # type: ignore[misc] # a switch of this law, fixed in others
        self.start_samples = 5 if initial_state else 0  # type: ignore[misc]
        self.starts = starts

    @staticmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions without ripple."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search state, terms, unit and ripple one after the other (seeded by `rng`)."""
        samples = Samples.of(records, coefficients=len(self.linear) + 6)
        states = ("bristle", "generalised") if self.memory else ("paper",)
        bare = _best([self._bare(state, samples, rng) for state in states], STATE_GAIN)
        trained = TrainedRange.of(records)
        tame = [t for t in self._with_unit(bare, rng) if not explodes(t.law(), trained)]
        best = _best([bare, *tame], UNIT_GAIN)
        return self.finish(best.structure, best.problem, best.problem.polish(best.point))

    def _bare(self, state: str, samples: Samples, rng: np.random.Generator) -> _Trial:
        # A bristle has the Stribeck curve inside, so the term is not needed beside it.
        linear = [x for x in self.linear if state != "bristle" or x != "h_bump"]
        structure = {"linear": linear, "units": [], "state": state}
        problem = self._problem(structure, samples)
        found = problem.search(rng, effort=30)
        return self._thinned(_Trial(structure=structure, problem=problem, point=found))

    def _problem(self, structure: Mapping[str, Any], samples: Samples) -> Separable:
        return Separable(family.form(structure), _space(structure, samples), samples)

    def _thinned(self, trial: _Trial) -> _Trial:
        """Drop linear terms, one after the other, without which left-out logs fare no worse."""
        samples = trial.problem.samples
        columns = trial.problem.columns(trial.point)
        linear = trial.structure["linear"]
        kept = list(range(columns.shape[1]))
        cost = left_out_cost(columns, samples.tau, samples.folds)
        for i in reversed(range(columns.shape[1])):
            # Velocity and the state are what the unit builds on.
            if linear[i] in ("dq", "h", "dh"):
                continue
            fewer = [k for k in kept if k != i]
            without = left_out_cost(columns[:, fewer], samples.tau, samples.folds)
            if without <= cost:
                kept, cost = fewer, without
        structure = {**trial.structure, "linear": [linear[k] for k in kept]}
        problem = self._problem(structure, samples)
        numbers = dict(
            zip(trial.problem.space.names, trial.problem.numbers(trial.point), strict=True)
        )
        return _Trial(
            structure=structure, problem=problem, point=problem.polish(problem.point(numbers))
        )

    def _with_unit(self, bare: _Trial, rng: np.random.Generator) -> list[_Trial]:
        samples = bare.problem.samples
        rows = slice(None, None, max(1, len(samples.tau) // _ROWS))
        columns = bare.problem.columns(bare.point)
        moving = [bare.structure["linear"].index(x) for x in ("dq", "h", "dh")]
        features = np.column_stack([np.ones(len(columns)), columns[:, moving]])
        trials = []
        numbers = dict(zip(bare.problem.space.names, bare.problem.numbers(bare.point), strict=True))
        for g in self.functions:
            starts = evolve.starting_points(rng, self.starts, 4)
            found = evolve.arguments(
                g, features[rows], columns[rows], samples.tau[rows], starts, keep=2
            )
            unit = {"g": g, "arguments": list(family.FEATURES)}
            structure = {**bare.structure, "units": [unit]}
            problem = self._problem(structure, samples)
            for theta in found:
                names = [family.argument_name(1, x) for x in family.FEATURES]
                start = {**numbers, **dict(zip(names, theta, strict=True))}
                point = problem.polish(problem.point(start))
                trials.append(_Trial(structure=structure, problem=problem, point=point))
        return trials


def _best(trials: Sequence[_Trial], gain: float) -> _Trial:
    """Return the trial that predicts left-out rows best; those after the first must gain `gain`."""
    costs = [_left_out(trial) * (1.0 if i == 0 else 1.0 + gain) for i, trial in enumerate(trials)]
    return trials[int(np.argmin(costs))]


def _left_out(trial: _Trial) -> float:
    """Mean square on each fold of the trial refined without it, over all rows."""
    problem = trial.problem
    total = 0.0
    for fold in problem.samples.folds:
        columns = problem.columns(problem.polish(trial.point, evaluations=3, rows=~fold))
        x = np.linalg.lstsq(columns[~fold], problem.samples.tau[~fold])[0]
        total += float(np.sum((problem.samples.tau - columns @ x)[fold] ** 2))
    return total


def _space(structure: Mapping[str, Any], samples: Samples) -> SearchSpace:
    """Return how a structure is searched on given rows."""
    features = HysteresisFeatures(samples=samples, discretisation="exact")
    alpha, beta = calibrate.bounds(features)
    bounds: list[tuple[str, tuple[float, float]]] = []
    values: list[tuple[str, sympy.Expr]] = []
    if structure["state"] == "bristle":
        bounds += [(family.RHO.name, STATIC_RATIO_BOUNDS), (V_S.name, VELOCITY_BOUNDS)]
    else:
        bounds += [("alpha", alpha), ("beta", beta)]
    if structure["state"] != "paper":
        bounds.append((family.KAPPA.name, MEMORY_BOUNDS))
    if structure["state"] == "generalised":
        values.append((family.V_0.name, sympy.Float(REST_SPEED)))
    if "h_bump" in structure["linear"] and structure["state"] != "bristle":
        bounds.append((V_S.name, VELOCITY_BOUNDS))
    linear = [family.linear_name(x) for x in structure["linear"]]
    for k, unit in enumerate(structure["units"], start=1):
        linear.append(family.gain_name(k))
        scales = {"1": 1.0, "dq": float(samples.dq.std()), "h": 1.0, "dh": 1.0}
        for x in unit["arguments"]:
            limit = evolve.ARGUMENT_LIMIT / scales[x]
            bounds.append((family.argument_name(k, x), (-limit, limit)))
    return SearchSpace(bounds=tuple(bounds), linear=tuple(linear), values=tuple(values))
