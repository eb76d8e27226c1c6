"""Motions: closed forms against finite differences, rest, reversal and peaks."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from hesr_model.errors import ConfigError
from hesr_model.motions.trajectories import Fourier, Sine, Sweep, chirp, random_fourier

OFFSET = np.array([0.0, 0.3, -1.9])
PEAK = np.array([1.3, 1.2, 0.7])


def fourier(seed=5, **changes):
    settings = {"harmonics": 10, "period": 20.0, "peak_velocity": PEAK, "offset": OFFSET}
    return random_fourier(seed=seed, **(settings | changes))


def sweep(**changes):
    settings = {
        "start": OFFSET,
        "amplitude": np.array([0.75, 0.5, 0.0]),
        "swing": np.array([0.45, 0.2, 0.0]),
        "swing_phase": np.array([-np.pi / 2, 0.4, 0.0]),
        "swing_period": 14.0,
        "first": 0.1,
        "last": 0.45,
        "length": 42.0,
    }
    return Sweep(**(settings | changes))


def paper_chirp():
    return chirp(
        start=OFFSET, amplitude=np.array([1.2, -1.2, 0.6]), first=0.1, last=1.0, length=4.68
    )


MOTIONS = {
    "fourier": fourier(),
    "sine": Sine(offset=OFFSET, amplitude=np.array([1.2, 0.0, -0.5]), frequency=0.25, periods=3),
    "sweep": sweep(),
    "chirp": paper_chirp(),
}
EVERY = [*MOTIONS.values(), *(motion.reverse_time() for motion in MOTIONS.values())]
NAMES = [*MOTIONS, *(f"{name} reversed" for name in MOTIONS)]
every_motion = pytest.mark.parametrize("motion", EVERY, ids=NAMES)


def differentiate(values, h):
    """Fourth-order central difference over five samples."""
    return (values[0] - 8 * values[1] + 8 * values[3] - values[4]) / (12 * h)


@every_motion
def test_derivatives_equal_finite_differences(motion):
    h = 1e-3
    t = np.linspace(2.0 * h, motion.duration - 2.0 * h, 501)  # it starts and stops at the ends
    around = [motion.sample(t + k * h) for k in (-2, -1, 0, 1, 2)]
    _, dq, ddq = around[2]
    np.testing.assert_allclose(dq, differentiate([s[0] for s in around], h), atol=1e-9)
    np.testing.assert_allclose(ddq, differentiate([s[1] for s in around], h), atol=1e-8)


@every_motion
def test_shapes(motion):
    for values in motion.sample(np.linspace(0.0, 1.0, 7)):
        assert values.shape == (7, 3)
        assert values.dtype == float


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_starts_at_rest(motion):
    _, dq, _ = motion.sample(np.zeros(1))
    np.testing.assert_allclose(dq, 0.0, atol=1e-14)


@pytest.mark.parametrize("name", ["fourier", "sine"])
def test_periodic_motions_end_at_rest_where_they_started(name):
    motion = MOTIONS[name]
    q, dq, ddq = motion.sample(np.array([0.0, motion.duration]))
    np.testing.assert_allclose(dq, 0.0, atol=1e-12)
    np.testing.assert_allclose(q[1], q[0], atol=1e-12)
    np.testing.assert_allclose(ddq[1], ddq[0], atol=1e-12)


def test_fourier_starts_without_acceleration():
    np.testing.assert_allclose(MOTIONS["fourier"].sample(np.zeros(1))[2], 0.0, atol=1e-14)


@every_motion
def test_reversal_runs_the_same_path_backwards(motion):
    t = np.linspace(0.0, motion.duration, 101)
    q, dq, ddq = motion.sample(t)
    back_q, back_dq, back_ddq = motion.reverse_time().sample(motion.duration - t)
    np.testing.assert_allclose(back_q, q, atol=1e-12)
    np.testing.assert_allclose(back_dq, -dq, atol=1e-12)
    np.testing.assert_allclose(back_ddq, ddq, atol=1e-12)


@every_motion
def test_reversal_undoes_itself(motion):
    t = np.linspace(0.0, motion.duration, 101)
    for twice, once in zip(
        motion.reverse_time().reverse_time().sample(t), motion.sample(t), strict=True
    ):
        assert np.array_equal(twice, once)


def test_reversed_fourier_is_a_fourier_of_the_same_period():
    back = MOTIONS["fourier"].reverse_time()
    assert isinstance(back, Fourier)
    assert back.period == 20.0


@given(seed=st.integers(0, 2**64 - 1), harmonics=st.integers(2, 15), period=st.floats(1.0, 60.0))
def test_random_fourier_reaches_its_peaks_from_rest(seed, harmonics, period):
    motion = fourier(seed, harmonics=harmonics, period=period)
    _, dq, ddq = motion.sample(np.linspace(0.0, period, 20_001))
    np.testing.assert_allclose(np.abs(dq).max(axis=0), PEAK, rtol=2e-4)
    np.testing.assert_allclose(dq[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(ddq[0], 0.0, atol=1e-9)


def test_random_fourier_moves_about_its_offset():
    t = np.linspace(0.0, 20.0, 4000, endpoint=False)
    np.testing.assert_allclose(fourier().sample(t)[0].mean(axis=0), OFFSET, atol=1e-12)


def test_seed_decides_the_fourier_motion():
    assert np.array_equal(fourier(5).a, fourier(5).a)
    assert np.array_equal(fourier(5).b, fourier(5).b)
    assert not np.allclose(fourier(5).a, fourier(6).a)


def test_joints_of_a_random_fourier_motion_differ():
    a = fourier().a
    assert abs(np.corrcoef(a)[0, 1]) < 0.99


def test_fourier_must_start_at_rest():
    a, b = np.zeros((2, 3)), np.zeros((2, 3))
    a[1, 0] = 0.2
    with pytest.raises(ConfigError, match="joint 2 does not start at rest"):
        Fourier(offset=np.zeros(2), a=a, b=b, period=10.0)


def test_fourier_with_one_harmonic_is_refused():
    with pytest.raises(ConfigError, match="1 harmonics; at least 2"):
        fourier(harmonics=1)


def test_a_joint_without_peak_velocity_rests():
    motion = fourier(peak_velocity=np.array([1.0, 0.0, 1.0]))
    q, dq, _ = motion.sample(np.linspace(0.0, 20.0, 100))
    assert np.array_equal(q[:, 1], np.full(100, 0.3))
    assert not dq[:, 1].any()


def test_sine_of_the_paper():
    motion = Sine(offset=OFFSET, amplitude=np.array([1.2, 0.0, 0.0]), frequency=0.25, periods=2)
    q, dq, _ = motion.sample(np.array([0.0, 1.0, 2.0]))
    assert motion.duration == 8.0
    np.testing.assert_allclose(dq[:, 0], [0.0, 1.2, 0.0], atol=1e-14)
    np.testing.assert_allclose(q[:, 0], np.array([-1.0, 0.0, 1.0]) * 1.2 / (np.pi / 2), atol=1e-14)
    assert np.array_equal(q[:, 1:], np.tile(OFFSET[1:], (3, 1)))


@pytest.mark.parametrize("name", ["sweep", "chirp"])
def test_position_is_the_integral_of_velocity(name):
    motion = MOTIONS[name]
    for end in (0.3, 0.5 * motion.duration, motion.duration):
        q = motion.sample(np.array([end]))[0][0]
        for joint in range(3):
            moved, _ = quad(
                lambda s, j=joint: motion.sample(np.array([s]))[1][0, j], 0.0, end, limit=500
            )
            assert q[joint] - OFFSET[joint] == pytest.approx(moved, abs=1e-8)


def test_chirp_of_the_paper_passes_0_6_hz_at_2_6_s():
    motion = paper_chirp()
    t = np.linspace(0.0, motion.duration, 100_001)
    dq = motion.sample(t)[1][:, 0]
    crossings = t[1:][np.diff(np.sign(dq)) != 0]
    middle = 0.5 * (crossings[1:] + crossings[:-1])
    frequency = 0.5 / np.diff(crossings)
    assert np.interp(2.6, middle, frequency) == pytest.approx(0.6, abs=0.01)
    assert np.abs(dq).max() == pytest.approx(1.2, rel=1e-6)


def test_sweep_stays_within_its_envelope():
    motion = sweep()
    t = np.linspace(0.0, 42.0, 20_001)
    dq = motion.sample(t)[1]
    envelope = 0.75 + 0.45 * np.sin(2 * np.pi * t / 14.0 - np.pi / 2)
    assert np.all(np.abs(dq[:, 0]) <= envelope + 1e-12)
    assert envelope.min() == pytest.approx(0.3)
    assert envelope.max() == pytest.approx(1.2)
    assert np.abs(dq[:, 0]).max() > 1.15
    assert not dq[:, 2].any()


def test_sweep_must_rise():
    with pytest.raises(ConfigError, match=r"sweep from 0\.45 to 0\.1 Hz"):
        sweep(first=0.45, last=0.1)


def test_a_robot_at_rest_is_a_valid_motion():
    still = Fourier(offset=np.array([0.1, 0.2]), a=np.zeros((2, 2)), b=np.zeros((2, 2)), period=1.0)
    q, dq, ddq = still.sample(np.linspace(0.0, 1.0, 5))
    np.testing.assert_array_equal(q, [[0.1, 0.2]] * 5)
    assert not dq.any()
    assert not ddq.any()
