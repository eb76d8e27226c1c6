"""Folds: what each leaves out, and what it trains on."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.inference.folds import Fold, split_into_folds, thin
from hesr_model.logs.signals import Motion
from hesr_model.support.arrays import Array


def make_motion(seconds: float, *, name: str = "log", rate: float = 100.0) -> Motion:
    """Motion of one joint that reverses every second."""
    t = np.arange(round(seconds * rate)) / rate
    q = np.sin(np.pi * t)[:, None]
    dq = np.pi * np.cos(np.pi * t)[:, None]
    return Motion(name=name, t=t, q=q, dq=dq, ddq=-q, tau=np.sign(dq), q_raw=q)


def judged_counts(folds: list[Fold], log: int) -> Array:
    return np.sum([fold.judged[log] for fold in folds], axis=0)


@pytest.mark.parametrize("durations", [(20.0,), (3.0, 17.0), (8.0, 1.0, 8.0, 5.0), (5.0,) * 7])
@pytest.mark.parametrize("count", [3, 5])
def test_each_row_is_judged_by_one_fold(durations: tuple[float, ...], count: int) -> None:
    motions = [make_motion(seconds, name=f"log{k}") for k, seconds in enumerate(durations)]
    folds = split_into_folds(motions, count)
    assert len(folds) == count
    for k in range(len(motions)):
        np.testing.assert_array_equal(judged_counts(folds, k), 1)
    shares = [sum(int(mask.sum()) for mask in fold.judged) for fold in folds]
    assert min(shares) > 0


def test_blocks_of_time_are_equal_over_all_logs() -> None:
    folds = split_into_folds([make_motion(12.0, name="a"), make_motion(8.0, name="b")], 5)
    rows = [sum(int(mask.sum()) for mask in fold.judged) for fold in folds]
    np.testing.assert_allclose(rows, 400, atol=3)
    # The last of the blocks of 4 s of the first log ends at its end.
    assert [bool(fold.judged[1].any()) for fold in folds] == [False, False, False, True, True]


def test_a_tenth_of_a_second_around_judged_rows_is_not_trained_on() -> None:
    motion = make_motion(20.0)
    for fold in split_into_folds([motion], 5):
        judged = motion.t[fold.judged[0]]
        trained = np.concatenate([piece.t for piece in fold.training])
        distances = np.abs(trained[:, None] - judged[None, :]).min(axis=1)
        assert 0.1 < distances.min() <= 0.1 + 0.0101
        # Nothing else is lost.
        ends = int(judged[0] > motion.t[0]) + int(judged[-1] < motion.t[-1])
        lost = len(motion.t) - len(trained) - len(judged)
        assert 9 * ends <= lost <= 11 * ends


def test_five_logs_are_left_out_whole() -> None:
    motions = [make_motion(4.0 + k, name=f"log{k}") for k in range(7)]
    folds = split_into_folds(motions, 5)
    for number, fold in enumerate(folds):
        left_out = {f"log{k}" for k in range(7) if k % 5 == number}
        assert {piece.name for piece in fold.training} == {m.name for m in motions} - left_out
        for motion, mask in zip(motions, fold.judged, strict=True):
            assert mask.all() == mask.any() == (motion.name in left_out)
        assert all(len(piece.t) == 100 * (4 + int(piece.name[3:])) for piece in fold.training)


def test_parts_of_a_log_are_left_out_together() -> None:
    parts = [make_motion(4.0, name=f"log{k // 2}") for k in range(10)]
    for number, fold in enumerate(split_into_folds(parts, 5)):
        assert [bool(mask.all()) for mask in fold.judged] == [k // 2 == number for k in range(10)]


def test_short_pieces_are_not_trained_on() -> None:
    """Of a log of 3 s blocks of 0.6 s leave pieces of 0.5 s, less is dropped."""
    folds = split_into_folds([make_motion(3.0)], 5)
    for fold in folds:
        for piece in fold.training:
            assert np.ptp(piece.t) >= 0.5
            assert len(piece.t) >= 20
    # Before the second block are 0.6 s less the guard, a row short of 0.5 s.
    assert [len(fold.training) for fold in folds] == [1, 1, 2, 1, 1]
    slow = make_motion(60.0, rate=1.0)
    assert all(
        len(piece.t) >= 20 for fold in split_into_folds([slow], 5) for piece in fold.training
    )


def test_a_fold_knows_whether_a_joint_reverses() -> None:
    motion = make_motion(20.0)
    one_way = replace(motion, dq=np.where(motion.t < 4.0, -1.0, 1.0)[:, None])
    folds = split_into_folds([one_way], 5)
    # Only the first block and the guard have motion backwards.
    assert [fold.reverses(0) for fold in folds] == [False, False, True, True, True]
    both = split_into_folds([one_way, replace(motion, name="other")], 3)
    assert all(fold.reverses(0) for fold in both)


@pytest.mark.parametrize(
    ("rate", "stride"), [(100.0, 1), (200.0, 1), (399.0, 1), (500.0, 2), (1000.0, 5)]
)
def test_fast_motions_are_thinned(rate: float, stride: int) -> None:
    motion = make_motion(2.0, rate=rate)
    thinned = thin(motion)
    np.testing.assert_array_equal(thinned.t, motion.t[::stride])
    np.testing.assert_array_equal(thinned.tau, motion.tau[::stride])
    assert 1.0 / np.median(np.diff(thinned.t)) > 199.9 or stride == 1
