"""Choices among candidates, independent of round-off."""

import numpy as np
import pytest

from hesr_model.fitting.joint_rows import (
    ROUND_OFF,
    find_first_best,
    has_significant_gain,
    is_no_worse,
)


def test_costs_within_round_off_are_tied() -> None:
    assert is_no_worse(4.0 * (1.0 + 0.9 * ROUND_OFF), 4.0)
    assert not is_no_worse(4.0 * (1.0 + 1.1 * ROUND_OFF), 4.0)
    assert is_no_worse(3.0, 4.0)
    assert pytest.approx(1e-9) == ROUND_OFF


def test_the_first_of_tied_candidates_wins() -> None:
    assert find_first_best([5.0, 2.0 + 1e-10, 2.0, 2.0 - 1e-10]) == 1
    assert find_first_best([5.0, 2.0 + 1e-8, 2.0]) == 2
    assert find_first_best([5.0, 2.0 + 1e-6, 2.0], tolerance=1e-6) == 1


def test_a_gain_of_round_off_does_not_pay() -> None:
    blocks = np.repeat(np.arange(10), 20)
    before = np.full(200, 3.0)
    assert not has_significant_gain(before, before * (1.0 - 1e-10), blocks)
    assert has_significant_gain(before, before * (1.0 - 1e-6), blocks)
