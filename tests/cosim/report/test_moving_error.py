"""The moving RMS error in the report's figures."""

import numpy as np
import pytest

from cosim.report.sections.prediction import MOVING, moving_rms


def test_the_moving_error_is_a_local_rms() -> None:
    t = np.sort(np.random.default_rng(2).uniform(0.0, 5.0, 400))
    error = np.sin(3.0 * t) + 0.1 * np.arange(400) % 3
    wanted = [np.sqrt(np.mean(error[np.abs(t - now) <= 0.5 * MOVING] ** 2)) for now in t]
    assert moving_rms(t, error) == pytest.approx(wanted, rel=1e-9)
