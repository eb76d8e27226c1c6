"""ParFam-HX: ParFam-H with further inputs and position memory."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from hesr_model.fitting.declarative import Described
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import left_out_cost
from hesr_model.fitting.ties import no_worse
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import family
from hesr_model.laws.parfam.trial import Trial, choose, extended, pose, with_unit
from hesr_model.rigid_body.residual import FrictionRecord

STATE_GAIN = 0.02
"""Smallest relative gain by memory in time: one per cent for each of two coefficients."""


@register
class ParFamHX(Described):
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
        self.linear = (*family.FEATURES, *["h_load"] * load, *["h_bump"] * bump)
        self.functions = tuple(functions)
        self.ripple = ripple  # type: ignore[misc] # an option of this law, a constant in others
        self.start_samples = 5 if initial_state else 0  # type: ignore[misc] # likewise
        self.starts = starts

    @staticmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions without ripple."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search state, terms, unit and ripple in turn (seeded by `rng`)."""
        samples = JointRows.of(records, coefficients=len(self.linear) + 6)
        states = ("bristle", "generalised") if self.memory else ("paper",)
        bare = choose([self._bare(state, samples, rng) for state in states], STATE_GAIN)
        columns = bare.problem.columns(bare.point)
        moving = [bare.structure["linear"].index(x) for x in ("dq", "h", "dh")]
        features = np.column_stack([np.ones(len(columns)), columns[:, moving]])
        trained = TrainedRange.of(records)
        best = extended(bare, with_unit(bare, features, self.functions, self.starts, rng), trained)
        return self.finish(best.structure, best.problem, best.problem.polish(best.point))

    def _bare(self, state: str, samples: JointRows, rng: np.random.Generator) -> Trial:
        # A bristle contains the Stribeck curve.
        linear = [x for x in self.linear if state != "bristle" or x != "h_bump"]
        structure = {"linear": linear, "units": [], "state": state}
        problem = pose(structure, samples)
        found = problem.search(rng, effort=30)
        return self._thinned(Trial(structure=structure, problem=problem, point=found))

    def _thinned(self, trial: Trial) -> Trial:
        samples = trial.problem.samples
        columns = trial.problem.columns(trial.point)
        linear = trial.structure["linear"]
        kept = list(range(columns.shape[1]))
        cost = left_out_cost(columns, samples.tau, samples.folds)
        for i in reversed(range(columns.shape[1])):
            if linear[i] in ("dq", "h", "dh"):
                continue
            fewer = [k for k in kept if k != i]
            without = left_out_cost(columns[:, fewer], samples.tau, samples.folds)
            if no_worse(without, cost):
                kept, cost = fewer, without
        return trial.changed({**trial.structure, "linear": [linear[k] for k in kept]}, {})
