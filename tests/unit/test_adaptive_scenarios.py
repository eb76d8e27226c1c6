"""Adaptation in scenarios with known truth: warm-up, wear and days of work."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import NOISE, STEP, Array, coloured, lugre, model, motion, stops, truth

from hesr.extras.adaptive.component import TUNING
from hesr.extras.adaptive.monitor import Follower, adaptive_components
from hesr.extras.thermal.thermal_fit import Factored
from hesr_model.equations.component import Parameter
from hesr_model.equations.stepping import Steps
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.friction_record import FrictionRecord

WARM_UP = 1200.0
"""Time [s] after which 30 % of viscous and 10 % of Coulomb friction are lost."""


def warming(law: FrictionLaw, seconds: float, *, begin: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors of the fixed and the adaptive law on a joint that has warmed up.

    The first minute is for learning; noise is excluded from the comparison.
    """
    t, dq, q, load = motion(seconds, 3)

    def lost(share: float, t: np.ndarray) -> np.ndarray:
        return 1.0 - share * np.minimum((begin + t) / WARM_UP, 1.0)

    factors = {"level": lambda t: lost(0.1, t), "viscosity": lambda t: lost(0.3, t)}
    noisy = truth(law, t, dq, q, load, seed=3, **factors)
    clean = noisy.tau - coloured(len(t), STEP, 0.1, NOISE, 3)
    [found] = Follower(model(law)).follow([noisy])
    late = t > 60.0
    return (found.tau_fixed - clean)[late], (found.outputs["tau"] - clean)[late]


@pytest.mark.parametrize("law", [lugre, stops])
def test_warm_up_drift_is_cut_within_a_minute_of_motion(law) -> None:
    fixed, followed = warming(law(), 120.0, begin=900.0)
    assert rmse(followed) <= 0.3 * rmse(fixed)


Lanes = dict[str, np.ndarray]
FACTORED = Factored(lugre())


def worked(
    seed: int, seconds: float, step: float, correlation: float, level: Callable[[Array], Array]
) -> FrictionRecord:
    """Return the signals of a joint with a time-varying friction level and coloured noise."""
    t, dq, q, load = motion(seconds, seed, step=step)
    clean = FrictionRecord(log="", joint="j1", t=t, dq=dq, q=q, tau_load=load, tau=t)
    torque = FACTORED.compute_torque(clean, level(t), np.ones_like(t))
    return replace(clean, tau=torque + coloured(len(t), step, correlation, NOISE, seed))


def side_by_side(
    seeds: range,
    seconds: float,
    *,
    step: float,
    correlation: float,
    level: Callable[[Array], Array],
) -> tuple[Array, Lanes]:
    """Adapt one joint per seed in parallel; return time (N,) and alarms (N, seeds)."""
    law, records = lugre(), [worked(seed, seconds, step, correlation, level) for seed in seeds]
    dq, q, load, friction = (
        np.stack([getattr(r, name) for r in records], axis=1)
        for name in ("dq", "q", "tau_load", "tau")
    )
    t, measured = records[0].t, friction + load
    [component] = adaptive_components(model(law))
    steps = Steps(component, ["drift", "shift", "level"], lanes=True)
    values = law.values | {
        p.name: p.start for p in component.parameters if isinstance(p, Parameter)
    }
    names = ("dq", "q", "tau_load", "tau_meas", "tau_rigid", "adapt")
    run = steps.run(values, [np.zeros(len(seeds))] * len(law.start), names)
    rows = zip(dq, q, load, measured, load, strict=True)
    first = next(rows)
    run.settle(*first, 1.0)
    found = [run.begin(*first, 1.0), *(run.step(step, *row, 1.0) for row in rows)]
    columns = zip(steps.observed, zip(*found, strict=True), strict=True)
    return t, {n: np.stack(np.broadcast_arrays(*c, dq[0])[:-1]) for n, c in columns}


def test_parallel_lanes_equal_single_runs() -> None:
    _, lanes = side_by_side(range(2), 5.0, step=STEP, correlation=0.1, level=np.ones_like)
    for seed in range(2):
        record = worked(seed, 5.0, STEP, 0.1, np.ones_like)
        [alone] = Follower(model(lugre())).follow([record])
        np.testing.assert_allclose(lanes["level"][:, seed], alone.outputs["level"], rtol=1e-12)


def wear_found(seeds: range, step: float = STEP) -> Array:
    """Return the times in motion until 25 % wear is found [s]; no alarm comes earlier."""
    t, lanes = side_by_side(
        seeds, 120.0, step=step, correlation=0.1, level=lambda t: 1.0 + 0.25 * (t > 60.0)
    )
    assert not np.any(lanes["drift"][t <= 60.0])
    found = lanes["drift"] > 0.0
    return np.where(found.any(axis=0), t[found.argmax(axis=0)] - 60.0, np.inf)


def test_wear_is_found_within_a_minute() -> None:
    assert wear_found(range(11, 13), 0.04).max() <= 60.0


@pytest.mark.soak
def test_wear_is_found_in_most_seeds() -> None:
    assert np.count_nonzero(wear_found(range(100)) <= 60.0) >= 95


def alarms(hours: float, seeds: range) -> int:
    """Return the number of alarm rows in the given hours of steady work of each seed.

    The noise has the correlation time the filter expects: whitened innovations are white.
    """
    _, lanes = side_by_side(
        seeds, 3600.0 * hours, step=0.1, correlation=TUNING.correlation_time, level=np.ones_like
    )
    return int(np.count_nonzero(lanes["drift"]) + np.count_nonzero(lanes["shift"]))


def test_steady_work_raises_no_alarm() -> None:
    assert alarms(0.05, range(40)) == 0


@pytest.mark.soak
def test_no_alarm_in_300_hours() -> None:
    assert sum(alarms(1.0, range(first, first + 150)) for first in (1, 151)) == 0
