"""The search for energy tries motions: position is the integral of velocity over the time."""

import numpy as np
import pytest

from hesr_model.audit import attack as searched
from hesr_model.equations.functions import absolute
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import FrictionLaw, LawForm
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.arrays import Array

TRAINED = TrainedRange(
    sample_time=0.01, dq=(-1.0, 1.0), q=(0.5, 2.5), tau_load=(-20.0, 30.0), tau=(-20.0, 20.0)
)
MIDDLE = 1.5  # [rad]
PAIRS = ((0.5, 0.25), (1.0, 2.0))  # [rad/s]


def motions(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Array, Array, Array, Array]]:
    """Return t, dq, q and load of all motions that a law without energy is asked for."""
    seen = []

    def predict(law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
        del law
        seen.append((t, dq, q, tau_load))
        return np.array(dq)

    monkeypatch.setattr(searched, "predict", predict)
    form = LawForm(coefficients=(), memory=(), output=DQ + 1e-9 * absolute(TAU_LOAD) * Q)
    law = FrictionLaw(name="own", form=form, values={})
    assert searched.attack(law, TRAINED, PAIRS)[0] is None
    return seen


def test_position_follows_velocity(monkeypatch: pytest.MonkeyPatch) -> None:
    for t, dq, q, _ in motions(monkeypatch):
        step, moved = np.diff(t), np.diff(q)
        assert np.all(step > 0.0)
        # Pairs of speeds hold that of the row, sines that in the middle, within their curvature.
        held, between = dq[1:] * step, 0.5 * (dq[1:] + dq[:-1]) * step
        excess = [np.abs(moved - x) > 0.12 * np.abs(moved).max() for x in (held, between)]
        # One sine follows another of the eight amplitudes without a gap.
        assert min(map(np.count_nonzero, excess)) <= 8
        assert q.min() <= MIDDLE + 1e-9
        assert q.max() >= MIDDLE - 1e-9


def test_pairs_of_speeds_return_to_their_start(monkeypatch: pytest.MonkeyPatch) -> None:
    pairs = [m for m in motions(monkeypatch) if len(set(m[1].tolist())) == 2]
    assert len(pairs) == len(PAIRS) * 4
    reached = set()
    for t, dq, q, load in pairs:
        rows = len(q) // 4
        np.testing.assert_allclose(q[rows - 1 :: rows], MIDDLE, atol=1e-9)
        np.testing.assert_allclose(q[rows:], q[:-rows], atol=1e-9)
        distance = q.max() - MIDDLE
        period = distance / dq.max() - distance / dq.min()
        assert t[-1] == pytest.approx(4 * period)
        assert np.ptp(load) == 0.0
        reached.add((dq.max(), -dq.min(), round(float(distance), 9)))
    assert reached == {(*pair, d) for pair in PAIRS for d in (1.0, 1e-2, 1e-4, 1e-6)}


def test_moving_loads_have_twice_the_frequency() -> None:
    found = list(searched.loaded_motions(TRAINED))
    assert len(found) == len(searched.ANGLES) * len(searched.PHASES) * 2
    for motion in found:
        cycle = motion.cycle
        t = TRAINED.sample_time * np.arange(len(motion.q))
        angle = 2.0 * np.pi * cycle.frequency * t
        reach = cycle.amplitude / (2.0 * np.pi * cycle.frequency)
        np.testing.assert_allclose(motion.q, MIDDLE + reach * np.sin(angle), rtol=1e-9)
        np.testing.assert_allclose(motion.dq, cycle.amplitude * np.cos(angle), atol=1e-12)
        expected = cycle.mean + cycle.swing * np.cos(2.0 * angle + cycle.phase)
        np.testing.assert_allclose(motion.load, expected, atol=1e-9)
        assert motion.rows * cycle.frequency * TRAINED.sample_time == pytest.approx(1.0)
        assert np.abs(motion.load).max() <= 30.0 + 1e-9
        # A torque against the motion generates nothing, one along it its work.
        assert motion.compute_generated_energy(motion.dq) == 0.0
        work = motion.compute_generated_energy(-motion.dq)
        assert work == pytest.approx(0.5 * cycle.amplitude**2 / cycle.frequency)
        # Energy counts only if the cycle before generates the same.
        growing = np.where(np.arange(len(motion.q)) < len(motion.q) - motion.rows, 0.5, 1.0)
        assert motion.compute_generated_energy(-growing * motion.dq) == 0.0


@pytest.mark.parametrize(("share", "counts"), [(0.0, False), (0.5, False), (0.97, True)])
def test_energy_of_pairs_counts_only_once_it_repeats(
    monkeypatch: pytest.MonkeyPatch, share: float, counts: bool
) -> None:
    """In the last two of four cycles; sines generate nothing here."""

    def predict(law: FrictionLaw, *, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
        del law, t, q, tau_load
        if len(set(dq.tolist())) > 2:
            return np.array(dq)
        last = np.arange(len(dq)) >= 3 * len(dq) // 4
        return np.asarray(-np.where(last, 1.0, share) * dq)

    monkeypatch.setattr(searched, "predict", predict)
    law = FrictionLaw(name="own", form=LawForm(coefficients=(), output=DQ), values={})
    found, _ = searched.attack(law, TRAINED, PAIRS)
    assert (found is not None) == counts
    if found:
        ahead, back = PAIRS[0]
        assert (found.amplitude, found.back) == (ahead, back)
        assert found.energy == pytest.approx(ahead + back)  # over 1 rad each way
        assert found.frequency == pytest.approx(1.0 / (1.0 / ahead + 1.0 / back))
