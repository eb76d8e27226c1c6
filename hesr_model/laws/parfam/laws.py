"""ParFam-H, the symbolic law of the paper in three stages; its ablation and its extension."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.errors import FitError
from hesr_model.fitting.declarative import DeclarativeEstimator
from hesr_model.fitting.estimator import Estimator, register
from hesr_model.fitting.joint_rows import JointRows, find_first_best, is_no_worse
from hesr_model.fitting.separable import SearchSpace, Separable, left_out_cost
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate, evolve, family, refine
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.trial import Trial, add_unit, choose, extend_trial, pose
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.progress import step

COEFFICIENTS = 11  # alpha, beta, 4 linear, gain, 4 of the argument


@register
@dataclass(kw_only=True, eq=False)
class ParFamH(Estimator):
    """tau = Q(v, h, h', g(Q(v, h, h'))) with polynomials of degree one (eq. 11)."""

    name = "parfam_h"
    title = "ParFam-H"
    order = 130
    quick = True
    paper = 1
    adds = ("parfam_v", "hysteresis state")
    typical: ClassVar[Mapping[str, Any]] = {
        "linear": list(family.FEATURES),
        "units": [{"g": "tanh", "arguments": list(family.FEATURES)}],
    }
    form = staticmethod(family.form)

    search: Literal["projection", "paper"] = "projection"  # paper: geometric stage 1 and eq. 12
    functions: Sequence[str] = ("tanh", "sin", "exp")  # candidates g; sin includes cos
    discretisation: Discretisation = "exact"
    cells: int = 10  # number of (alpha, beta)
    starts: int = 16  # random ones for each of them and each g
    candidates: int = 8  # laws of each g for stage 3
    units: int = 1  # at most, 1 or 2
    denominator: bool = False  # slow and rarely helps

    def __post_init__(self) -> None:
        unknown = sorted(set(self.functions) - set(family.FUNCTIONS))
        if unknown:
            known_names = ", ".join(family.FUNCTIONS)
            raise FitError(f"ParFam function '{unknown[0]}' is unknown; known are {known_names}.")
        if self.search == "paper" and not self.functions:
            raise FitError("ParFam option 'functions' is empty; the paper's search needs one.")
        for option, setting, allowed in (
            ("search", self.search, ("projection", "paper")),
            ("discretisation", self.discretisation, ("exact", "euler")),
            ("units", self.units, (1, 2)),
        ):
            if setting not in allowed:
                raise FitError(
                    f"ParFam option '{option}' is {setting!r}; allowed are "
                    f"{', '.join(map(str, allowed))}."
                )
        for option in ("cells", "starts", "candidates"):
            count = getattr(self, option)
            if count < 1:
                raise FitError(f"ParFam option '{option}' is {count}; expected at least 1.")

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Run the three stages, with starts and hops drawn from `rng`."""
        rows = JointRows.from_records(records, coefficients=COEFFICIENTS)
        features = HysteresisFeatures(rows=rows, discretisation=self.discretisation)
        trained_range = TrainedRange.from_records(records)
        if self.search == "paper":
            candidates = self._search_like_paper(features, rng)
        else:
            candidates = self._evolve(features, rng)
        chosen = refine.select(features, candidates, rows.folds, trained_range)
        law = chosen.to_canonical().law(self.name, self.discretisation)
        return self._enlarge_law(law, features, trained_range, rng)

    def _enlarge_law(
        self,
        law: FrictionLaw,
        features: HysteresisFeatures,
        trained_range: TrainedRange,
        rng: np.random.Generator,
    ) -> FrictionLaw:
        # A law without a state has no (alpha, beta).
        if (self.units < 2 and not self.denominator) or "alpha" not in law.values:
            return law
        problem = pose(law.structure, features.rows, self.discretisation)
        point = problem.point({name: law.values[name] for name in problem.space.names})
        best = Trial(structure=law.structure, problem=problem, point=point)
        if self.units > 1:
            columns = features.columns(law.values["alpha"], law.values["beta"])
            trials = add_unit(best, columns, self.functions, self.starts, rng)
            best = extend_trial(best, trials, trained_range)
        if self.denominator:
            rational = best.change_structure(
                {**best.structure, "denominator": list(family.DIVISORS)}, {}
            )
            best = extend_trial(best, [rational], trained_range)
        if best.structure == law.structure:
            return law
        return replace(best.law(), name=self.name)

    def _evolve(self, features: HysteresisFeatures, rng: np.random.Generator) -> list[Candidate]:
        tau = features.rows.tau
        searched_rows = slice(None, None, max(1, len(tau) // evolve.ROWS))
        candidates: list[Candidate] = []
        cells = calibrate.select_distinct(calibrate.compute_profile(features), self.cells)
        searches = len(cells) * len(self.functions)
        for i, cell in enumerate(cells):
            columns = features.columns(cell.alpha, cell.beta)[searched_rows]
            candidates.append(evolve.fit_linear(cell, columns, tau[searched_rows]))
            for k, g in enumerate(self.functions):
                step(i * len(self.functions) + k, 2 * searches)  # the second half is stage 3
                starts = evolve.starting_points(rng, self.starts, 4)
                candidates += evolve.search(cell, g, columns, tau[searched_rows], starts, keep=3)
        candidates.sort(key=lambda candidate: candidate.cost)
        shortlist: list[Candidate] = []
        for function in (None, *self.functions):
            group = [candidate for candidate in candidates if candidate.g == function]
            shortlist += group[: self.candidates]
        aliases: list[Candidate] = []
        for candidate in shortlist:
            columns = features.columns(candidate.alpha, candidate.beta)[searched_rows]
            aliases += evolve.search_aliases(candidate, columns, tau[searched_rows])
        return shortlist + aliases

    def _search_like_paper(
        self, features: HysteresisFeatures, rng: np.random.Generator
    ) -> list[Candidate]:
        alpha, beta = calibrate.estimate_from_loop(features)
        cell = Cell(alpha=alpha, beta=beta, cost=np.nan)
        columns = features.columns(alpha, beta)
        return [
            evolve.search_of_paper(cell, g, columns, features.rows.tau, rng) for g in self.functions
        ]


FEATURES = ("1", "dq")
MAX_STEEPNESS = 2000.0  # slope of an argument, times the typical speed
_SEARCH_ROWS = 1200


@register
@dataclass(kw_only=True, eq=False)
class ParFamV(DeclarativeEstimator):
    """tau = c . (1, v) + c_g g(theta . (1, v))  (eq. 11 with x = v)."""

    name = "parfam_v"
    title = "ParFam-V"
    order = 20
    paper = 5
    typical: ClassVar[Mapping[str, Any]] = {
        "linear": ["1", "dq"],
        "units": [{"g": "tanh", "arguments": ["1", "dq"]}],
    }
    core = staticmethod(family.form)

    functions: Sequence[str] = ("tanh", "sin")  # candidates g
    starts: int = 16  # random ones per g, and as many steep ones, since friction jumps at rest

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search the unit's argument for every g; cross-validation selects one."""
        rows = JointRows.from_records(records, coefficients=5)
        x = np.column_stack([np.ones(len(rows.dq)), rows.dq])
        searched_rows = slice(None, None, max(1, len(x) // _SEARCH_ROWS))
        solutions = []
        for g in self.functions:
            structure = {"linear": list(FEATURES), "units": [{"g": g, "arguments": list(FEATURES)}]}
            problem = Separable(family.form(structure), _space(rows), rows)
            starts = evolve.starting_points(rng, 2 * self.starts, 2)
            limit = evolve.ARGUMENT_LIMIT
            if g == "tanh":
                starts[self.starts :, 1] *= np.geomspace(2.0, MAX_STEEPNESS, self.starts)
                limit = MAX_STEEPNESS
            features = x[searched_rows]
            tau = rows.tau[searched_rows]
            for theta in evolve.search_arguments(
                g, features, features, tau, starts, keep=3, limit=limit
            ):
                start = problem.point({"theta1_0": theta[0], "theta1_dq": theta[1]})
                point = problem.polish(start, evaluations=30)
                cost = left_out_cost(problem.columns(point), rows.tau, rows.folds)
                solutions.append((cost, structure, problem, point))
        _, structure, problem, point = solutions[find_first_best([cost for cost, *_ in solutions])]
        return self.finish(structure, problem, point)


def _space(rows: JointRows) -> SearchSpace:
    limit = MAX_STEEPNESS / float(np.sqrt(np.mean(rows.dq**2)))
    bound = evolve.ARGUMENT_LIMIT
    return SearchSpace(
        bounds=(("theta1_0", (-bound, bound)), ("theta1_dq", (-limit, limit))),
        linear=("c_0", "c_dq", "c_g1"),
    )


MIN_STATE_GAIN = 0.02  # smallest relative gain by memory in time: 1 % for each of two coefficients


@register
class ParFamHX(DeclarativeEstimator):
    """ParFam-H with a generalised state, load, a Stribeck term, motor ripple and an initial state.

        h'  = alpha gate (tanh(beta v) - h) + kappa (v - |v| h),  gate = 1 - exp(-(v/v_0)^2)
        tau = c . (1, v, h, h', h |tau_load|, h exp(-(v/v_s)^2)) + c_g g(theta . (1, v, h, h'))
              + sum_k a_k cos(k N (q - lag v)) + b_k sin(k N (q - lag v))

    Cross-validation selects linear terms, the unit and the orders of ripple. `memory` allows that
    in position, `bump` the Stribeck term, `initial_state` a start of h from the first torques.
    """

    name = "parfam_hx"
    title = "ParFam-HX"
    order = 160
    proposed = True
    adds = ("parfam_h", "memory in position, load and ripple")
    typical: ClassVar[Mapping[str, Any]] = {
        "linear": ["1", "dq", "h", "dh", "h_load", "h_bump"],
        "units": [],
        "state": "generalised",
    }
    core = staticmethod(family.form)

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
        linear = list(family.FEATURES)
        if load:
            linear.append("h_load")
        if bump:
            linear.append("h_bump")
        self.linear = tuple(linear)
        self.functions = tuple(functions)
        self.ripple = ripple  # type: ignore[misc] # an option of this law, a constant in others
        self.start_samples = 5 if initial_state else 0  # type: ignore[misc] # likewise
        self.starts = starts

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search state, terms, unit and ripple in turn (seeded by `rng`)."""
        rows = JointRows.from_records(records, coefficients=len(self.linear) + 6)
        states = ("bristle", "generalised") if self.memory else ("paper",)
        base_trial = choose(
            [self._fit_without_unit(state, rows, rng) for state in states], MIN_STATE_GAIN
        )
        columns = base_trial.problem.columns(base_trial.point)
        moving_columns = [base_trial.structure["linear"].index(x) for x in ("dq", "h", "dh")]
        features = np.column_stack([np.ones(len(columns)), columns[:, moving_columns]])
        trained_range = TrainedRange.from_records(records)
        best = extend_trial(
            base_trial,
            add_unit(base_trial, features, self.functions, self.starts, rng),
            trained_range,
        )
        return self.finish(best.structure, best.problem, best.problem.polish(best.point))

    def _fit_without_unit(self, state: str, rows: JointRows, rng: np.random.Generator) -> Trial:
        # A bristle contains the Stribeck curve.
        linear = [x for x in self.linear if state != "bristle" or x != "h_bump"]
        structure = {"linear": linear, "units": [], "state": state}
        problem = pose(structure, rows)
        point = problem.search(rng, effort=30)
        return self._remove_useless_terms(Trial(structure=structure, problem=problem, point=point))

    def _remove_useless_terms(self, trial: Trial) -> Trial:
        rows = trial.problem.rows
        columns = trial.problem.columns(trial.point)
        linear = trial.structure["linear"]
        remaining_terms = list(range(columns.shape[1]))
        cost = left_out_cost(columns, rows.tau, rows.folds)
        for i in reversed(range(columns.shape[1])):
            if linear[i] in ("dq", "h", "dh"):
                continue
            fewer_terms = [k for k in remaining_terms if k != i]
            reduced_cost = left_out_cost(columns[:, fewer_terms], rows.tau, rows.folds)
            if is_no_worse(reduced_cost, cost):
                remaining_terms = fewer_terms
                cost = reduced_cost
        return trial.change_structure(
            {**trial.structure, "linear": [linear[k] for k in remaining_terms]}, {}
        )
