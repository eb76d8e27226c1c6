"""Replicates: motions that occur more than once, and the part of squared errors that repeats.

Laws are deterministic: what differs between replicates of a motion, no law of the motion predicts.
The repeating part is the mean product of the errors at the same place of two replicates, which
equals the variance between means less that within over R (one-way analysis of variance). Noise has
no covariance between replicates, thus interpolation between rows does not bias it.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.rest import MOVING, find_resting_speeds
from hesr_model.logs.signals import Grid, moving, zero_phase
from hesr_model.support.arrays import Array

HIGH_FREQUENCY = 5.0  # [Hz] above which errors are also split
WINDOW_SECONDS = 1.0  # length of the motions that are compared; each is aligned by itself
_HOP_SECONDS = 0.5
_RATE = 50.0  # [Hz] of the search; aligned motions are compared between its samples
# RMS difference in a window, over the joint's RMS speed or standard deviation of position. Repeated
# sines of a UR10e agree to 0.4 %; speeds of noisier encoders to 1 %.
MAX_DIFFERENCE = 0.02
_MAX_COARSE_DIFFERENCE = 0.25  # of a sample of the search: half a step apart at up to 4 Hz
# Short motions resemble each other by chance, hence a replicate lasts this long.
MIN_SECONDS = 5.0
_MAX_LAG_CHANGE = 0.1  # [s] from window to window of a replicate, for periods that drift
MAX_SEARCHED_SECONDS = 600.0  # of all logs: the time of the search rises with its square
_ALIGNMENT_STEPS = 4
# Smallest scales of position [rad or m] and velocity [rad/s or m/s]: those of a joint at rest. Its
# position may then differ by 1 mrad, and its velocity by a tenth of what counts as moving.
_MIN_TRAVEL = 0.05
_MIN_SPEED = 0.1
MAX_PLACES = 8  # replicates of a motion that are compared, since their pairs rise with the square
_MIN_REPETITIONS = 3  # windows, for a standard error
# Distance of rows that coincide, in row periods, and their smallest share of all rows. Products of
# errors at a third of the rate are damped by at most 0.6 %.
_MAX_COINCIDENCE = 0.05
_MIN_COINCIDING = 0.1
_STANDARD_ERRORS = 1.96  # half width of the interval
_MAX_CORRELATION = 0.8  # of the shares of neighbouring windows; more cannot be estimated


@dataclass(frozen=True, kw_only=True, eq=False)
class RobotMotion:
    """Motion of all joints in a log without gaps.

    Attributes
    ----------
    t : (N,) time [s].
    q : (N, n) position [rad or m].
    dq : (N, n) smoothed velocity [rad/s or m/s].
    """

    t: Array
    q: Array
    dq: Array


class MotionPlace(NamedTuple):
    """MotionPlace of a replicate: index of its log, and its first time [s]."""

    log: int
    start: float


@dataclass(frozen=True, kw_only=True)
class Repetition:
    """Motion of `WINDOW_SECONDS` that all joints make at two or more places, which share no row."""

    places: tuple[MotionPlace, ...]


@dataclass(frozen=True, kw_only=True)
class ErrorSplit:
    """Parts of the squared error of one joint on repeated rows.

    Attributes
    ----------
    rmse : error on the repeated rows [N.m].
    repeats : share of the squared error that is equal in all replicates.
    low, high : 95 % interval of `repeats`.
    smooth : the share that also repeats between rows, where errors are interpolated. It lacks what
        changes faster than the rows, which repeats at the same instant only.
    """

    rmse: float
    repeats: float
    low: float
    high: float
    smooth: float

    @property
    def noise(self) -> float:
        """Share of the squared error that does not repeat."""
        return 1.0 - self.repeats

    @property
    def left_to_gain(self) -> float:
        """Smallest RMSE of a law of the motion, over this one."""
        return float(np.sqrt(self.noise))


def find_repetitions(trajectories: Sequence[RobotMotion]) -> list[Repetition]:
    """Find motions that all joints make more than once, in a log or in several.

    Windows of motion are aligned in time with all later ones and compared in position and velocity.
    Those that agree to `MAX_DIFFERENCE` over `MIN_SECONDS` are replicates. Windows in which all
    joints rest are not compared.

    Parameters
    ----------
    trajectories : logs, or their parts between gaps, of the same joints; at most the first
        `MAX_SEARCHED_SECONDS` are searched.
    """
    searched = _select_searched(trajectories)
    if not searched:
        return []
    scales = _Scales.from_trajectories(list(searched.values()))
    logs = {index: _SearchedLog(trajectory, scales) for index, trajectory in searched.items()}
    matches: list[_Match] = []
    for index, log in logs.items():
        later_logs = {other: logs[other] for other in logs if other >= index}
        matches += _match_windows(index, log, later_logs)
    return _collect_repetitions(_keep_long_matches(matches))


def split_errors(
    times: Sequence[Array], errors: Sequence[Array], repetitions: Sequence[Repetition]
) -> tuple[ErrorSplit, ...]:
    """Split squared errors of a joint into a repeating part and the rest.

    Parameters
    ----------
    times : by log, (N,) [s].
    errors : by log, (N, K) [N.m], one column per law.
    repetitions : places of equal motion; see `find_repetitions`.

    Returns
    -------
    One split per column; empty without repetitions.
    """
    if len(repetitions) < _MIN_REPETITIONS:
        return ()
    splines = _ErrorSplines(times, errors)
    windows = [
        _compare_replicates(times, errors, splines, repetition) for repetition in repetitions
    ]
    coinciding = sum(window.coinciding for window in windows)
    compared = sum(window.compared for window in windows)
    comparison = _Comparison.ROWS
    if coinciding >= _MIN_COINCIDING * compared:
        comparison = _Comparison.COINCIDING  # nothing is interpolated
    shares, std_errors = _estimate_shares(windows, comparison)
    smooth_shares, _ = _estimate_shares(windows, _Comparison.SMOOTH)
    squares = np.sum([window.squares for window in windows], axis=0)
    row_count = sum(window.row_count for window in windows)
    half_widths = _STANDARD_ERRORS * std_errors
    return tuple(
        ErrorSplit(
            rmse=float(np.sqrt(squares[k] / row_count)),
            repeats=_clip_share(share),
            low=_clip_share(share - half_widths[k]),
            high=_clip_share(share + half_widths[k]),
            smooth=_clip_share(smooth_shares[k]),
        )
        for k, share in enumerate(shares)
    )


def _clip_share(share: float) -> float:
    return float(np.clip(share, 0.0, 1.0))


def high_pass_errors(t: Array, errors: Array) -> Array | None:
    """Return errors (N, K) above `HIGH_FREQUENCY`; None if the rows at t (N,) do not allow it."""
    try:
        Grid.from_times(t).require_filter("errors", len(t), HIGH_FREQUENCY)
    except LogError:
        return None
    return np.asarray(errors - zero_phase(t, errors, HIGH_FREQUENCY)(t))


def count_rows(times: Sequence[Array], repetitions: Sequence[Repetition]) -> int:
    """Return the number of rows of all replicates."""
    count = 0
    for repetition in repetitions:
        for place in repetition.places:
            rows = _select_rows(times, place)
            count += rows.stop - rows.start
    return count


def find_period(repetitions: Sequence[Repetition]) -> float | None:
    """Return the median time [s] between replicates that follow each other in a log."""
    distances = []
    for repetition in repetitions:
        for place, next_place in zip(repetition.places, repetition.places[1:], strict=False):
            if place.log == next_place.log:
                distances.append(next_place.start - place.start)
    if not distances:
        return None
    return float(np.median(distances))


def _select_searched(trajectories: Sequence[RobotMotion]) -> dict[int, RobotMotion]:
    """Return the trajectories by index that last a window, up to `MAX_SEARCHED_SECONDS` of all."""
    searched = {}
    left_seconds = MAX_SEARCHED_SECONDS
    for index, trajectory in enumerate(trajectories):
        rows = trajectory.t - trajectory.t[0] <= left_seconds
        t = trajectory.t[rows]
        duration = float(t[-1] - t[0])
        if len(t) >= 4 and duration > WINDOW_SECONDS:  # a cubic spline needs four rows
            searched[index] = RobotMotion(t=t, q=trajectory.q[rows], dq=trajectory.dq[rows])
            left_seconds -= duration
    return searched


class _Scales(NamedTuple):
    """Sizes of position [rad or m] and velocity [rad/s or m/s] by joint, and mean positions."""

    q_mean: Array
    q: Array
    dq: Array
    resting_speeds: Array

    @classmethod
    def from_trajectories(cls, trajectories: Sequence[RobotMotion]) -> "_Scales":
        """Return the scales over the logs in which a joint moves, none below that of a rest."""
        joint_count = trajectories[0].q.shape[1]
        resting_speeds = find_resting_speeds(
            [trajectory.t for trajectory in trajectories],
            [trajectory.q for trajectory in trajectories],
            [trajectory.dq for trajectory in trajectories],
        )
        q_squares = np.zeros(joint_count)
        dq_squares = np.zeros(joint_count)
        q_counts = np.zeros(joint_count)
        dq_counts = np.zeros(joint_count)
        for trajectory in trajectories:
            is_moving = moving(trajectory.dq, resting_speeds)
            moves = is_moving.any(axis=0)
            q_squares += moves * len(trajectory.t) * np.var(trajectory.q, axis=0)
            q_counts += moves * len(trajectory.t)
            dq_squares += np.sum(np.square(trajectory.dq) * is_moving, axis=0)
            dq_counts += np.count_nonzero(is_moving, axis=0)
        q_scale = np.sqrt(q_squares / np.maximum(q_counts, 1.0))
        dq_scale = np.sqrt(dq_squares / np.maximum(dq_counts, 1.0))
        # A slow joint that moves has no scale of a joint at rest.
        is_slow = resting_speeds < MOVING
        return cls(
            q_mean=np.mean(np.concatenate([trajectory.q for trajectory in trajectories]), axis=0),
            q=np.where(is_slow, q_scale, np.maximum(q_scale, _MIN_TRAVEL)),
            dq=np.where(is_slow, dq_scale, np.maximum(dq_scale, _MIN_SPEED)),
            resting_speeds=resting_speeds,
        )


class _SearchedLog:
    """Scaled motion of a log: spline of positions and velocities, and its samples at `_RATE`."""

    def __init__(self, trajectory: RobotMotion, scales: _Scales) -> None:
        from scipy.interpolate import make_interp_spline

        q = (trajectory.q - scales.q_mean) / scales.q
        dq = trajectory.dq / scales.dq
        self.t = trajectory.t
        self.joint_count = q.shape[1]
        self.spline = make_interp_spline(trajectory.t, np.hstack([q, dq]), k=3)
        self.slope = self.spline.derivative()
        self.stamps = np.arange(trajectory.t[0], trajectory.t[-1], 1.0 / _RATE)
        self.samples = np.asarray(self.spline(self.stamps))
        speeds = np.abs(self.samples[:, self.joint_count :]) * scales.dq
        self.is_moving = np.any(speeds > scales.resting_speeds, axis=1)

    @cached_property
    def spectrum(self) -> Array:
        """Spectrum of the samples, padded against wrapping."""
        return np.asarray(np.fft.rfft(self.samples, self.spectrum_rows, axis=0))

    @property
    def spectrum_rows(self) -> int:
        """Number of rows, padded, of the spectrum."""
        return int(2 ** np.ceil(np.log2(len(self.samples) + _WINDOW_ROWS)))

    @cached_property
    def window_squares(self) -> Array:
        """Sum of squares of the samples in the window that begins at each sample."""
        sums = np.concatenate([[0.0], np.cumsum(np.sum(np.square(self.samples), axis=1))])
        return np.asarray(sums[_WINDOW_ROWS:] - sums[:-_WINDOW_ROWS])

    def compute_distances(self, window: Array) -> Array:
        """Return the mean squared distance of a window to those that begin at each sample."""
        window_spectrum = np.fft.rfft(window, self.spectrum_rows, axis=0)
        product_spectrum = np.sum(self.spectrum * window_spectrum.conj(), axis=1)
        products = np.fft.irfft(product_spectrum, self.spectrum_rows)[: len(self.window_squares)]
        squares = np.sum(np.square(window)) + self.window_squares - 2.0 * products
        return np.asarray(squares / _WINDOW_ROWS)


_WINDOW_ROWS = round(WINDOW_SECONDS * _RATE)
_HOP_ROWS = round(_HOP_SECONDS * _RATE)
_PHASES = np.arange(_WINDOW_ROWS) / _RATE  # [s]


class _Match(NamedTuple):
    """Window of a log, by its number among those with motion, and a later place of its motion."""

    number: int
    window: MotionPlace
    place: MotionPlace


def _match_windows(
    index: int, log: _SearchedLog, later_logs: dict[int, _SearchedLog]
) -> Iterator[_Match]:
    """Yield the places, in this log and later ones, of the motions in all windows of a log."""
    number = 0
    for row in range(0, len(log.samples) - _WINDOW_ROWS + 1, _HOP_ROWS):
        if np.mean(log.is_moving[row : row + _WINDOW_ROWS]) < 0.5:
            continue
        number += 1
        window = MotionPlace(index, float(log.stamps[row]))
        for other_index, other in later_logs.items():
            first_row = 0
            if other_index == index:
                first_row = row + _WINDOW_ROWS  # a window shares no row with its replicates
            for start in _find_starts(log, row, other, first_row):
                yield _Match(number, window, MotionPlace(other_index, start))


def _find_starts(log: _SearchedLog, row: int, other: _SearchedLog, first_row: int) -> list[float]:
    """Return the times [s] at which the motion of a window begins in a log, in order."""
    window = log.samples[row : row + _WINDOW_ROWS]
    if len(other.samples) < first_row + _WINDOW_ROWS:
        return []
    distances = other.compute_distances(window)
    limit = 2.0 * log.joint_count * _MAX_COARSE_DIFFERENCE**2
    padded = np.concatenate([[np.inf], distances, [np.inf]])
    is_minimum = (distances <= padded[:-2]) & (distances < padded[2:]) & (distances < limit)
    starts: list[float] = []
    for candidate in np.flatnonzero(is_minimum[first_row:]) + first_row:
        start = _align(window, other, float(other.stamps[candidate]))
        if start is not None:
            starts.append(start)
        if len(starts) == MAX_PLACES - 1:  # the next ones are the same for neighbouring windows
            break
    return starts


def _align(window: Array, other: _SearchedLog, start: float) -> float | None:
    """Return the time [s] at which a window agrees best with a log; None if it does not."""
    latest = float(other.t[-1]) - float(_PHASES[-1])
    for _ in range(_ALIGNMENT_STEPS):
        start = min(max(start, float(other.t[0])), latest)
        slope = other.slope(start + _PHASES)
        difference = other.spline(start + _PHASES) - window
        start -= float(np.sum(slope * difference) / np.maximum(np.sum(np.square(slope)), 1e-300))
    start = min(max(start, float(other.t[0])), latest)
    difference = other.spline(start + _PHASES) - window
    largest = float(np.sqrt(np.mean(np.square(difference), axis=0)).max())
    if largest > MAX_DIFFERENCE:
        return None
    return start


def _keep_long_matches(matches: Sequence[_Match]) -> list[_Match]:
    """Return the matches in runs of neighbouring windows that last at least `MIN_SECONDS`."""
    needed = round((MIN_SECONDS - WINDOW_SECONDS) / _HOP_SECONDS) + 1
    by_window: dict[tuple[int, int, int], list[_Match]] = defaultdict(list)
    for match in matches:
        by_window[match.window.log, match.place.log, match.number].append(match)

    def find_neighbour(match: _Match, step: int) -> _Match | None:
        lag = match.place.start - match.window.start
        neighbours = by_window.get((match.window.log, match.place.log, match.number + step), [])
        for neighbour in neighbours:
            if abs(neighbour.place.start - neighbour.window.start - lag) <= _MAX_LAG_CHANGE:
                return neighbour
        return None

    long_matches = []
    for match in matches:
        length = 1
        for step in (-1, 1):
            neighbour = find_neighbour(match, step)
            while neighbour is not None and length < needed:
                length += 1
                neighbour = find_neighbour(neighbour, step)
        if length >= needed:
            long_matches.append(match)
    return long_matches


def _collect_repetitions(matches: Sequence[_Match]) -> list[Repetition]:
    """Return repetitions whose places share no row, from the first window on."""
    places_of_window: dict[MotionPlace, list[MotionPlace]] = defaultdict(list)
    for match in matches:
        places_of_window[match.window].append(match.place)
    starts_by_log: dict[int, list[float]] = defaultdict(list)  # of places that are in use

    def is_free(place: MotionPlace) -> bool:
        # Windows that follow each other touch; alignment moves them by parts of a row.
        return all(
            abs(start - place.start) > WINDOW_SECONDS - 1.0 / _RATE
            for start in starts_by_log[place.log]
        )

    repetitions = []
    for window in sorted(places_of_window):
        if not is_free(window):
            continue
        places = [window]
        starts_by_log[window.log].append(window.start)
        for place in sorted(places_of_window[window]):
            if is_free(place):
                places.append(place)
                starts_by_log[place.log].append(place.start)
        if len(places) > 1:
            # Evenly chosen, so that slow changes over a log count as they are.
            chosen = np.unique(np.linspace(0, len(places) - 1, MAX_PLACES).round().astype(int))
            repetitions.append(Repetition(places=tuple(places[k] for k in chosen)))
        else:
            starts_by_log[window.log].remove(window.start)
    return repetitions


class _Comparison(IntEnum):
    """Ways to compare the errors of two replicates."""

    COINCIDING = 0  # rows of both at the same place of the motion
    ROWS = 1  # rows of one with interpolated errors of the other
    SMOOTH = 2  # interpolated errors of both


class _WindowParts(NamedTuple):
    """Sums of a repetition.

    `sums` (P, 3, 2, K) has by pair of replicates and kind of comparison the products of their
    errors and their mean squares; `squares` (K,) is over all rows.
    """

    pairs: list[tuple[int, int]]
    sums: Array
    coinciding: int  # rows of all pairs that coincide
    compared: int  # rows of all pairs
    squares: Array
    row_count: int


class _ErrorSplines:
    """Splines through the errors (N, K) of each log, built when used."""

    def __init__(self, times: Sequence[Array], errors: Sequence[Array]) -> None:
        self._times = times
        self._errors = errors
        self._splines: dict[int, Any] = {}

    def evaluate(self, log: int, t: Array) -> Array:
        """Return the errors (len(t), K) of a log at times [s], held beyond its ends."""
        from scipy.interpolate import make_interp_spline

        if log not in self._splines:
            self._splines[log] = make_interp_spline(self._times[log], self._errors[log], k=3)
        times = self._times[log]
        return np.asarray(self._splines[log](np.clip(t, times[0], times[-1])))


def _select_rows(times: Sequence[Array], place: MotionPlace) -> slice:
    """Return the rows of a replicate."""
    ends = (place.start, place.start + WINDOW_SECONDS)
    first, last = np.searchsorted(times[place.log], ends)
    return slice(int(first), int(last))


def _compare_replicates(
    times: Sequence[Array],
    errors: Sequence[Array],
    splines: _ErrorSplines,
    repetition: Repetition,
) -> _WindowParts:
    """Return the sums of a repetition."""
    places = repetition.places
    own_errors = []
    phases = []
    for place in places:
        rows = _select_rows(times, place)
        own_errors.append(errors[place.log][rows])
        phases.append(times[place.log][rows] - place.start)
    period = WINDOW_SECONDS / max(len(phases[0]), 1)
    even_phases = np.arange(0.0, WINDOW_SECONDS, period)
    smooth_errors = [splines.evaluate(place.log, place.start + even_phases) for place in places]
    pairs = list(combinations(range(len(places)), 2))
    sums = np.zeros((len(pairs), len(_Comparison), 2, errors[0].shape[1]))
    coinciding = 0
    compared = 0
    for number, (first, second) in enumerate(pairs):
        nearest, distances = _find_nearest(phases[first], phases[second])
        coincide = distances <= _MAX_COINCIDENCE * period
        coinciding += int(np.count_nonzero(coincide))
        compared += len(distances)
        sums[number, _Comparison.COINCIDING] = _sum_products(
            own_errors[first][coincide], own_errors[second][nearest[coincide]]
        )
        at_rows = splines.evaluate(places[second].log, places[second].start + phases[first])
        sums[number, _Comparison.ROWS] = _sum_products(own_errors[first], at_rows)
        # Interpolation damps noise, but not in the rows themselves.
        own_squares = np.sum(np.square(own_errors[second]), axis=0)
        own_squares *= len(phases[first]) / max(len(phases[second]), 1)
        own_squares += np.sum(np.square(own_errors[first]), axis=0)
        sums[number, _Comparison.ROWS, 1] = 0.5 * own_squares
        sums[number, _Comparison.SMOOTH] = _sum_products(
            smooth_errors[first], smooth_errors[second]
        )
    all_errors = np.concatenate(own_errors)
    return _WindowParts(
        pairs=pairs,
        sums=sums,
        coinciding=coinciding,
        compared=compared,
        squares=np.sum(np.square(all_errors), axis=0),
        row_count=len(all_errors),
    )


def _find_nearest(phases: Array, other_phases: Array) -> tuple[Array, Array]:
    """Return the indices of the nearest other phases, and their distances [s]."""
    after = np.clip(np.searchsorted(other_phases, phases), 1, len(other_phases) - 1)
    is_before = phases - other_phases[after - 1] < other_phases[after] - phases
    nearest = np.where(is_before, after - 1, after)
    return nearest, np.abs(other_phases[nearest] - phases)


def _sum_products(errors: Array, other_errors: Array) -> Array:
    """Return the sums (2, K) of products, and of mean squares, of two errors (N, K)."""
    products = np.sum(errors * other_errors, axis=0)
    squares = np.sum(np.square(errors) + np.square(other_errors), axis=0)
    return np.stack([products, 0.5 * squares])


def _estimate_shares(
    windows: Sequence[_WindowParts], comparison: _Comparison
) -> tuple[Array, Array]:
    """Return the shares (K,) of squared errors that repeat, and their standard errors."""
    # Each row counts once, however many pairs compare it.
    sums = np.array(
        [window.sums[:, comparison].sum(axis=0) / (len(window.pairs)) for window in windows]
    )
    weights = np.array(
        [window.row_count / window.compared * len(window.pairs) for window in windows]
    )
    products, squares = np.moveaxis(sums * weights[:, None, None], 1, 0)
    total = np.maximum(squares.sum(axis=0), np.finfo(float).tiny)
    shares = products.sum(axis=0) / total
    influences = (products - shares * squares) / total
    std_errors = np.maximum(
        _estimate_window_errors(influences), _estimate_replicate_errors(windows, comparison)
    )
    return shares, std_errors


def _estimate_window_errors(influences: Array) -> Array:
    """Return standard errors (K,) from the influences (M, K) of windows, neighbours correlated."""
    count = len(influences)
    variances = np.sum(np.square(influences), axis=0)
    neighbours = np.sum(influences[1:] * influences[:-1], axis=0)
    correlations = np.clip(neighbours / np.maximum(variances, 1e-300), 0.0, _MAX_CORRELATION)
    inflation = (1.0 + correlations) / (1.0 - correlations)
    return np.asarray(np.sqrt(variances * count / (count - 1) * inflation))


def _estimate_replicate_errors(windows: Sequence[_WindowParts], comparison: _Comparison) -> Array:
    """Return standard errors (K,) by leaving out each replicate (jackknife); 0 with only two.

    A level that changes from replicate to replicate shows here, not between windows.
    """
    count = min(window.pairs[-1][1] + 1 for window in windows)
    law_count = windows[0].sums.shape[-1]
    if count < 3:
        return np.zeros(law_count)
    shares = []
    for left_out in range(count):
        sums = np.zeros((2, law_count))
        for window in windows:
            others = [number for number, pair in enumerate(window.pairs) if left_out not in pair]
            sums += window.sums[others, comparison].sum(axis=0)
        shares.append(sums[0] / np.maximum(sums[1], np.finfo(float).tiny))
    deviations = np.array(shares) - np.mean(shares, axis=0)
    return np.asarray(np.sqrt((count - 1) / count * np.sum(np.square(deviations), axis=0)))
