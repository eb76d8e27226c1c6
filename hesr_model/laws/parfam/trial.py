"""Structures of the family as separable problems, and their selection by cross-validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from hesr_model.audit.audit import explodes
from hesr_model.equations.memory import Discretisation
from hesr_model.fitting.joint_rows import JointRows, find_first_best
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.laws.parfam import calibrate, evolve, family
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.stribeck import V_S, VELOCITY_BOUNDS
from hesr_model.logs.rest import MOVING
from hesr_model.support.arrays import Array

MEMORY_BOUNDS = (0.05, 2000.0)  # [1/rad] kappa: none to a milliradian
REST_SPEED = 1e-3  # [rad/s] below which the state holds
BUMP_BOUNDS = (MOVING, VELOCITY_BOUNDS[1])  # [rad/s]; a narrower bump acts at rest alone
DIVISOR_LIMIT = 0.9  # largest deviation from 1
_SEARCH_ROWS = 3000
MIN_UNIT_GAIN = 0.05  # smallest relative gain on left-out rows


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """A structure with its problem and solution."""

    structure: Mapping[str, Any]
    problem: Separable
    point: Array

    def change_structure(
        self, structure: Mapping[str, Any], extra_numbers: Mapping[str, float]
    ) -> "Trial":
        """Return the trial of another structure, polished from these and `extra_numbers`."""
        problem = pose(structure, self.problem.rows, self.problem.discretisation)
        names = problem.space.names
        numbers = (
            dict.fromkeys(names, 0.0) | self.problem.name_numbers(self.point) | dict(extra_numbers)
        )
        point = problem.polish(problem.point({name: numbers[name] for name in names}))
        return Trial(structure=structure, problem=problem, point=point)

    def law(self) -> FrictionLaw:
        """Return the law at the point."""
        return self.problem.law(self.point, "trial", self.structure)


def pose(
    structure: Mapping[str, Any], rows: JointRows, discretisation: Discretisation = "exact"
) -> Separable:
    """Return the least-squares problem of a structure."""
    space = search_space(structure, rows)
    return Separable(family.form(structure), space, rows, discretisation)


def add_unit(
    trial: Trial, features: Array, functions: Sequence[str], starts: int, rng: np.random.Generator
) -> list[Trial]:
    """Return the trial with a further unit g, with the two best arguments of every g."""
    tau = trial.problem.rows.tau
    searched_rows = slice(None, None, max(1, len(tau) // _SEARCH_ROWS))
    columns = trial.problem.columns(trial.point)[searched_rows]
    units = list(trial.structure["units"])
    names = [family.argument_name(len(units) + 1, x) for x in family.FEATURES]
    extended_trials = []
    for g in functions:
        theta_starts = evolve.starting_points(rng, starts, 4)
        unit = {"g": g, "arguments": list(family.FEATURES)}
        structure = {**trial.structure, "units": [*units, unit]}
        extended_trials += [
            trial.change_structure(structure, dict(zip(names, theta, strict=True)))
            for theta in evolve.search_arguments(
                g, features[searched_rows], columns, tau[searched_rows], theta_starts, keep=2
            )
        ]
    return extended_trials


def choose(trials: Sequence[Trial], gain: float) -> Trial:
    """Return the trial that predicts left-out rows best; all but the first must gain `gain`."""
    first, *others = trials
    costs = [cross_validate(first)]
    costs += [cross_validate(trial) * (1.0 + gain) for trial in others]
    return trials[find_first_best(costs)]


def extend_trial(base: Trial, candidates: Sequence[Trial], trained_range: TrainedRange) -> Trial:
    """Return the best of `candidates` on left-out rows that stays in bounds, or `base`."""
    return choose(
        [base, *(trial for trial in candidates if not explodes(trial.law(), trained_range))],
        MIN_UNIT_GAIN,
    )


def cross_validate(trial: Trial) -> float:
    """Return the sum of squared errors by cross-validation."""
    problem = trial.problem
    total = 0.0
    for fold in problem.rows.folds:
        columns = problem.columns(problem.polish(trial.point, evaluations=3, is_used=~fold))
        x = np.linalg.lstsq(columns[~fold], problem.rows.tau[~fold])[0]
        total += float(np.sum((problem.rows.tau - columns @ x)[fold] ** 2))
    return total


def search_space(structure: Mapping[str, Any], rows: JointRows) -> SearchSpace:
    """Return the search space of a structure."""
    state = structure.get("state", "paper")
    alpha, beta = calibrate.bounds(HysteresisFeatures(rows=rows, discretisation="exact"))
    bounds: list[tuple[str, tuple[float, float]]] = []
    values: list[tuple[str, sympy.Expr]] = []
    if state == "bristle":
        bounds += [(family.RHO.name, STATIC_RATIO_BOUNDS), (V_S.name, VELOCITY_BOUNDS)]
    else:
        bounds += [("alpha", alpha), ("beta", beta)]
    if state != "paper":
        bounds.append((family.KAPPA.name, MEMORY_BOUNDS))
    if state == "generalised":
        values.append((family.V_0.name, sympy.Float(REST_SPEED)))
    if "h_bump" in structure["linear"] and state != "bristle":
        bounds.append((V_S.name, BUMP_BOUNDS))
    linear = [family.linear_name(x) for x in structure["linear"]]
    for k, unit in enumerate(structure["units"], start=1):
        linear.append(family.gain_name(k))
        scales = {"1": 1.0, "dq": float(rows.dq.std()), "h": 1.0, "dh": 1.0}
        for x in unit["arguments"]:
            limit = evolve.ARGUMENT_LIMIT / scales[x]
            bounds.append((family.argument_name(k, x), (-limit, limit)))
    for x in structure.get("denominator", ()):
        # The sum of all terms stays below DIVISOR_LIMIT.
        largest = float(np.abs(rows.dq).max()) if x == "dq" else 1.0
        limit = DIVISOR_LIMIT / len(structure["denominator"]) / largest
        bounds.append((family.denominator_name(x), (-limit, limit)))
    return SearchSpace(bounds=tuple(bounds), linear=tuple(linear), values=tuple(values))
