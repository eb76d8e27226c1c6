"""Declarative estimators: a form and the search space of its coefficients."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from hesr_model.equations.functions import clip
from hesr_model.errors import ArtifactError
from hesr_model.fitting.estimator import Estimator
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.law_check import require_usable_space
from hesr_model.fitting.separable import SearchSpace, Separable
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.laws import ripple
from hesr_model.laws.ripple import Ripple
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import to_json

LARGEST_LOAD = Coefficient(
    name="load_most", unit="N.m", description="largest load of the bounds, from training"
)


class DeclarativeEstimator(Estimator):
    """A law given by its core, with optional ripple and estimated start.

    Attributes
    ----------
    ripple : True to add harmonics of the motor angle if the gear ratio is
        known.
    start_samples : number of first torques of a log that set the initial state.
    limited : True to limit the load in the memory to the largest in training.
    """

    limited: ClassVar[bool] = False
    ripple: ClassVar[bool] = False
    start_samples: ClassVar[int] = 0

    @staticmethod
    @abstractmethod
    def core(structure: Mapping[str, Any]) -> LawForm:
        """Return the law's expressions without ripple."""

    @classmethod
    def form(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions of a structure; {"ripple": ...} adds harmonics."""
        extra_keys = ["ripple"]
        if cls.limited:
            extra_keys.append("limited")
        core = cls.core({key: value for key, value in structure.items() if key not in extra_keys})
        if cls.limited and structure.get("limited"):
            replacements = {TAU_LOAD: clip(TAU_LOAD, LARGEST_LOAD.symbol)}
            coefficients = core.coefficients
            memory = (element.subs(replacements) for element in core.memory)
            core = replace(core, coefficients=(*coefficients, LARGEST_LOAD), memory=tuple(memory))
        if "ripple" not in structure:
            return core
        return Ripple.from_structure(structure["ripple"]).extend(core)

    def finish(self, structure: Mapping[str, Any], problem: Separable, point: Array) -> FrictionLaw:
        """Return the law at a point of a core's problem, with ripple if it lowers the error."""
        full_structure = dict(structure)
        rows = problem.rows
        selected_ripple = None
        if self.ripple and rows.gear_ratio is not None:
            columns = problem.columns(point)
            selected_ripple = ripple.select(columns, rows, rows.gear_ratio, rows.folds)
        if selected_ripple:
            waves, times = selected_ripple
            full_structure["ripple"] = to_json(waves)
            numbers = problem.name_numbers(point)
            space = waves.extend_space(problem.space)
            problem = Separable(waves.extend(problem.form), space, rows)
            trials = []
            for start_times in ripple.starts(times):
                start = problem.point(numbers | start_times)
                trials.append(problem.polish_from_corners(start))
            point = min(trials, key=lambda trial: problem.solve(trial)[1])
        law = problem.law(point, self.name, full_structure)
        law = replace(law, start_samples=self.start_samples)
        if not self.limited:
            return law
        # No training row is at the kink.
        load_limit = {LARGEST_LOAD.name: 1.001 * float(np.max(np.abs(rows.tau_load)))}
        full_structure["limited"] = True
        return replace(
            law,
            structure=full_structure,
            form=self.form(full_structure),
            values={**law.values, **load_limit},
        )


class OneForm(DeclarativeEstimator):
    """A law of one form, linear in most coefficients, fitted by differential evolution.

    Attributes
    ----------
    expressions : the core, of laws that do not override it.
    """

    expressions: ClassVar[LawForm]

    @classmethod
    def core(cls, structure: Mapping[str, Any]) -> LawForm:
        """Return the law's expressions without ripple; raise ArtifactError for structure data."""
        no_structure(cls.name, structure)
        return cls.expressions

    @abstractmethod
    def space(self) -> SearchSpace:
        """Return the search space of the core."""

    @classmethod
    def require_usable(cls) -> None:
        """Raise ConfigError or ArtifactError, with the attribute, if the class is not a law yet."""
        super().require_usable()
        require_usable_space(cls.name, cls.core({}), cls().space())

    def build_fitted_space(self, law: FrictionLaw) -> SearchSpace:
        """Return the search space of a fitted law, with its ripple."""
        waves = law.structure.get("ripple")
        if not waves:
            return self.space()
        return Ripple.from_structure(waves).extend_space(self.space())

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Search the non-linear coefficients (seeded by `rng`) and solve the linear ones."""
        form = self.core({})
        rows = JointRows.from_records(records, coefficients=len(form.coefficients))
        problem = Separable(form, self.space().scale_to_joint(is_prismatic=rows.sliding), rows)
        return self.finish({}, problem, problem.polish_from_corners(problem.search(rng)))


def no_structure(name: str, structure: Mapping[str, Any]) -> None:
    """Raise ArtifactError if a law with one form has structure data."""
    if structure:
        raise ArtifactError(f"law '{name}' has no structure, found {dict(structure)}.")
