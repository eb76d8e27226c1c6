"""ParFam-V: ablation of the paper, a symbolic law of velocity alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hesr_model.fitting.declarative import Described
from hesr_model.fitting.estimator import register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import SearchSpace, Separable, left_out_cost
from hesr_model.fitting.ties import first_best
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.parfam import evolve, family
from hesr_model.rigid_body.residual import FrictionRecord

FEATURES = ("1", "dq")
STEEPEST = 2000.0  # slope of an argument, times the typical speed
_ROWS = 1200


@register
@dataclass(kw_only=True, eq=False)
class ParFamV(Described):
    """tau = c . (1, v) + c_g g(theta . (1, v))  (eq. 11 with x = v)."""

    name = "parfam_v"
    title = "ParFam-V"
    order = 20
    paper = 5
    typical: ClassVar[Mapping[str, Any]] = {
        "linear": ["1", "dq"],
        "units": [{"g": "tanh", "arguments": ["1", "dq"]}],
    }

    functions: Sequence[str] = ("tanh", "sin")  # candidates g
    starts: int = 16  # random ones per g, and as many steep ones, since friction jumps at rest

    @staticmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions."""
        return family.form(structure)

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search the unit's argument for every g; cross-validation selects one."""
        samples = JointRows.of(records, coefficients=5)
        x = np.column_stack([np.ones(len(samples.dq)), samples.dq])
        rows = slice(None, None, max(1, len(x) // _ROWS))
        found = []
        for g in self.functions:
            structure = {"linear": list(FEATURES), "units": [{"g": g, "arguments": list(FEATURES)}]}
            problem = Separable(family.form(structure), _space(samples), samples)
            starts = evolve.starting_points(rng, 2 * self.starts, 2)
            if g == "tanh":
                starts[self.starts :, 1] *= np.geomspace(2.0, STEEPEST, self.starts)
            limit = STEEPEST if g == "tanh" else evolve.ARGUMENT_LIMIT
            for theta in evolve.arguments(
                g, x[rows], x[rows], samples.tau[rows], starts, keep=3, limit=limit
            ):
                point = problem.polish(
                    problem.point({"theta1_0": theta[0], "theta1_dq": theta[1]}), evaluations=30
                )
                cost = left_out_cost(problem.columns(point), samples.tau, samples.folds)
                found.append((cost, structure, problem, point))
        _, structure, problem, point = found[first_best([entry[0] for entry in found])]
        return self.finish(structure, problem, point)


def _space(samples: JointRows) -> SearchSpace:
    limit = STEEPEST / float(np.sqrt(np.mean(samples.dq**2)))
    bound = evolve.ARGUMENT_LIMIT
    return SearchSpace(
        bounds=(("theta1_0", (-bound, bound)), ("theta1_dq", (-limit, limit))),
        linear=("c_0", "c_dq", "c_g1"),
    )
