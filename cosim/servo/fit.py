"""Fit of servo, armature and law of one joint to whole logs, which run free from the commands.

The positions depend on ratios of torques only, so the gain is held at 1 N.m/rad and all torques
are found in units of it. Levenberg-Marquardt's method minimises Huber's loss of the position
errors, from several starts.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy

from cosim.servo.engine import FINE_SUBSTEP, SUBSTEP, JointEngine
from cosim.servo.joint_fit import FitUnknown, JointFit
from cosim.servo.record import ServoRecord, find_encoder_step
from cosim.servo.start import (
    MAX_LATENCY,
    ServoStart,
    delay_commands,
    find_filtered_start,
    find_start,
    separate_friction,
)
from hesr_model.errors import FitError
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.estimator import Estimator
from hesr_model.fitting.separable import SearchSpace
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.servo import JointServo
from hesr_model.laws.stribeck import F_C, F_S, SIGMA_2, TAU_0
from hesr_model.robots.servo_description import ServoKind
from hesr_model.support.arrays import Array, Integers, Mask

_START_FACTORS = (1.0, 0.5, 2.0)  # of all torques over the gain
# Most evaluations of a search.
_SEARCH_RUNS = 8
_POLISH_RUNS = 30
_FOLD_RUNS = 6
_FINE_RUNS = 20
_DESCENTS = 8  # most steps with one Jacobian
_SETTLED = 1e-6  # relative fall of the loss that ends them
_NEARLY = 0.998  # of the loss: a greater fall in the last steps needs a further search
_SEARCH_SECONDS = 120.0  # of the records that try starts and servos
_HUBER = 1.345  # standard deviations beyond which an error counts linearly
_MAD_TO_DEVIATION = 1.4826  # standard deviation over the median size of normal errors
_LEAST_SPREAD = 1e-9  # of errors [rad; m]
_LARGEST = 1e3  # of a logarithmic unknown over its start, and its inverse
_INSIDE = 1e-9  # distance of a start from its bounds
_LATENCY_DIFFERENCE = 2e-4  # [s]
_LATENCY_SCALE = 1e-3  # [s], so that the end of a search does not overlook latencies
_LOST = 1e3  # error in place of a run that fails, over the range of the motion
_LEAST_SHARE = 0.02  # smallest scale of a torque over the largest of the friction
_LEAST_INTEGRAL = 0.1  # start of an integral gain over the gain [1/s]
_TINY = 1e-7  # start of what least squares did not find, over the gain, and share of round-off
_BLOCK = 2.0  # length of the blocks of time whose errors count as independent [s]
_MUCH_LESS = 0.8  # share of the squares that makes fine inner steps worth their time
_CLEAR = 2.0  # standard errors that one more unknown must gain
_WORTH = 0.02  # and its share of the squares


class JointProblem:
    """Fit of one joint: engine, records and unknowns; a context manager.

    `kind` is that of the servo: a proportional one (position), or one with derivative (pd) and
    integral (pid) gains.
    """

    def __init__(
        self, records: Sequence[ServoRecord], law: type[Estimator], kind: ServoKind = "position"
    ) -> None:
        self._estimator = law
        self._kind = kind
        self._start = find_start(records, kind)
        self.law = _start_law(records, law, self._start)
        self._engine = JointEngine(self.law, sliding=records[0].sliding)
        self._base = JointServo(kp=1.0, body_factor=0.0, added_factor=0.0)
        self._substep = SUBSTEP
        self._use(records, SUBSTEP)
        self._largest_error = _LOST * max(float(np.ptp(record.q)) for record in records)

    def __enter__(self) -> "JointProblem":
        self._engine.__enter__()
        return self

    def __exit__(self, *ended: object) -> None:
        self._engine.__exit__(*ended)

    def run(self, servo: JointServo, values: Mapping[str, float]) -> list[Array]:
        """Return the positions (N,) along each record."""
        return [
            self._engine.run(record, servo, values, substep=self._substep)
            for record in self._records
        ]

    def fit(self) -> JointFit:
        """Fit from several starts, with filter and limits of the servo if the errors need them.

        Raises FitError if no start runs.
        """
        all_records = self._records
        self._use(_select_seconds(all_records, _SEARCH_SECONDS), SUBSTEP)
        searches = []
        plain_law = _simplify_law(self._estimator, self.law, self._start)
        starts = [(factor, self.law) for factor in _START_FACTORS]
        for factor, law in [*starts, (1.0, plain_law)]:
            unknowns = tuple(self._list_unknowns(factor, self._start, law))
            search = _Search(self, unknowns)
            found = search.minimise(_encode_starts(unknowns), _SEARCH_RUNS, is_rough=True)
            searches.append((search, found))
        costs = [search.compute_cost(numbers) for search, numbers in searches]
        if not np.any(np.isfinite(costs)):
            raise FitError(f"joint '{self._records[0].joint}': no start of the fit runs")
        search, numbers = searches[int(np.nanargmin(costs))]
        numbers = search.minimise(numbers, _POLISH_RUNS)
        if self._is_incomplete(search, numbers):
            numbers = self._refine(search, numbers)
        search, numbers = self._complete_servo(search, numbers)
        if len(self._records) < len(all_records):
            self._use(all_records, self._substep)
            numbers = search.minimise(numbers, _POLISH_RUNS)
        jacobian = search.compute_jacobian(numbers)
        self._substep = FINE_SUBSTEP
        numbers, _ = search.descend(numbers, jacobian)
        return self._finish(search, numbers)

    def _use(self, records: Sequence[ServoRecord], substep: float) -> None:
        """Set the records that runs follow, and their inner steps [s]."""
        self._records = records
        self._substep = substep
        self._measured = np.concatenate([record.q for record in records])

    def refit(self, fit: JointFit, latency: float) -> JointFit:
        """Fit again from a fit, with a latency that other joints know better."""
        unknowns = [unknown for unknown in fit.unknowns if unknown.name != "latency"]
        values = [
            value
            for unknown, value in zip(fit.unknowns, fit.values, strict=True)
            if unknown.name != "latency"
        ]
        self._base = replace(self._base, latency=latency)
        search = _Search(self, unknowns)
        self._substep = FINE_SUBSTEP
        numbers = _encode(unknowns, values)
        numbers, _ = search.descend(numbers, search.compute_jacobian(numbers))
        refitted = self._finish(search, numbers)
        later = replace(refitted.servo, latency=latency + _LATENCY_DIFFERENCE)
        shifted = self.compute_errors(later, refitted.law.values)
        slope = (shifted - refitted.residual) / _LATENCY_DIFFERENCE
        return replace(refitted, latency_slope=slope)

    def predict_left_out(self, fit: JointFit, fold_of_row: Integers) -> Array:
        """Return the position errors (N,) [rad; m] of each fold by a fit to all others.

        Whole logs run from their commands; the rows of the fold do not count in the fit.
        """
        self._substep = SUBSTEP
        errors = np.zeros_like(fit.residual)
        numbers = _encode(fit.unknowns, fit.values)
        for fold in np.unique(fold_of_row):
            is_left_out = fold_of_row == fold
            search = _Search(self, fit.unknowns, is_used=~is_left_out)
            found = search.minimise(numbers, _FOLD_RUNS)
            everywhere = _Search(self, fit.unknowns)
            errors[is_left_out] = everywhere.compute_residual(found)[is_left_out]
        return errors

    def compute_errors(self, servo: JointServo, values: Mapping[str, float]) -> Array:
        """Return the position errors (N,), a large one where a run fails."""
        largest = self._largest_error
        errors = np.concatenate(self.run(servo, values)) - self._measured
        return np.asarray(np.clip(np.nan_to_num(errors, nan=largest), -largest, largest))

    def apply(
        self, unknowns: Sequence[FitUnknown], numbers: Array
    ) -> tuple[JointServo, dict[str, float]]:
        """Return servo and coefficients at a point of the search."""
        values = dict(self.law.values)
        changes = {}
        for unknown, number in zip(unknowns, numbers, strict=True):
            value = unknown.decode(float(number))
            if unknown.of_law:
                values[unknown.name] = value
            else:
                changes[unknown.name] = value
        return replace(self._base, **changes), values

    def _list_unknowns(
        self, factor: float, start: ServoStart, law: FrictionLaw
    ) -> Iterator[FitUnknown]:
        """Yield the unknowns with starts whose torques over the gain are multiplied."""
        inertia = max(float(np.mean(record.inertia)) for record in self._records)
        if _feels_gravity(self._records):
            yield _positive("body_factor", factor * max(start.body, 0.1 * start.armature / inertia))
        if len({record.added for record in self._records}) > 1:
            added = max(record.added for record in self._records)
            turned_inertia = start.body * inertia + start.armature
            yield _positive("added_factor", factor * max(turned_inertia / (inertia + added), _TINY))
        least_armature = _LEAST_SHARE * start.body * inertia
        yield _positive("armature", factor * max(start.armature, least_armature, _TINY))
        yield FitUnknown(
            name="latency",
            of_law=False,
            start=max(start.latency, 1e-3),
            scale=_LATENCY_SCALE,
            lower=0.0,
            upper=MAX_LATENCY,
            is_logarithmic=False,
            difference=_LATENCY_DIFFERENCE / _LATENCY_SCALE,
        )
        if self._kind in ("pd", "pid"):
            yield _size("kd", factor * max(start.derivative, _LEAST_SHARE * start.viscous, _TINY))
        if self._kind == "pid":
            yield _size("ki", factor * max(start.integral, _LEAST_INTEGRAL))
        yield from _list_coefficients(self._estimator, law, factor)

    def _is_incomplete(self, search: "_Search", numbers: Array) -> bool:
        """Return whether the errors are larger than the encoder's steps."""
        errors = search.compute_residual(numbers)
        return float(np.sqrt(np.mean(errors**2))) > find_encoder_step(self._records)

    def _refine(self, search: "_Search", numbers: Array) -> Array:
        """Return the numbers with fine inner steps, and keep these where they help much.

        Long steps at a stiff servo look like a filter of its commands.
        """
        coarse_squares = search.compute_squares(numbers)
        self._substep = FINE_SUBSTEP
        refined = search.minimise(numbers, _FINE_RUNS)
        if search.compute_squares(refined) < _MUCH_LESS * coarse_squares:
            return refined
        self._substep = SUBSTEP
        return numbers

    def _complete_servo(self, search: "_Search", numbers: Array) -> tuple["_Search", Array]:
        """Return the search with limits and filter of the servo, the most helpful first."""
        while True:
            best = search, numbers
            least = search.compute_squares(numbers)
            for candidate in self._list_candidates(search, numbers):
                longer, found = self._try_candidate(search, numbers, candidate)
                squares = longer.compute_squares(found)
                if squares < least:
                    best = longer, found
                    least = squares
            if best[0] is search:
                return search, numbers
            search, numbers = best

    def _list_candidates(self, search: "_Search", numbers: Array) -> Iterator[FitUnknown]:
        """Yield limits and filter of the servo if errors exceed the encoder's steps."""
        if not self._is_incomplete(search, numbers):
            return
        servo, _ = self.apply(search.unknowns, numbers)
        largest_torque = max(
            float(np.max(np.abs(delay_commands(record, servo.latency) - record.q)))
            for record in self._records
        )
        fastest = max(float(np.max(np.abs(record.dq))) for record in self._records)
        candidates = (
            _positive("torque_limit", 0.5 * largest_torque),
            _positive("command_filter", 0.05),
            _positive("speed_limit", 0.95 * fastest),
        )
        known = {unknown.name for unknown in search.unknowns}
        yield from (candidate for candidate in candidates if candidate.name not in known)

    def _try_candidate(
        self, search: "_Search", numbers: Array, candidate: FitUnknown
    ) -> tuple["_Search", Array]:
        """Return the search with one more unknown if its errors are clearly smaller."""
        longer = _Search(self, (*search.unknowns, candidate))
        starts = [np.append(numbers, candidate.encode(candidate.start))]
        if candidate.name == "command_filter":
            starts.append(self._encode_filtered_start(longer))
        searches = [longer.minimise(started, _POLISH_RUNS) for started in starts]
        found = min(searches, key=longer.compute_squares)
        squares = self._sum_blocks(search, numbers)
        fewer = self._sum_blocks(longer, found)
        # Logarithms, because the errors of a few blocks may exceed those of all others.
        gains = np.log(squares / fewer)
        spread = float(np.std(gains, ddof=1)) * np.sqrt(len(gains))
        is_clear = float(np.sum(gains)) > _CLEAR * spread
        if is_clear and float(np.sum(fewer)) < (1.0 - _WORTH) * float(np.sum(squares)):
            return longer, found
        return search, numbers

    def _sum_blocks(self, search: "_Search", numbers: Array) -> Array:
        """Return the sum of the squares (B,) of the errors of each block of time."""
        squares = search.compute_residual(numbers) ** 2
        sums = np.bincount(_number_blocks(self._records), weights=squares)
        return np.asarray(np.maximum(sums, _LEAST_SPREAD**2))

    def _encode_filtered_start(self, search: "_Search") -> Array:
        """Return the numbers of least squares whose commands pass a filter.

        A slow filter looks like viscous friction, which a search from there does not leave.
        """
        start = find_filtered_start(self._records, self._kind)
        law = _start_law(self._records, self._estimator, start)
        starts = {unknown.name: unknown.start for unknown in search.unknowns}
        starts |= {unknown.name: unknown.start for unknown in self._list_unknowns(1.0, start, law)}
        starts["command_filter"] = start.command_filter
        return _encode(search.unknowns, [starts[unknown.name] for unknown in search.unknowns])

    def _finish(self, search: "_Search", numbers: Array) -> JointFit:
        """Return the fit after last steps with the derivatives at its end."""
        jacobian = search.compute_jacobian(numbers)
        numbers, remaining = search.descend(numbers, jacobian)
        if remaining < _NEARLY:
            numbers = search.minimise(numbers, _FINE_RUNS)
            jacobian = search.compute_jacobian(numbers)
        is_reached = np.any(jacobian != 0.0, axis=0)
        if not np.all(is_reached):  # a limit beyond all that happens; nothing else has no effect
            kept = np.flatnonzero(is_reached)
            shorter = _Search(self, [search.unknowns[k] for k in kept])
            return self._finish(shorter, numbers[kept])
        unknowns = search.unknowns
        servo, values = self.apply(unknowns, numbers)
        pairs = list(zip(unknowns, numbers.tolist(), strict=True))
        slopes = np.array([unknown.slope(number) for unknown, number in pairs])
        return JointFit(
            servo=servo,
            law=replace(self.law, values=values),
            unknowns=unknowns,
            values=np.array([unknown.decode(number) for unknown, number in pairs]),
            jacobian=jacobian / slopes,
            residual=search.compute_residual(numbers),
            blocks=_number_blocks(self._records),
        )


class _Search:
    """Unknowns of a problem, and the rows that count."""

    def __init__(
        self, problem: JointProblem, unknowns: Sequence[FitUnknown], is_used: Mask | None = None
    ) -> None:
        self._problem = problem
        self.unknowns = tuple(unknowns)
        self._is_used = is_used
        self._bounds = (
            np.array([unknown.encode(unknown.lower) for unknown in self.unknowns]),
            np.array([unknown.encode(unknown.upper) for unknown in self.unknowns]),
        )

    def _find_huber(self, residual: Array) -> float:
        """Return the error [rad; m] beyond which errors (N,) count linearly."""
        if self._is_used is not None:
            residual = residual[self._is_used]
        # The median ignores the outliers that the bound is to find.
        spread = _MAD_TO_DEVIATION * float(np.median(np.abs(residual)))
        return _HUBER * max(spread, _LEAST_SPREAD)

    def compute_residual(self, numbers: Array) -> Array:
        """Return the position errors (N,); 0 where they do not count."""
        errors = self._problem.compute_errors(*self._problem.apply(self.unknowns, numbers))
        if self._is_used is None:
            return errors
        return np.where(self._is_used, errors, 0.0)

    def compute_cost(self, numbers: Array) -> float:
        """Return the mean size of the errors."""
        return float(np.mean(np.abs(self.compute_residual(numbers))))

    def compute_squares(self, numbers: Array) -> float:
        """Return the sum of the squares of the errors."""
        return float(np.sum(self.compute_residual(numbers) ** 2))

    def compute_rough_jacobian(self, numbers: Array) -> Array:
        """Return the derivatives (N, P) by differences to one side, at half the runs."""
        residual = self.compute_residual(numbers)
        columns = []
        for k, unknown in enumerate(self.unknowns):
            later = numbers.copy()
            later[k] += unknown.difference
            columns.append((self.compute_residual(later) - residual) / unknown.difference)
        return np.column_stack(columns)

    def compute_jacobian(self, numbers: Array) -> Array:
        """Return the derivatives (N, P) of the residual over the numbers of the search.

        Central differences, because the search crawls along valleys with those to one side.
        """
        columns = []
        for k, unknown in enumerate(self.unknowns):
            later = numbers.copy()
            later[k] += unknown.difference
            earlier = numbers.copy()
            lowest = unknown.encode(unknown.lower)
            earlier[k] = max(numbers[k] - unknown.difference, lowest)
            change = self.compute_residual(later) - self.compute_residual(earlier)
            columns.append(change / (later[k] - earlier[k]))
        return np.column_stack(columns)

    @staticmethod
    def _compute_loss(residual: Array, largest: float) -> float:
        """Return the sum of Huber's losses of errors (N,), linear beyond the `largest`."""
        sizes = np.abs(residual)
        linear = largest * (sizes - 0.5 * largest)
        return float(np.sum(np.where(sizes < largest, 0.5 * sizes**2, linear)))

    def descend(self, numbers: Array, jacobian: Array) -> tuple[Array, float]:
        """Return numbers after steps with one Jacobian (N, P), and the remaining share of the loss.

        It ends when the loss stops falling. Near the minimum, derivatives hardly change: a step
        takes one run instead of two for each unknown.
        """
        lower, upper = self._bounds
        residual = self.compute_residual(numbers)
        largest = self._find_huber(residual)
        first_loss = self._compute_loss(residual, largest)
        loss = first_loss
        for _ in range(_DESCENTS):
            roots = np.sqrt(np.minimum(1.0, largest / np.maximum(np.abs(residual), 1e-300)))
            sizes = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
            step = np.linalg.lstsq(roots[:, None] * (jacobian / sizes), -roots * residual)[0]
            later = np.clip(numbers + step / sizes, lower + _INSIDE, upper - _INSIDE)
            later_residual = self.compute_residual(later)
            later_loss = self._compute_loss(later_residual, largest)
            if not later_loss < loss:
                break
            is_settled = later_loss > (1.0 - _SETTLED) * loss
            numbers = later
            residual = later_residual
            loss = later_loss
            if is_settled:
                break
        return numbers, loss / max(first_loss, 1e-300)

    def minimise(self, numbers: Array, runs: int, *, is_rough: bool = False) -> Array:
        """Return the numbers of the least Huber loss within some evaluations.

        A rough search, which compares starts, takes differences to one side.
        """
        lower, upper = self._bounds
        result = scipy.optimize.least_squares(
            self.compute_residual,
            np.clip(numbers, lower + _INSIDE, upper - _INSIDE),
            jac=self.compute_rough_jacobian if is_rough else self.compute_jacobian,
            bounds=(lower, upper),
            loss="huber",
            f_scale=self._find_huber(self.compute_residual(numbers)),
            x_scale="jac",
            max_nfev=runs,
            xtol=1e-7,
            ftol=1e-6,
        )
        return np.asarray(result.x)


def _select_seconds(records: Sequence[ServoRecord], seconds: float) -> Sequence[ServoRecord]:
    """Return the records that move the joint most, at most some seconds, but at least one."""
    by_motion = sorted(records, key=lambda record: -float(np.std(record.dq)))
    selected: list[ServoRecord] = []
    duration = 0.0
    for record in by_motion:
        length = float(record.t[-1])
        if not selected or duration + length <= seconds:
            selected.append(record)
            duration += length
    return selected


def _positive(name: str, start: float) -> FitUnknown:
    """Return an unknown of the servo that changes by factors."""
    size = _size(name, start)
    lower = start / _LARGEST
    return replace(size, lower=lower, upper=start * _LARGEST, is_logarithmic=True)


def _size(name: str, start: float) -> FitUnknown:
    """Return an unknown of the servo that may be 0."""
    return FitUnknown(
        name=name,
        of_law=False,
        start=start,
        scale=start,
        lower=0.0,
        upper=np.inf,
        is_logarithmic=False,
    )


def _encode_starts(unknowns: Sequence[FitUnknown]) -> Array:
    return _encode(unknowns, [unknown.start for unknown in unknowns])


def _encode(unknowns: Sequence[FitUnknown], values: Iterable[float]) -> Array:
    return np.array(
        [unknown.encode(float(value)) for unknown, value in zip(unknowns, values, strict=True)]
    )


def _feels_gravity(records: Sequence[ServoRecord]) -> bool:
    """Return whether the bodies do more than a constant inertia, which the armature absorbs."""
    for record in records:
        inertial = float(np.ptp(record.inertia * record.ddq))
        varies = float(np.ptp(record.inertia)) > _TINY * float(np.max(record.inertia))
        if varies or float(np.ptp(record.bias)) > _TINY * inertial:
            return True
    return False


def _start_law(
    records: Sequence[ServoRecord], law: type[Estimator], start: ServoStart
) -> FrictionLaw:
    """Return the law fitted to what the servo's error leaves by least squares."""
    friction = separate_friction(records, start)
    fitted_law = law().fit(friction, np.random.default_rng(0))
    values = dict(fitted_law.values)
    # An offset of the torque acts like a bias of the encoder; both count as 0.
    if TAU_0.name in values:
        values[TAU_0.name] = 0.0
    return replace(fitted_law, values=values)


def _simplify_law(law: type[Estimator], fitted: FrictionLaw, start: ServoStart) -> FrictionLaw:
    """Return a law that starts as Coulomb and viscous friction, as far as it has such terms.

    Least squares of many terms to a servo's error may start a fit far from its minimum.
    """
    sizes = {F_C.name: start.coulomb, F_S.name: start.coulomb, SIGMA_2.name: start.viscous}
    linear_names = _find_space(law, fitted).linear
    values = {}
    for name, value in fitted.values.items():
        values[name] = value
        if name in linear_names:
            values[name] = sizes.get(name, 0.0)
    return replace(fitted, values=values)


def _list_coefficients(
    law: type[Estimator], started: FrictionLaw, factor: float
) -> Iterator[FitUnknown]:
    """Yield the coefficients of a law: torques by size, searched numbers by factors."""
    space = _find_space(law, started)
    bounds = dict(space.bounds)
    non_negative = set(space.linear[: space.non_negative])
    largest = max((abs(started.values[name]) for name in space.linear), default=0.0)
    for name, value in started.values.items():
        if name in bounds:
            lower, upper = bounds[name]
            yield FitUnknown(
                name=name,
                of_law=True,
                start=float(np.clip(value, 1.01 * lower, 0.99 * upper)),
                scale=1.0,
                lower=lower,
                upper=upper,
                is_logarithmic=lower > 0.0,
            )
        elif name in space.linear and name != TAU_0.name:
            scale = factor * max(abs(value), _LEAST_SHARE * largest, _TINY)
            yield FitUnknown(
                name=name,
                of_law=True,
                start=scale,
                scale=scale,
                lower=0.0 if name in non_negative else -np.inf,
                upper=np.inf,
                is_logarithmic=False,
            )


def _find_space(law: type[Estimator], started: FrictionLaw) -> SearchSpace:
    """Return which coefficients are searched, linear, and not negative."""
    if issubclass(law, OneForm):
        return law().build_fitted_space(started)
    # Baselines: sizes of friction, and an offset.
    names = tuple(name for name in started.values if name != TAU_0.name)
    return SearchSpace(bounds=(), linear=names, non_negative=len(names))


def _number_blocks(records: Sequence[ServoRecord]) -> Integers:
    """Return the number of the block of time of each row, over all records."""
    numbers = []
    first = 0
    for record in records:
        blocks = np.floor(record.t / _BLOCK).astype(int)
        numbers.append(first + blocks)
        first += int(blocks[-1]) + 1
    return np.concatenate(numbers)
