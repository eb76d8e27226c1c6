"""Replicates of motions, and the parts of squared errors that repeat and that do not."""

from collections.abc import Callable

import numpy as np
import pytest

from hesr_model.inference.replicates import (
    ErrorSplit,
    Repetition,
    RobotMotion,
    count_rows,
    find_period,
    find_repetitions,
    high_pass_errors,
    split_errors,
)
from hesr_model.support.arrays import Array

RATE = 100.0  # [Hz]


def sine(
    duration: float = 41.0, period: float = 8.0, amplitude: float = 1.0, phase: float = 0.0
) -> RobotMotion:
    """Two joints; the second one moves in the opposite direction at twice the frequency."""
    t = np.arange(0.0, duration, 1.0 / RATE)
    angle = 2.0 * np.pi * (t / period + phase)
    q = amplitude * np.column_stack([np.cos(angle), -0.5 * np.cos(2.0 * angle)])
    dq = 2.0 * np.pi / period * amplitude * np.column_stack([-np.sin(angle), np.sin(2.0 * angle)])
    return RobotMotion(t=t, q=q, dq=dq)


def multisine(seed: int, duration: float = 12.0, start: float = 0.0) -> RobotMotion:
    """One joint in a sum of sines, from a time [s] on."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, duration, 1.0 / RATE)
    frequencies = np.array([0.11, 0.23, 0.31, 0.43])
    angles = 2.0 * np.pi * (np.outer(t + start, frequencies) + rng.random(4))
    amplitudes = rng.uniform(0.5, 1.0, 4)
    q = np.sin(angles) @ amplitudes
    dq = np.cos(angles) @ (amplitudes * 2.0 * np.pi * frequencies)
    return RobotMotion(t=t, q=q[:, None], dq=dq[:, None])


def join(*trajectories: RobotMotion) -> RobotMotion:
    """One after the other, with steps between them."""
    q = np.concatenate([trajectory.q for trajectory in trajectories])
    dq = np.concatenate([trajectory.dq for trajectory in trajectories])
    return RobotMotion(t=np.arange(len(q)) / RATE, q=q, dq=dq)


def repeating(trajectory: RobotMotion) -> Array:
    """An error with RMS 1 that is a function of the motion, up to 10 Hz."""
    ripple = np.sqrt(2.0) * np.sin(40.0 * trajectory.q[:, 0])
    return np.asarray(ripple / np.sqrt(np.mean(np.square(ripple))))


def split_one(trajectory: RobotMotion, error: Array) -> ErrorSplit:
    repetitions = find_repetitions([trajectory])
    return split_errors([trajectory.t], [error[:, None]], repetitions)[0]


@pytest.mark.parametrize("noise", [0.0, 0.5, 2.0])
def test_known_shares_of_a_sine(noise: float) -> None:
    trajectory = sine()
    rng = np.random.default_rng(1)
    error = repeating(trajectory) + noise * rng.normal(size=len(trajectory.t))
    split = split_one(trajectory, error)
    expected = 1.0 / (1.0 + noise**2)
    assert split.repeats == pytest.approx(expected, abs=0.03)
    assert split.low - 1e-9 <= expected <= split.high + 1e-9
    assert split.rmse == pytest.approx(np.sqrt(1.0 + noise**2), rel=0.03)
    assert split.left_to_gain == pytest.approx(np.sqrt(1.0 - expected), abs=0.05)


def test_estimate_is_unbiased_and_its_interval_holds() -> None:
    trajectory = sine(duration=25.0)  # three periods
    repetitions = find_repetitions([trajectory])
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(len(trajectory.t), 200))
    errors = 0.5 * repeating(trajectory)[:, None] + noise
    splits = split_errors([trajectory.t], [errors], repetitions)
    assert np.mean([split.repeats for split in splits]) == pytest.approx(0.2, abs=0.005)
    covered = [split.low <= 0.2 <= split.high for split in splits]
    assert np.mean(covered) >= 0.9


def test_noise_alone_repeats_nothing() -> None:
    trajectory = sine()
    error = np.random.default_rng(3).normal(size=len(trajectory.t))
    split = split_one(trajectory, error)
    assert split.repeats < 0.05
    assert split.low == 0.0


def test_a_level_that_drifts_does_not_repeat() -> None:
    trajectory = sine(duration=48.5)
    # Levels of six periods, whose variance about their mean is 1 and whose mean is 0.
    period = np.minimum(trajectory.t // 8.0, 5.0)
    level = (period - 2.5) / np.std(np.arange(6.0))
    split = split_one(trajectory, repeating(trajectory) + level)
    # With the unbiased variance between six levels, 1.2, the mean level is worth -0.2.
    assert split.repeats == pytest.approx(0.8 / 2.0, abs=0.03)
    assert split.high - split.low > 0.1


def test_periods_may_differ_slightly() -> None:
    periods = [sine(duration=seconds, period=seconds) for seconds in (8.0, 8.05, 7.96, 8.03, 8.0)]
    trajectory = join(*periods)
    repetitions = find_repetitions([trajectory])
    assert find_period(repetitions) == pytest.approx(8.0, abs=0.05)
    error = np.sqrt(2.0) * np.sin(20.0 * trajectory.q[:, 0])
    noise = np.random.default_rng(4).normal(size=(len(error), 20))
    errors = error[:, None] + np.sqrt(np.mean(np.square(error))) * noise
    splits = split_errors([trajectory.t], [errors], repetitions)
    assert np.mean([split.repeats for split in splits]) == pytest.approx(0.5, abs=0.015)


def test_rows_that_never_coincide_are_interpolated() -> None:
    # Two periods: rows of the second one lie between those of the first.
    trajectory = sine(duration=17.0, period=8.0045)
    noise = np.random.default_rng(5).normal(size=(len(trajectory.t), 20))
    errors = repeating(trajectory)[:, None] + noise
    splits = split_errors([trajectory.t], [errors], find_repetitions([trajectory]))
    repeats = np.mean([split.repeats for split in splits])
    assert repeats == pytest.approx(0.5, abs=0.015)
    # Interpolation damps the noise of both.
    assert np.mean([split.smooth for split in splits]) > repeats + 0.02


def test_high_frequencies_are_split_by_themselves() -> None:
    trajectory = sine()
    slow = 2.0 * np.sin(2.0 * np.pi * 0.7 * trajectory.t)  # of no period of the motion
    fast = np.sqrt(2.0) * np.sin(2.0 * np.pi * 10.0 * trajectory.t)  # 80 per period
    errors = high_pass_errors(trajectory.t, (slow + fast)[:, None])
    assert errors is not None
    (split,) = split_errors([trajectory.t], [errors], find_repetitions([trajectory]))
    assert split.repeats > 0.95
    assert high_pass_errors(trajectory.t[::20], errors[::20]) is None  # 5 Hz


def replicated(*trajectories: RobotMotion) -> list[Repetition]:
    return find_repetitions(trajectories)


def test_period_and_rows_of_a_sine() -> None:
    trajectory = sine()
    repetitions = replicated(trajectory)
    assert find_period(repetitions) == pytest.approx(8.0, abs=1e-3)
    assert {len(repetition.places) for repetition in repetitions} <= {5, 6}
    assert count_rows([trajectory.t], repetitions) == pytest.approx(len(trajectory.t), rel=0.05)


def test_motion_of_another_log_and_of_another_time_of_a_log() -> None:
    first = multisine(1)
    later = multisine(1, duration=9.0, start=2.0)  # the same motion, cut differently
    other = multisine(2)
    for trajectories in ([first, later], [first, other, later], [join(first, other, later)]):
        repetitions = find_repetitions(trajectories)
        assert 7 <= len(repetitions) <= 9
        for repetition in repetitions:
            assert len(repetition.places) == 2
    assert find_period(find_repetitions([first, later])) is None


ONE_OF_A_KIND: dict[str, Callable[[], list[RobotMotion]]] = {
    "one period": lambda: [sine(duration=8.0)],
    "different motions": lambda: [multisine(1), multisine(2)],
    "amplitudes": lambda: [sine(duration=8.0), sine(duration=8.0, amplitude=1.05)],
    "frequencies": lambda: [sine(duration=8.0), sine(duration=8.4, period=8.4)],
    "the other joint": lambda: [
        sine(duration=8.0),
        RobotMotion(t=sine(8.0).t, q=sine(8.0).q * [1.0, 0.9], dq=sine(8.0).dq * [1.0, 0.9]),
    ],
    "positions": lambda: [
        sine(duration=8.0),
        RobotMotion(t=sine(8.0).t, q=sine(8.0).q + 0.1, dq=sine(8.0).dq),
    ],
    "rest": lambda: [
        RobotMotion(t=sine(8.0).t, q=0.0 * sine(8.0).q, dq=0.0 * sine(8.0).dq) for _ in range(2)
    ],
    "short motions": lambda: [multisine(1, duration=4.0), multisine(1, duration=4.0)],
}


@pytest.mark.parametrize("kind", ONE_OF_A_KIND)
def test_motions_that_are_not_equal_have_no_replicate(kind: str) -> None:
    trajectories = ONE_OF_A_KIND[kind]()
    repetitions = find_repetitions(trajectories)
    assert repetitions == []
    times = [trajectory.t for trajectory in trajectories]
    errors = [np.ones((len(t), 1)) for t in times]
    assert split_errors(times, errors, repetitions) == ()
