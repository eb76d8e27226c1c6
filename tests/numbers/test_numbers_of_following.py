"""Adaptive and thermal friction and its monitoring over days, on motions with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import lugre, model, motion, stops, truth
from unchanged import Unchanged

from hesr.extras.adaptive.monitor import Follower, watch
from hesr.extras.thermal.thermal_fit import fit_thermal
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.thermal import Thermal
from hesr_model.rigid_body.friction_record import FrictionRecord

WARM = Thermal(
    coulomb=0.004, viscous=0.02, reference=30.0, resistance=0.3, time_constant=400.0, ambient=22.0
)


def worn(law: FrictionLaw, seconds: float, seed: int, *, step: float = 0.01) -> FrictionRecord:
    """A record whose level rises by a quarter halfway and whose viscous part falls."""
    t, dq, q, load = motion(seconds, seed, step)
    later = t > 0.5 * seconds
    return truth(
        law,
        t,
        dq,
        q,
        load,
        seed=seed,
        level=lambda _: 1.0 + 0.25 * later,
        viscosity=lambda _: 1.0 - 0.2 * later,
    )


@pytest.mark.parametrize("law", [lugre, stops], ids=["LuGre", "ParFam-S"])
def test_an_adaptive_law(law, unchanged: Unchanged) -> None:
    record = worn(law(), 20.0, 3)
    tau = record.tau.copy()
    tau[1500:1530] += 60.0  # a collision
    [found] = Follower(model(law())).follow([replace(record, tau=tau)])
    unchanged(found, rtol=1e-5)


def test_monitored_days(unchanged: Unchanged) -> None:
    laws = [lugre(), stops(), lugre()]
    known = model(*laws)
    days = [
        [
            replace(worn(law, 12.0, 10 * day + k), log=str(day), joint=joint)
            for k, (law, joint) in enumerate(zip(laws, known.joints, strict=True))
        ]
        for day in range(3)
    ]
    found = watch(known, days)
    unchanged({"states": found.states, "alarms": found.alarms}, rtol=1e-5)


@pytest.mark.parametrize("measured", [True, False])
def test_warm_up(measured: bool, unchanged: Unchanged) -> None:
    warm = WARM if measured else replace(WARM, resistance=2.0, time_constant=120.0)
    records = []
    for seed, start in ((1, 0.0), (2, 25.0 if measured else 0.0)):
        t, dq, q, load = motion(60.0 if measured else 320.0, seed, 0.02 if measured else 0.05)
        rise = warm.rise(np.abs(18.0 * dq), np.diff(t, prepend=t[0]), start)
        level, viscosity = warm.factors(warm.ambient + rise)
        record = truth(
            stops(),
            t,
            dq,
            q,
            load,
            seed=seed,
            noise=0.3,
            correlation=0.001,
            level=lambda _, own=level: own,
            viscosity=lambda _, own=viscosity: own,
        )
        temperature = warm.ambient + rise if measured else None
        records.append([replace(record, log=str(seed), temperature=temperature)])
    known, found = fit_thermal(replace(model(stops()), law="parfam_s"), records)
    unchanged({"known": known.thermal, "found": found}, rtol=1e-4)
