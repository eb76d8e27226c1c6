"""A capped sample of motions: rare motions are kept, and the seed decides the draw."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hesr_model.logs.rest import MOVING
from hesr_model.logs.sample import MotionSample
from hesr_model.logs.signals import Motion, moving, reversals
from hesr_model.support.arrays import get_arrays

MakeMotion = Callable[..., Motion]
RATE = 200


def sampled(motions: list[Motion], most: int, seed: int = 0) -> list[Motion]:
    sample = MotionSample(most, seed)
    for motion in motions:
        sample.add(motion)
    return sample.motions()


def same(one: list[Motion], other: list[Motion]) -> bool:
    return len(one) == len(other) and all(
        a.name == b.name
        and get_arrays(a).keys() == get_arrays(b).keys()
        and all(np.array_equal(x, get_arrays(b)[name]) for name, x in get_arrays(a).items())
        for a, b in zip(one, other, strict=True)
    )


def cruise(name: str, seconds: float, speed: float = 0.5) -> Motion:
    """One joint at a constant speed under a constant torque."""
    t = np.arange(round(seconds * RATE)) / RATE
    dq = np.full((len(t), 1), speed)
    q = speed * t[:, None]
    return Motion(name=name, t=t, q=q, dq=dq, ddq=0.0 * dq, tau=0.0 * dq + 2.0, q_raw=q)


@pytest.fixture
def days() -> list[Motion]:
    """Twenty days of cruising, with one second at rest and one reversal under load on one day."""
    made = [cruise(f"day{k}", 30.0) for k in range(20)]
    rare = made[7]
    dq, tau = rare.dq.copy(), rare.tau.copy()
    dq[1000:1200] = 0.0
    dq[3000:3400] *= -1.0
    tau[3000:3400] = -20.0
    made[7] = replace(rare, dq=dq, tau=tau)
    return made


def test_motions_within_the_cap_are_kept_unchanged(make_motion: MakeMotion) -> None:
    motions = [make_motion(name="a", seconds=3.3), make_motion(name="b", seconds=0.4)]
    assert same(sampled(motions, 10_000), motions)
    warm = [replace(m, temperature=30.0 + m.q) for m in motions]
    assert same(sampled(warm, 10_000), warm)
    assert not same(warm, motions)


def test_rare_motions_are_kept(days: list[Motion]) -> None:
    kept = sampled(days, 4000)
    assert 3500 < sum(len(motion.t) for motion in kept) <= 4000
    dq = np.concatenate([motion.dq[:, 0] for motion in kept])
    assert np.sum(~moving(dq, MOVING)) == 200
    assert np.sum(dq < 0.0) == 400
    assert sum(len(reversals(motion.dq[:, 0], MOVING)) for motion in kept) == 2
    assert len({motion.name for motion in kept}) > 5  # common motions come from several days


def test_neighbouring_windows_join_in_order(days: list[Motion]) -> None:
    kept = sampled(days, 20_000)
    for motion in kept:
        np.testing.assert_allclose(np.diff(motion.t), 1.0 / RATE)
    assert max(len(motion.t) for motion in kept) > RATE
    at = [(int(motion.name[3:]), motion.t[0]) for motion in kept]
    assert at == sorted(at)


def test_the_same_seed_draws_the_same_sample(days: list[Motion]) -> None:
    assert same(sampled(days, 4000), sampled(days, 4000))
    assert not same(sampled(days, 4000), sampled(days, 4000, seed=1))


def test_memory_is_limited_to_the_sample(days: list[Motion]) -> None:
    for motion in sampled(days, 4000):
        assert motion.tau.base is None or motion.tau.base.nbytes <= 4000 * 8
    one = MotionSample(400, 0)
    one.add(cruise("long", 100.0))
    assert all(w.motion.tau.base is None for w in one._windows)
    assert sum(len(w.motion.t) for w in one._windows) <= 400


def test_windows_with_more_of_a_stratum_are_more_likely() -> None:
    """Two windows with rests compete for one place; the one with 9 times the rows is likelier."""
    motion = cruise("day", 40.0)
    dq = motion.dq.copy()
    dq[0:180] = 0.0
    dq[1000:1020] = 0.0
    long = [
        float(sampled([replace(motion, dq=dq)], 200, seed)[0].t[0]) == 0.0 for seed in range(60)
    ]
    assert 0.78 < np.mean(long) < 0.98
