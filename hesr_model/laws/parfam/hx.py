"""ParFam-HX: ParFam-H with the inputs and the memory that measured joints turn out to need."""

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
"""Memory in time beside that in position, two coefficients more, stays if left-out rows gain this.

That is one per cent of the mean square per coefficient, as for a unit.
"""


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
    order = 160
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
        self.linear = (
            *family.FEATURES,
            *(["h_load"] if load else []),
            *(["h_bump"] if bump else []),
        )
        self.functions = tuple(functions)
        self.ripple = ripple  # type: ignore[misc] # a switch of this law, fixed in others
        self.start_samples = 5 if initial_state else 0  # type: ignore[misc] # likewise
        self.starts = starts

    @staticmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions without ripple."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search state, terms, unit and ripple one after the other (seeded by `rng`)."""
        samples = JointRows.of(records, coefficients=len(self.linear) + 6)
        states = ("bristle", "generalised") if self.memory else ("paper",)
        bare = choose([self._bare(state, samples, rng) for state in states], STATE_GAIN)
        columns = bare.problem.columns(bare.point)
        moving = [bare.structure["linear"].index(x) for x in ("dq", "h", "dh")]
        features = np.column_stack([np.ones(len(columns)), columns[:, moving]])
        trained = TrainedRange.of(records)
        more = with_unit(bare, features, self.functions, self.starts, rng)
        best = extended(bare, more, trained)
        return self.finish(best.structure, best.problem, best.problem.polish(best.point))

    def _bare(self, state: str, samples: JointRows, rng: np.random.Generator) -> Trial:
        # A bristle has the Stribeck curve inside, so the term is not needed beside it.
        linear = [x for x in self.linear if state != "bristle" or x != "h_bump"]
        structure = {"linear": linear, "units": [], "state": state}
        problem = pose(structure, samples)
        found = problem.search(rng, effort=30)
        return self._thinned(Trial(structure=structure, problem=problem, point=found))

    def _thinned(self, trial: Trial) -> Trial:
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
            if no_worse(without, cost):
                kept, cost = fewer, without
        return trial.changed({**trial.structure, "linear": [linear[k] for k in kept]}, {})
