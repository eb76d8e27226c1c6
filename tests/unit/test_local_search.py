"""The bounded local search: steps and slopes that do not depend on round-off."""

import numpy as np
import pytest

from hesr_model.fitting.local_search import search_locally

UNIT = (np.array([0.0, 0.0]), np.array([1.0, 1.0]))


@pytest.mark.parametrize("start", [0.0, 1e-17, 1e-11])
def test_a_number_of_almost_zero_has_a_slope(start: float) -> None:
    """A step relative to the number would vanish in the residual."""
    result = search_locally(
        lambda point: np.array([100.0 + point[0] - 100.3, 10.0 * (point[1] - 0.5)]),
        np.array([start, 0.2]),
        bounds=UNIT,
        scale=np.ones(2),
        magnitude=100.0,
    )
    assert result.x == pytest.approx([0.3, 0.5], abs=1e-6)


def test_a_number_without_effect_stays() -> None:
    """Its differences are round-off, here made a hundred times larger than they are."""
    noise = np.random.default_rng(1)
    result = search_locally(
        lambda point: np.array([point[0] - 0.3]) + 1e-14 * noise.standard_normal(1),
        np.array([0.9, 0.4]),
        bounds=UNIT,
        scale=np.ones(2),
        magnitude=1.0,
    )
    assert result.x == pytest.approx([0.3, 0.4], abs=1e-9)


def test_the_upper_bound_is_no_obstacle() -> None:
    result = search_locally(
        lambda point: point - np.array([0.3, 1.0]),
        np.array([1.0, 1.0]),
        bounds=UNIT,
        scale=np.ones(2),
        magnitude=1.0,
    )
    assert result.x == pytest.approx([0.3, 1.0], abs=1e-9)
