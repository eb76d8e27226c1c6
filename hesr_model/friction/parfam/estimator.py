"""ParFam-H: the paper's symbolic friction law, found in three stages."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from hesr_model.errors import FitError
from hesr_model.friction.estimator import Estimator, register
from hesr_model.friction.law import Discretisation, FrictionLaw, LawForm
from hesr_model.friction.parfam import calibrate, evolve, family, paper, refine
from hesr_model.friction.parfam.calibrate import Cell
from hesr_model.friction.parfam.candidate import Candidate
from hesr_model.friction.parfam.features import HysteresisFeatures
from hesr_model.friction.samples import Samples
from hesr_model.friction.trained import TrainedRange
from hesr_model.residual import FrictionRecord

COEFFICIENTS = 11
"""Numbers of the largest law: alpha, beta, four linear, one gain, four of the argument."""


@register
class ParFamH(Estimator):
    """tau = Q(v, h, h', g(Q(v, h, h'))) with polynomials of degree one (eq. 11).

    Stage 1 profiles (alpha, beta); stage 2 searches the unit's argument at the best of them; stage
    3 runs Levenberg-Marquardt over everything, prunes what the data do not support, and takes the
    candidate that predicts left-out logs best.

    Parameters
    ----------
    search : "projection" (default) searches by variable projection from many starts; "paper" by
        the geometric stage 1 and by basin hopping with L1 (eq. 12).
    functions : the functions g that are tried. cos is sin with another offset, so it is found too.
    discretisation : of the hysteresis state.
    cells, starts : how many (alpha, beta) and how many random starts for each of them and each g.
    candidates : how many laws of each g go into stage 3.
    """

    name = "parfam_h"
    title = "ParFam-H"
    equation = "c . (1, dq, h, h') + c_g g(theta . (1, dq, h, h')), h' = alpha (tanh(beta dq) - h)"

    def __init__(
        self,
        *,
        search: Literal["projection", "paper"] = "projection",
        functions: Sequence[str] = ("tanh", "sin", "exp"),
        discretisation: Discretisation = "exact",
        cells: int = 10,
        starts: int = 16,
        candidates: int = 8,
    ) -> None:
        unknown = sorted(set(functions) - set(family.FUNCTIONS))
        if unknown:
            known = ", ".join(family.FUNCTIONS)
            raise FitError(f"ParFam function '{unknown[0]}' is unknown; known are {known}.")
        if search == "paper" and not functions:
            raise FitError("ParFam option 'functions' is empty; the paper's search needs one.")
        for option, found, allowed in (
            ("search", search, ("projection", "paper")),
            ("discretisation", discretisation, ("exact", "euler")),
        ):
            if found not in allowed:
                raise FitError(
                    f"ParFam option '{option}' is '{found}'; allowed are {', '.join(allowed)}."
                )
        for option, count in (("cells", cells), ("starts", starts), ("candidates", candidates)):
            if count < 1:
                raise FitError(f"ParFam option '{option}' is {count}; needed is at least 1.")
        self.search = search
        self.functions = tuple(functions)
        self.discretisation = discretisation
        self.cells = cells
        self.starts = starts
        self.candidates = candidates

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of a structure of the family."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Fit the three stages (starts and hops drawn from `rng`)."""
        samples = Samples.of(records, coefficients=COEFFICIENTS)
        features = HysteresisFeatures(samples=samples, discretisation=self.discretisation)
        found = (
            self._paper(features, rng) if self.search == "paper" else self._evolve(features, rng)
        )
        chosen = refine.select(features, found, samples.folds, TrainedRange.of(records))
        return chosen.canonical().law(self.name, self.discretisation)

    def _evolve(self, features: HysteresisFeatures, rng: np.random.Generator) -> list[Candidate]:
        tau = features.samples.tau
        rows = slice(None, None, max(1, len(tau) // evolve.ROWS))
        found: list[Candidate] = []
        for cell in calibrate.distinct(calibrate.profile(features), self.cells):
            columns = features.columns(cell.alpha, cell.beta)[rows]
            found.append(evolve.linear(cell, columns, tau[rows]))
            for g in self.functions:
                starts = evolve.starting_points(rng, self.starts, 4)
                found += evolve.search(cell, g, columns, tau[rows], starts, keep=3)
        return [
            candidate
            for g in (None, *self.functions)
            for candidate in sorted((f for f in found if f.g == g), key=lambda f: f.cost)[
                : self.candidates
            ]
        ]

    def _paper(self, features: HysteresisFeatures, rng: np.random.Generator) -> list[Candidate]:
        alpha, beta = calibrate.geometric(features)
        cell = Cell(alpha=alpha, beta=beta, cost=np.nan)
        columns = features.columns(alpha, beta)
        return [paper.search(cell, g, columns, features.samples.tau, rng) for g in self.functions]
