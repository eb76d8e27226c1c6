"""What a joint goes through, with known truth: it warms up, wears, and works for days."""

import numpy as np
import pytest
from adaptive_models import NOISE, STEP, coloured, lugre, model, motion, stops, truth

from hesr_model.friction.adaptive.follow import Follower
from hesr_model.friction.adaptive.tuning import TUNING
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.metrics import rmse

WARM_UP = 1200.0
"""[s] in which 30 % of viscous and 10 % of Coulomb friction are lost."""


def warming(law: FrictionLaw, seconds: float, *, begin: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the error of the fixed and of the followed law on a joint that has warmed up.

    The first minute is learned, noise is left out of what is compared.
    """
    t, dq, q, load = motion(seconds, 3)

    def lost(share: float, t: np.ndarray) -> np.ndarray:
        return 1.0 - share * np.minimum((begin + t) / WARM_UP, 1.0)

    factors = {"level": lambda t: lost(0.1, t), "viscosity": lambda t: lost(0.3, t)}
    noisy = truth(law, t, dq, q, load, seed=3, **factors)
    clean = noisy.tau - coloured(len(t), STEP, 0.1, NOISE, 3)
    [found] = Follower(model(law)).follow([noisy])
    late = t > 60.0
    return (found.fixed - clean)[late], (found.outputs["tau"] - clean)[late]


@pytest.mark.parametrize("law", [lugre, stops])
def test_drift_of_a_warm_up_is_cut_within_a_minute_of_motion(law) -> None:
    fixed, followed = warming(law(), 120.0, begin=900.0)
    assert rmse(followed) <= 0.3 * rmse(fixed)


def wear_found(seed: int) -> float:
    """Return the time in motion until wear of 25 % is found [s]."""
    t, dq, q, load = motion(120.0, seed)
    record = truth(
        lugre(), t, dq, q, load, seed=seed,
        level=lambda t: 1.0 + 0.25 * (t > 60.0), viscosity=np.ones_like,
    )  # fmt: skip
    [found] = Follower(model(lugre())).follow([record])
    drift = found.outputs["drift"]
    assert not np.any(drift[t <= 60.0])
    rows = np.flatnonzero(drift > 0.0)
    return float(t[rows[0]] - 60.0) if len(rows) else np.inf


@pytest.mark.parametrize("seed", [11, 12])
def test_wear_is_found_within_a_minute(seed: int) -> None:
    assert wear_found(seed) <= 60.0


@pytest.mark.soak
def test_wear_is_found_in_most_seeds() -> None:
    assert sum(wear_found(seed) <= 60.0 for seed in range(100)) >= 95


def alarms(hours: float, seed: int) -> int:
    """Return in how many rows of steady work there is an alarm.

    The noise has the correlation time that the filter expects: whitened, innovations are white.
    """
    motions = motion(3600.0 * hours, seed, step=0.05)
    record = truth(
        lugre(), *motions, seed=seed, level=np.ones_like, viscosity=np.ones_like,
        correlation=TUNING.correlation_time,
    )  # fmt: skip
    [found] = Follower(model(lugre())).follow([record])
    return int(np.count_nonzero(found.outputs["drift"]) + np.count_nonzero(found.outputs["shift"]))


def test_steady_work_gives_no_alarm() -> None:
    assert alarms(0.5, 0) == 0


@pytest.mark.soak
def test_no_alarm_in_300_hours() -> None:
    assert sum(alarms(1.0, seed) for seed in range(1, 301)) == 0
