"""ParFam-S: stops with symbolic bounds and ripple, by signed least squares and cross-validation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import scipy

from hesr_model.fitting.estimator import Estimator, register
from hesr_model.fitting.joint_rows import (
    JointRows,
    NormalEquations,
    divide_into_blocks,
    find_first_best,
    has_significant_gain,
)
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.laws.ripple import LAG
from hesr_model.laws.stops import form as forms
from hesr_model.laws.stops.form import DEFLECTION_SCALES, SPEEDS, Structure, build_rest_states
from hesr_model.laws.stops.search import Terms, build_dictionary, search
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.arrays import Array
from hesr_model.support.typed_files import to_json

ORDERS = range(1, 17)  # per turn of the motor
NEAR_MULTIPLE = 3  # [1/rad] from an integer multiple of the gear ratio
LAGS = np.arange(0.0, 0.0121, 0.0005)  # [s]
MAX_FREQUENCIES = 6  # frequencies of a joint
MIN_GAIN = 0.002  # smallest relative gain of the left-out mean square by a frequency
_PHASE_RANGE = 0.6  # range of the lag, as a phase at 1 rad/s [rad]


@dataclass(frozen=True, kw_only=True)
class Waves:
    """Frequencies in the joint angle [1/rad] and their common lag [s]."""

    frequencies: tuple[int, ...]
    lag: float


def waves(frequencies: Sequence[int], lag: float, rows: JointRows) -> Array:
    """Return the (N, 2 K) cosines and sines of the joint angle before the lag."""
    phase = np.outer(rows.q - lag * rows.dq, np.asarray(frequencies, dtype=float))
    return np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(rows.q), -1)


def select_waves(base: Array, rows: JointRows, weights: Array, gear_ratio: float) -> Waves:
    """Return the waves that lower the error of `base` (N, K) by more than one standard error."""
    problem = _Problem(base=base, rows=rows, weights=weights)
    blocks = divide_into_blocks(rows.dt, rows.begins)
    chosen = Waves(frequencies=(), lag=0.0)
    errors = problem.cross_validate(chosen)
    while len(chosen.frequencies) < MAX_FREQUENCIES:
        trial = _add_best_wave(problem, chosen, gear_ratio)
        if trial is None:
            break
        trial = problem.align_phase(trial, reach=_PHASE_RANGE / max(trial.frequencies))
        trial_errors = problem.cross_validate(trial)
        gain = 1.0 - float(trial_errors @ trial_errors) / float(errors @ errors)
        if gain < MIN_GAIN or not has_significant_gain(errors, trial_errors, blocks):
            break
        chosen = trial
        errors = trial_errors
    return chosen


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    base: Array
    rows: JointRows
    weights: Array

    def columns(self, chosen: Waves) -> Array:
        if not chosen.frequencies:
            return self.base
        return np.hstack([self.base, waves(chosen.frequencies, chosen.lag, self.rows)])

    def cross_validate(self, chosen: Waves) -> Array:
        rows = self.rows
        free = 1 + 2 * len(chosen.frequencies)
        return NormalEquations.from_columns(
            self.columns(chosen), rows.tau, rows.folds, self.weights, free=free
        ).cross_validate()

    def residual(self, chosen: Waves) -> Array:
        columns = self.weights[:, None] * self.columns(chosen)
        tau = self.weights * self.rows.tau
        x = np.linalg.lstsq(columns.T @ columns, columns.T @ tau, rcond=1e-12)[0]
        return np.asarray(tau - columns @ x)

    def align_phase(self, chosen: Waves, *, reach: float) -> Waves:
        """Return the waves with the best lag within `reach` [s]."""

        def cost(lag: float) -> float:
            residual = self.residual(replace(chosen, lag=lag))
            return float(residual @ residual)

        lag_bounds = (max(0.0, chosen.lag - reach), chosen.lag + reach)
        optimum = scipy.optimize.minimize_scalar(
            cost, bounds=lag_bounds, method="bounded", options={"xatol": reach / 50.0}
        )
        return replace(chosen, lag=float(optimum.x))


def _add_best_wave(problem: _Problem, chosen: Waves, gear_ratio: float) -> Waves | None:
    """Return the waves plus the one that fits the residual best, over all lags for the first."""
    rows = problem.rows
    residual = problem.residual(chosen)
    chosen_orders = {round(n / gear_ratio) for n in chosen.frequencies}
    orders = [order for order in ORDERS if order not in chosen_orders]
    if not orders:
        return None
    lags = LAGS
    if chosen_orders:
        lags = np.array([chosen.lag])
    fits = {}
    for lag in lags:
        rotation = np.exp(1j * gear_ratio * (rows.q - lag * rows.dq))
        power = residual.astype(complex)
        for order in ORDERS:
            power = power * rotation
            fits[order, float(lag)] = abs(complex(power.sum()))
    order, lag = max((key for key in fits if key[0] in orders), key=fits.__getitem__)
    nearest_multiple = round(order * gear_ratio)
    angle = rows.q - lag * rows.dq
    near_frequencies = range(
        max(1, nearest_multiple - NEAR_MULTIPLE), nearest_multiple + NEAR_MULTIPLE + 1
    )
    frequency = max(near_frequencies, key=lambda n: abs(complex(residual @ np.exp(1j * n * angle))))
    return Waves(frequencies=(*chosen.frequencies, frequency), lag=lag)


_SKELETON = [["1", 0], ["1", 4], ["age", 0]]
WINDOW_SAMPLES = 1.5  # step without averaging of ripple, in sample times


@dataclass(kw_only=True, eq=False)
class _StopsEstimator(Estimator):
    """Stops with expressions as bounds; no part generates energy."""

    load: ClassVar[bool] = False
    ripple: ClassVar[bool] = False
    start_samples: ClassVar[int] = 0
    typical: ClassVar[Mapping[str, Any]] = {"stops": _SKELETON, "viscous": ["1", "b"]}

    skeleton_only: bool = False  # skip the search

    @staticmethod
    def form(structure: Mapping[str, Any]) -> LawForm:
        """Return the expressions."""
        return Structure.from_json(structure).form()

    def fit(self, records: Sequence[FrictionRecord], rng: np.random.Generator) -> FrictionLaw:
        """Solve for all forces with sign constraints; `rng` is not used."""
        del rng
        rows = JointRows.from_records(records, coefficients=20)
        scales = range(1)
        if rows.sliding:
            scales = range(len(DEFLECTION_SCALES))
        trials = [build_dictionary(rows, load=self.load, scale=scale) for scale in scales]
        if not self.skeleton_only:
            trials = [search(terms, load=self.load) for terms in trials]
        best_terms = trials[find_first_best([terms.cost for terms in trials])]
        structure, columns = best_terms.select_active()
        structure = replace(structure, limited=self.load)
        chosen = Waves(frequencies=(), lag=0.0)
        if self.ripple and rows.gear_ratio is not None:
            chosen = select_waves(columns, rows, best_terms.weights, rows.gear_ratio)
        if not chosen.frequencies:
            return self._law(best_terms, structure, columns, 0.0)
        window = WINDOW_SAMPLES * float(np.median(rows.dt[~rows.begins]))
        structure = replace(structure, ripple=chosen.frequencies, window=float(f"{window:.3g}"))
        columns = np.hstack([columns, waves(chosen.frequencies, chosen.lag, rows)])
        return self._law(best_terms, structure, columns, chosen.lag)

    def _law(self, terms: Terms, structure: Structure, columns: Array, lag: float) -> FrictionLaw:
        rows = terms.rows
        form = structure.form()
        names = (*structure.forces, "tau_0", *structure.waves)
        free = 1 + len(structure.waves)
        normal = NormalEquations.from_columns(
            columns, rows.tau, rows.folds, terms.weights, free=free
        )
        x = normal.solve()
        if structure.ripple:
            x = forms.constrain_coefficients(
                normal.gram,
                normal.moment,
                x,
                forms.evaluate_viscous(structure, terms.numbers, SPEEDS),
                forms.compute_required_viscosity(structure.ripple, lag, structure.window),
                free=free,
            )
        values = {**terms.numbers, LAG.name: lag}
        for name, coefficient in zip(names, x, strict=True):
            values[name] = float(coefficient)
        return FrictionLaw(
            name=self.name,
            structure=to_json(structure),
            form=form,
            values={quantity.name: values[quantity.name] for quantity in form.coefficients},
            start=build_rest_states(form),
            start_samples=self.start_samples,
        )


_LOADED = {**_StopsEstimator.typical, "stops": [*_SKELETON, ["load", 0]], "limited": True}


@register
class ParFamS(_StopsEstimator):
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
class ParFamSLoad(_StopsEstimator):
    """ParFam-S without ripple: bounds of age and load."""

    name = "parfam_s_load"
    title = "ParFam-S, no ripple"
    order = 180
    load = True
    typical: ClassVar[Mapping[str, Any]] = _LOADED


@register
class ParFamSV(_StopsEstimator):
    """ParFam-S of the velocity alone: bounds of age."""

    name = "parfam_s_v"
    title = "ParFam-S, velocity"
    order = 190
    proposed = True
