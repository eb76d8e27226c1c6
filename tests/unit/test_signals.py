from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hesr_model.errors import LogError
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth


def sine_log(t: np.ndarray, frequency: float, noise: float = 0.0) -> Log:
    """Two joints on a 1 rad/s sine, a quarter of a period apart."""
    w = 2 * np.pi * frequency
    angle = w * t[:, None] + np.array([0.4, 0.4 + np.pi / 2])
    rng = np.random.default_rng(0)
    return Log(
        name="sine",
        t=t,
        q=np.sin(angle) / w + noise * rng.standard_normal(angle.shape) / w,
        dq=np.cos(angle) + noise * rng.standard_normal(angle.shape),
        tau=rng.standard_normal(angle.shape),
    )


def uneven(seconds: float = 10.0) -> np.ndarray:
    """Stamps in whole ms, 10 to 12 ms apart, as a robot controller writes them."""
    steps = np.random.default_rng(3).choice([0.010, 0.012], size=round(seconds / 0.011))
    return np.concatenate([[0.0], np.cumsum(steps)])


def acceleration(t: np.ndarray, frequency: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    return -w * np.sin(w * t[:, None] + np.array([0.4, 0.4 + np.pi / 2]))


@pytest.mark.parametrize("t", [np.arange(0, 10, 0.005), uneven()], ids=["even", "uneven"])
@pytest.mark.parametrize("frequency", [0.1, 0.5, 1.0])
def test_a_slow_motion_passes_unchanged_and_unshifted(t: np.ndarray, frequency: float) -> None:
    log = sine_log(t, frequency)
    motion = smooth(log)
    inner = (t > 0.5) & (t < t[-1] - 0.5)
    bound = 1e-4 * max(frequency, 0.1) ** 2
    assert np.abs(motion.q - log.q)[inner].max() < bound
    assert np.abs(motion.dq - log.dq)[inner].max() < bound
    assert np.abs(motion.ddq - acceleration(t, frequency))[inner].max() < 20 * bound


def test_the_first_and_last_samples_are_as_accurate_as_the_others() -> None:
    t = uneven()
    motion = smooth(sine_log(t, 0.3))
    error = np.abs(motion.ddq - acceleration(t, 0.3)).max(axis=1)
    # The motion starts and ends at full acceleration, which no mirror continues exactly.
    assert error[(t < 0.1) | (t > t[-1] - 0.1)].max() < 0.05 * np.abs(motion.ddq).max()
    assert np.abs(motion.dq - sine_log(t, 0.3).dq).max() < 5e-3


def test_noise_is_removed_from_the_acceleration() -> None:
    t = np.arange(0, 20, 0.005)
    noisy = sine_log(t, 0.3, noise=1e-3)
    motion = smooth(noisy)
    raw = np.gradient(noisy.dq, t, axis=0)
    left = np.std(motion.ddq - acceleration(t, 0.3))
    assert left < 0.25 * np.std(raw - acceleration(t, 0.3))


def test_noise_is_removed_from_the_first_and_last_velocity() -> None:
    """Laws start there, and the first break-away largely determines static friction."""
    t = np.arange(0, 4, 0.005)
    clean = sine_log(t, 0.3)
    rng, left = np.random.default_rng(0), []
    for _ in range(60):
        noisy = replace(clean, dq=clean.dq + 1e-3 * rng.normal(size=clean.dq.shape))
        left.append((smooth(noisy).dq - smooth(clean).dq)[[0, -1]])
    assert np.std(left) < 0.6e-3


def test_raw_signals_are_not_filtered() -> None:
    log = sine_log(uneven(), 0.3, noise=1e-3)
    motion = smooth(log)
    assert motion.name == "sine"
    assert motion.t is log.t
    assert motion.tau is log.tau
    assert motion.q_raw is log.q


def test_missing_velocity_is_derived_from_the_position() -> None:
    t = uneven()
    log = sine_log(t, 0.3)
    motion = smooth(Log(name="sine", t=t, q=log.q, dq=None, tau=log.tau))
    assert log.dq is not None
    inner = slice(50, -50)
    np.testing.assert_allclose(motion.dq[inner], log.dq[inner], atol=1e-4)
    np.testing.assert_allclose(motion.ddq[inner], acceleration(t, 0.3)[inner], atol=2e-3)


@settings(max_examples=25, deadline=None)
@given(start=st.floats(-3, 3), slope=st.floats(-2, 2))
def test_a_straight_line_is_preserved_to_its_ends(start: float, slope: float) -> None:
    t = uneven(3.0)
    line = np.column_stack([start + slope * t])
    log = Log(name="line", t=t, q=line, dq=np.full_like(line, slope), tau=line)
    motion = smooth(log)
    np.testing.assert_allclose(motion.q, line, atol=1e-7)
    np.testing.assert_allclose(motion.dq, slope, atol=1e-7)
    np.testing.assert_allclose(motion.ddq, 0.0, atol=1e-5)


def test_a_log_too_slow_for_the_cut_off_is_refused() -> None:
    log = sine_log(np.arange(0, 10, 0.03), 0.3)
    message = r"0\.03 s apart \(33\.33 Hz\)"
    with pytest.raises(LogError, match=message):
        smooth(log)
    smooth(log, cutoff=5.0)


def test_a_log_too_short_for_the_cut_off_is_refused() -> None:
    t = np.arange(20) * 0.01
    log = sine_log(t, 0.3)
    short = Log(name="s", t=t, q=log.q, dq=log.dq, tau=log.tau, path=Path("short.csv"))
    message = "15 Hz needs more than 21"
    with pytest.raises(LogError, match=message):
        smooth(short)
