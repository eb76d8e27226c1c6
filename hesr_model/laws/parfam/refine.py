"""Stage 3: Levenberg-Marquardt over all coefficients, and pruning of insignificant ones."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from hesr_model.audit.audit import explodes
from hesr_model.errors import FitError
from hesr_model.fitting.joint_rows import find_first_best
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.covariance import correlation_length, standard_errors
from hesr_model.laws.parfam.calibrate import bounds
from hesr_model.laws.parfam.candidate import Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.progress import step

SIGNIFICANCE = 2.0  # of a coefficient, in standard errors
_ALL_ROWS = slice(None)
ROUNDS = ((8, 10), (16, 4))
"""(evaluations, number of candidates kept) over all rows: few rows determine a steep beta."""
FIRST_EVALUATIONS = 60
PRUNED_EVALUATIONS = 12
FOLD_EVALUATIONS = 8  # evaluations of the final fit, after pruning, without a fold
PORTIONS = 20  # of `FOLD_EVALUATIONS` evaluations, before finalists are compared
HOPEFUL_RATIO = 1.1  # largest mean square for a final fit, of the best one
VARIANCE_ROUND_OFF = 1e-15  # mean square that counts as zero, of the torque's variance
TIE_TOLERANCE = 1e-6  # relative difference of mean squares that is a tie, or convergence


def select(
    features: HysteresisFeatures,
    candidates: Sequence[Candidate],
    folds: Sequence[Mask],
    trained_range: TrainedRange,
) -> Candidate:
    """Return the simplest pruned candidate within `TIE_TOLERANCE`; FitError if all explode."""
    shortlist = list(candidates)
    for i, (evaluations, keep) in enumerate(ROUNDS):
        refined: list[Candidate] = []
        for candidate in shortlist:
            share = (i + len(refined) / len(shortlist)) / len(ROUNDS)
            step(round(1000 * (1.0 + share)), 2000)
            refined.append(Refinement(features, candidate).run(evaluations))
        shortlist = select_distinct(refined)[:keep]
    limit = HOPEFUL_RATIO * shortlist[0].cost
    hopeful = [candidate for candidate in shortlist if candidate.cost <= limit]
    others = [candidate for candidate in shortlist if candidate.cost > limit]
    linear = [candidate for candidate in candidates if candidate.g is None]
    best_linear = sorted(linear, key=lambda candidate: candidate.cost)[:1]
    # If all explode, try the others, then the linear law.
    for group in (hopeful, others, best_linear):
        finalists = _prune_group(features, group, trained_range)
        if finalists:
            costs = [
                left_out_cost(features, candidate, folds, portions=PORTIONS)
                for candidate in finalists
            ]
            return finalists[find_first_best(costs, TIE_TOLERANCE)]
    raise FitError("every ParFam candidate explodes just outside the trained speeds.")


def _prune_group(
    features: HysteresisFeatures, group: Sequence[Candidate], trained_range: TrainedRange
) -> list[Candidate]:
    """Return pruned candidates that do not explode, those with the fewest terms first."""
    pruned = select_distinct([prune(features, candidate) for candidate in group])
    pruned.sort(key=_count_terms)
    stable = []
    for candidate in pruned:
        law = candidate.law("candidate", features.discretisation)
        if not explodes(law, trained_range):
            stable.append(candidate)
    return stable


def select_distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the candidates sorted by cost; of tied ones the one with the fewest terms."""
    distinct_candidates: list[Candidate] = []
    for candidate in sorted(candidates, key=lambda candidate: candidate.cost):
        if not distinct_candidates or candidate.cost > distinct_candidates[-1].cost * (
            1.0 + TIE_TOLERANCE
        ):
            distinct_candidates.append(candidate)
        elif _count_terms(candidate) < _count_terms(distinct_candidates[-1]):
            distinct_candidates[-1] = candidate
    return distinct_candidates


def _count_terms(candidate: Candidate) -> int:
    return int(candidate.c_active.sum() + candidate.theta_active.sum())


def prune(features: HysteresisFeatures, candidate: Candidate) -> Candidate:
    """Refine, then drop insignificant coefficients, the least significant first."""
    refined = Refinement(features, candidate).run(FIRST_EVALUATIONS)
    statistics = Refinement(features, refined).statistics()
    is_needed = np.zeros(11, bool)
    while True:
        removable = np.r_[False, False, refined.c_active, False, refined.theta_active] & ~is_needed
        if refined.theta_active.sum() == 1:
            removable[7:] = False
        weakest = find_first_best(np.where(removable, statistics, np.inf), TIE_TOLERANCE)
        if not removable.any() or statistics[weakest] >= SIGNIFICANCE:
            return refined
        smaller = Refinement(features, _remove_coefficient(refined, weakest)).run(
            PRUNED_EVALUATIONS
        )
        if smaller.cost <= _find_acceptable_cost(features, refined):
            refined = smaller
            statistics = Refinement(features, smaller).statistics()
        else:
            is_needed[weakest] = True


def refine_to_convergence(
    features: HysteresisFeatures, start: Candidate, portions: int, rows: Mask
) -> Candidate:
    """Refine on rows (N,) until `FOLD_EVALUATIONS` evaluations gain under `TIE_TOLERANCE`."""
    refined = Refinement(features, start, rows).run(FOLD_EVALUATIONS)
    for _ in range(1, portions):
        previous_cost = refined.cost
        refined = Refinement(features, refined, rows).run(FOLD_EVALUATIONS)
        if refined.cost >= previous_cost * (1.0 - TIE_TOLERANCE):
            break
    return refined


def _remove_coefficient(candidate: Candidate, coefficient: int) -> Candidate:
    is_kept = np.arange(11) != coefficient
    c_active = candidate.c_active & is_kept[2:6]
    theta_active = candidate.theta_active & is_kept[7:]
    return replace(
        candidate,
        c=candidate.c * c_active,
        theta=candidate.theta * theta_active,
        c_active=c_active,
        theta_active=theta_active,
    )


def _find_acceptable_cost(features: HysteresisFeatures, candidate: Candidate) -> float:
    tau = features.rows.tau
    residual = candidate.torque(features.columns(candidate.alpha, candidate.beta)) - tau
    rise = SIGNIFICANCE**2 * correlation_length(residual) / len(tau)
    return candidate.cost * (1.0 + rise) + VARIANCE_ROUND_OFF * float(np.var(tau))


def left_out_cost(
    features: HysteresisFeatures, candidate: Candidate, folds: Sequence[Mask], portions: int = 1
) -> float:
    """Return the mean square error [N^2.m^2] by cross-validation; folds are masks (N,)."""
    total = 0.0
    for fold in folds:
        refined = refine_to_convergence(features, candidate, portions, ~fold)
        torque = refined.torque(features.columns(refined.alpha, refined.beta))
        total += float(np.sum((torque - features.rows.tau)[fold] ** 2))
    return total / len(features.rows.tau)


class Refinement:
    """The joint least-squares problem of a candidate over (alpha, beta, c, gain, theta).

    alpha and beta are the logit of their position within (logarithmic) bounds, so that 0 < alpha dt
    < 1; coefficients are for standardised features. The residual is that of `rows`, while the state
    runs over all rows.
    """

    def __init__(
        self, features: HysteresisFeatures, start: Candidate, rows: Mask | slice = _ALL_ROWS
    ) -> None:
        self.features = features
        self.start = start
        self.rows = rows
        self.weights: Array | None = None
        if isinstance(rows, np.ndarray):
            self.weights = rows.astype(float)
        self.count = len(features.rows.tau[rows])
        (a_low, a_high), (b_low, b_high) = bounds(features)
        self.low = np.log([a_low, b_low])
        self.span = np.log([a_high, b_high]) - self.low
        columns = features.columns(start.alpha, start.beta)
        self.scale = np.concatenate([[1.0], np.maximum(columns[:, 1:].std(axis=0), 1e-12)])
        self._slopes_run = features.slopes(start.g)
        self.active = np.r_[True, True, start.c_active, start.g is not None, start.theta_active]

    def pack(self) -> Array:
        """Return the start as a search vector (parameters,)."""
        place = (np.log([self.start.alpha, self.start.beta]) - self.low) / self.span
        place = scipy.special.logit(np.clip(place, 1e-6, 1.0 - 1e-6))
        c = self.start.c * self.scale
        theta = self.start.theta * self.scale
        return np.concatenate([place, c, [self.start.gain], theta])[self.active]

    def unpack(self, point: Array, cost: float = np.nan) -> Candidate:
        """Return the candidate of a search vector."""
        full = np.zeros(11)
        full[self.active] = point
        alpha, beta = np.exp(self.low + self.span * scipy.special.expit(full[:2]))
        return replace(
            self.start,
            alpha=float(alpha),
            beta=float(beta),
            c=full[2:6] / self.scale,
            gain=float(full[6]),
            theta=full[7:] / self.scale,
            cost=cost,
        )

    def slopes(self, point: Array) -> tuple[Array, Array]:
        """Return the (rows, parameters) slopes of the residual at a search vector, and itself."""
        numbers, factors = self._unpack_numbers(point)
        slope_columns = self._slopes_run.evaluate(numbers)[self.rows]
        return slope_columns[:, :-1][:, self.active] * factors[self.active], slope_columns[:, -1]

    def _unpack_numbers(self, point: Array) -> tuple[Array, Array]:
        """Return all numbers at a search vector, and the slopes (11,) of each by its unknown."""
        candidate = self.unpack(point)
        place = scipy.special.expit(point[:2])
        chain = np.array([candidate.alpha, candidate.beta]) * self.span * place * (1.0 - place)
        factors = np.concatenate([chain, 1.0 / self.scale, [1.0], 1.0 / self.scale])
        return np.r_[
            candidate.alpha, candidate.beta, candidate.c, candidate.gain, candidate.theta
        ], factors

    def _reduce_slopes(self, point: Array) -> Array:
        """Return a square R with R'R = A'A, where A has the slopes and, last, the residual.

        Levenberg-Marquardt depends on inner products alone, so it takes the same steps with R.
        """
        numbers, factors = self._unpack_numbers(point)
        self._slopes_run.begin(numbers)
        products = self._slopes_run.multiply(numbers, self.weights)[:-1, :-1]
        # The residual, last, is no unknown.
        is_used = np.r_[self.active, True]
        factors = np.r_[factors, 1.0]
        gram = (products * np.outer(factors, factors))[np.ix_(is_used, is_used)]
        if not np.isfinite(gram).all():  # refused as a step
            return np.full_like(gram, np.inf)
        sizes = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        gram /= np.outer(sizes, sizes)
        try:
            root = np.linalg.cholesky(gram, upper=True)
        except np.linalg.LinAlgError:  # dependent columns
            eigenvalues, eigenvectors = np.linalg.eigh(gram, UPLO="U")
            root = np.sqrt(np.maximum(eigenvalues, 0.0))[:, None] * eigenvectors.T
        return np.asarray(root * sizes)

    def run(self, evaluations: int) -> Candidate:
        """Return the refined candidate."""
        last = (np.empty(0), np.empty(0))

        def find_reduced(point: Array) -> Array:
            nonlocal last
            if not np.array_equal(point, last[0]):
                last = (point.copy(), self._reduce_slopes(point))
            return last[1]

        # A sixth of the overhead of `least_squares`; its covariance, not used, may overflow.
        with np.errstate(over="ignore", invalid="ignore"):
            point, _, diagnostics, *_ = scipy.optimize.leastsq(
                lambda point: find_reduced(point)[:, -1],
                self.pack(),
                Dfun=lambda point: find_reduced(point)[:, :-1],
                full_output=True,
                ftol=1e-15,
                xtol=1e-15,
                gtol=1e-15,
                maxfev=evaluations,
            )
        return self.unpack(point, float(np.sum(diagnostics["fvec"] ** 2)) / self.count)

    def statistics(self) -> Array:
        """Return the t-statistics (11,) of the start, 0 of absent coefficients."""
        point = self.pack()
        statistics = np.zeros(11)
        errors = standard_errors(*self.slopes(point))
        statistics[self.active] = np.abs(point) / np.maximum(errors, 1e-300)
        return statistics
