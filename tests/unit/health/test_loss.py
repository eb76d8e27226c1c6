"""Missing rows are reported, and refused if they make friction too uncertain."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from hesr_model.health.examine import HealthError, check_logs
from hesr_model.health.positions import compute_share_of_long_steps
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot


def lossy(log: Log, share: float) -> Log:
    kept = np.random.default_rng(3).random(len(log.t)) >= share
    return log.rows(np.flatnonzero(kept))


@pytest.fixture
def noisy(make_motion: Callable[..., Motion]) -> Callable[[float], Log]:
    """20 s logs of 3 N.m of friction with torque noise [N.m]."""

    def make(deviation: float) -> Log:
        motion = make_motion(name="run", seconds=20.0, friction=3.0)
        noise = np.random.default_rng(0).normal(0.0, deviation, motion.tau.shape)
        return Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau + noise)

    return make


def test_harmless_missing_rows_are_reported(
    noisy: Callable[[float], Log], arm_model: Robot
) -> None:
    (told,) = check_logs([lossy(noisy(0.2), 0.5)], arm_model)
    assert (told.check, told.severity) == ("missing-rows", "warning")


def test_irregular_stamps_are_not_missing_rows(
    noisy: Callable[[float], Log], arm_model: Robot
) -> None:
    """Steps of 6 to 16 ms: 9 % of them are longer than 1.8 times the median."""
    log, rng = noisy(0.2), np.random.default_rng(1)
    steps = rng.choice([0.006, 0.008, 0.01, 0.016], p=[0.3, 0.41, 0.2, 0.09], size=len(log.t))
    stamps = np.cumsum(steps[np.cumsum(steps) < log.t[-1]])
    rows = {name: CubicSpline(log.t, getattr(log, name))(stamps) for name in ("q", "dq", "tau")}
    irregular = Log(name="run", t=stamps, **rows)
    assert compute_share_of_long_steps(irregular) > 0.07
    assert check_logs([irregular], arm_model) == []


def test_missing_rows_that_make_friction_uncertain_are_refused(
    noisy: Callable[[float], Log], arm_model: Robot
) -> None:
    log = noisy(3.0)
    assert check_logs([log], arm_model) == []
    with pytest.raises(HealthError, match=r"'j1'.* many rows are missing; .* rad/s is uncertain"):
        check_logs([lossy(log, 0.5)], arm_model)
    told = check_logs([lossy(log, 0.5)], arm_model, ["missing-rows"])
    assert {finding.check for finding in told} == {"missing-rows"}


def test_uncertainty_matches_the_effect_of_missing_rows(
    noisy: Callable[[float], Log], arm_model: Robot
) -> None:
    """Estimates from other halves of the rows scatter as predicted by one log's own halves."""
    from hesr_model.health.evidence import ModelTorques, smooth_parts
    from hesr_model.health.positions import _estimate_sliding_torque

    log = noisy(2.0)
    found = []
    for seed in range(40):
        rows = np.random.default_rng(seed).choice(len(log.t), len(log.t) // 2, replace=False)
        part = max(smooth_parts(log.rows(np.sort(rows)), 15.0), key=lambda part: len(part.t))
        found.append(
            _estimate_sliding_torque(
                part, ModelTorques.from_motion(arm_model, part.q, part.v, part.a), 1
            )
        )
    torques, deviations = (np.array([one[k] for one in found]) for k in (1, 2))
    np.testing.assert_allclose(deviations.mean(axis=0), torques.std(axis=0), rtol=0.4)
