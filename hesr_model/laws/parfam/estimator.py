"""ParFam-H: the symbolic friction law of the paper, found in three stages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from hesr_model.equations.memory import Discretisation
from hesr_model.errors import FitError
from hesr_model.fitting.estimator import Estimator, register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate, evolve, family, paper, refine
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.trial import Trial, extended, pose, with_unit
from hesr_model.rigid_body.residual import FrictionRecord
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

    search: Literal["projection", "paper"] = "projection"  # paper: geometric stage 1 and eq. 12
    functions: Sequence[str] = ("tanh", "sin", "exp")  # candidates g; sin includes cos
    discretisation: Discretisation = "exact"
    cells: int = 10  # number of (alpha, beta)
    starts: int = 16  # random ones for each of them and each g
    candidates: int = 8  # laws of each g for stage 3
    units: int = 1  # at most, 1 or 2
    denominator: bool = False  # slow and rarely helps

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.functions) - set(family.FUNCTIONS)):
            known = ", ".join(family.FUNCTIONS)
            raise FitError(f"ParFam function '{unknown[0]}' is unknown; known are {known}.")
        if self.search == "paper" and not self.functions:
            raise FitError("ParFam option 'functions' is empty; the paper's search needs one.")
        for option, found, allowed in (
            ("search", self.search, ("projection", "paper")),
            ("discretisation", self.discretisation, ("exact", "euler")),
            ("units", self.units, (1, 2)),
        ):
            if found not in allowed:
                raise FitError(
                    f"ParFam option '{option}' is {found!r}; allowed are "
                    f"{', '.join(map(str, allowed))}."
                )
        for option in ("cells", "starts", "candidates"):
            if (count := getattr(self, option)) < 1:
                raise FitError(f"ParFam option '{option}' is {count}; expected at least 1.")

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of a structure of the family."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Run the three stages, with starts and hops drawn from `rng`."""
        samples = JointRows.of(records, coefficients=COEFFICIENTS)
        features = HysteresisFeatures(samples=samples, discretisation=self.discretisation)
        search = self._paper if self.search == "paper" else self._evolve
        trained = TrainedRange.of(records)
        chosen = refine.select(features, search(features, rng), samples.folds, trained)
        law = chosen.canonical().law(self.name, self.discretisation)
        return self._enlarged(law, features, trained, rng)

    def _enlarged(
        self,
        law: FrictionLaw,
        features: HysteresisFeatures,
        trained: TrainedRange,
        rng: np.random.Generator,
    ) -> FrictionLaw:
        # A law without a state has no (alpha, beta).
        if (self.units < 2 and not self.denominator) or "alpha" not in law.values:
            return law
        problem = pose(law.structure, features.samples, self.discretisation)
        point = problem.point({name: law.values[name] for name in problem.space.names})
        best = Trial(structure=law.structure, problem=problem, point=point)
        if self.units > 1:
            columns = features.columns(law.values["alpha"], law.values["beta"])
            more = with_unit(best, columns, self.functions, self.starts, rng)
            best = extended(best, more, trained)
        if self.denominator:
            rational = best.changed({**best.structure, "denominator": list(family.DIVISORS)}, {})
            best = extended(best, [rational], trained)
        return law if best.structure == law.structure else replace(best.law(), name=self.name)

    def _evolve(self, features: HysteresisFeatures, rng: np.random.Generator) -> list[Candidate]:
        tau = features.samples.tau
        rows = slice(None, None, max(1, len(tau) // evolve.ROWS))
        found: list[Candidate] = []
        cells = calibrate.distinct(calibrate.profile(features), self.cells)
        searches = len(cells) * len(self.functions)
        for i, cell in enumerate(cells):
            columns = features.columns(cell.alpha, cell.beta)[rows]
            found.append(evolve.linear(cell, columns, tau[rows]))
            for k, g in enumerate(self.functions):
                step(i * len(self.functions) + k, 2 * searches)  # the second half is stage 3
                starts = evolve.starting_points(rng, self.starts, 4)
                found += evolve.search(cell, g, columns, tau[rows], starts, keep=3)
        found.sort(key=lambda f: f.cost)
        of_each = ([f for f in found if f.g == g] for g in (None, *self.functions))
        return [candidate for of_g in of_each for candidate in of_g[: self.candidates]]

    def _paper(self, features: HysteresisFeatures, rng: np.random.Generator) -> list[Candidate]:
        alpha, beta = calibrate.geometric(features)
        cell = Cell(alpha=alpha, beta=beta, cost=np.nan)
        columns = features.columns(alpha, beta)
        return [paper.search(cell, g, columns, features.samples.tau, rng) for g in self.functions]
