"""ParFam-S: stops with symbolic bounds, fitted by signed least squares and cross-validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hesr_model.fitting.estimator import Estimator, register
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.nonnegative import Normal
from hesr_model.fitting.ties import first_best
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.ripple import LAG
from hesr_model.laws.stops import passive, waves
from hesr_model.laws.stops.form import FINER, Structure, start_at_rest, viscous_at
from hesr_model.laws.stops.search import Terms, dictionary, search
from hesr_model.rigid_body.residual import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.typed_json import to_json

WINDOW = 1.5  # step without averaging of ripple, in sample times


@dataclass(kw_only=True, eq=False)
class _Stops(Estimator):
    """Stops with expressions as bounds; no part generates energy."""

    load: ClassVar[bool] = False
    ripple: ClassVar[bool] = False
    start_samples: ClassVar[int] = 0
    typical: ClassVar[Mapping[str, Any]] = {
        "stops": [["1", 0], ["1", 4], ["age", 0]],
        "viscous": ["1", "b"],
    }

    skeleton_only: bool = False  # skip the search

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions."""
        return Structure.of(structure).form()

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Solve for all forces with sign constraints; `rng` is not used."""
        del rng
        samples = JointRows.of(records, coefficients=20)
        scales = range(len(FINER) if samples.sliding else 1)
        tried = [dictionary(samples, load=self.load, scale=scale) for scale in scales]
        if not self.skeleton_only:
            tried = [search(terms, load=self.load) for terms in tried]
        best = tried[first_best([terms.cost for terms in tried])]
        structure, columns = best.active()
        structure = replace(structure, limited=self.load)
        lag = 0.0
        if self.ripple and samples.gear_ratio is not None:
            chosen = waves.select(columns, samples, best.weights, samples.gear_ratio)
            if chosen.frequencies:
                window = WINDOW * float(np.median(samples.dt[~samples.begins]))
                structure = replace(
                    structure, ripple=chosen.frequencies, window=float(f"{window:.3g}")
                )
                lag = chosen.lag
                columns = np.hstack([columns, waves.waves(chosen.frequencies, lag, samples)])
        return self._law(best, structure, columns, lag)

    def _law(self, best: Terms, structure: Structure, columns: Array, lag: float) -> FrictionLaw:
        samples, form = best.samples, structure.form()
        names = (*structure.forces, "tau_0", *structure.waves)
        free = 1 + len(structure.waves)
        normal = Normal.of(columns, samples.tau, samples.folds, best.weights, free=free)
        x = normal.solve()
        if structure.ripple:
            x = passive.constrained(
                normal.gram,
                normal.moment,
                x,
                viscous_at(structure, best.numbers, passive.SPEEDS),
                passive.needed(structure.ripple, lag, structure.window),
                free=free,
            )
        values = {**best.numbers, LAG.name: lag, **dict(zip(names, map(float, x), strict=True))}
        return FrictionLaw(
            name=self.name,
            structure=to_json(structure),
            form=form,
            values={c.name: values[c.name] for c in form.coefficients},
            start=start_at_rest(form),
            start_samples=self.start_samples,
        )


_LOADED = {
    **_Stops.typical,
    "stops": [["1", 0], ["1", 4], ["age", 0], ["load", 0]],
    "limited": True,
}


@register
class ParFamS(_Stops):
    """Stops with bounds of age and load, and ripple: passive for any step (equations in `form`)."""

    name = "parfam_s"
    title = "ParFam-S"
    order = 170
    proposed = True
    load = True
    ripple = True
    start_samples = 5
    typical: ClassVar[Mapping[str, Any]] = {**_LOADED, "ripple": [200], "window": 0.01}


@register
class ParFamSLoad(_Stops):
    """ParFam-S without ripple: bounds of age and load."""

    name = "parfam_s_load"
    title = "ParFam-S, no ripple"
    order = 180
    load = True
    typical: ClassVar[Mapping[str, Any]] = _LOADED


@register
class ParFamSV(_Stops):
    """ParFam-S of the velocity alone: bounds of age."""

    name = "parfam_s_v"
    title = "ParFam-S, velocity"
    order = 190
    proposed = True
