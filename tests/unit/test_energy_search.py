"""Search for energy in exported FMUs: none from laws called proven, some from others."""

from math import inf
from pathlib import Path

import numpy as np
import pytest
from energy_search import POPULATION, STARTS, Found, attacked, corners, search
from oracles.stepper import Stepper
from test_certificate import (
    LUGRE,
    NEGATIVE,
    STEEP,
    TRAINED,
    dahl,
    law_of,
    own,
    rippled,
    stops,
)
from test_classic_laws import NAMES
from test_classic_laws import law as classic

from hesr_model.audit.certificate import certify, find_scale_limits
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Stop
from hesr_model.errors import SimulationError
from hesr_model.fitting.estimator import registry
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel

ROUNDING = 1e-9  # of the work and storage exchanged
ENERGY = 1e-6  # share of a cycle that counts as energy
_MILLION = 1_000_000

FITTED = (
    "none",
    "constant",
    "coulomb_viscous",
    "stribeck",
    "parfam_v",
    "lugre_passive",
    "dahl_load",
    "parfam_s",
    "parfam_s_load",
    "parfam_s_v",
)
DAMPED = law_of("lugre", **LUGRE | {"sigma_1": 10.0, "sigma_2": 8.0})
MADE = {
    "stops": stops(),
    "ripple": rippled(),
    "dahl": dahl(),
    "lugre": law_of("lugre", **LUGRE),
    "damped": DAMPED,
    **{name: classic(name) for name in NAMES},
}
"""Laws called proven, with coefficients that use every term."""

STOP = Stop(name="x", unit="1", velocity=DQ, deflection=1e-4, bound=1)
TYPICAL = registry()["parfam_v"].typical
FAULTY = {
    "steep tanh": law_of("parfam_v", TYPICAL, **STEEP),
    "negative F_s": law_of("stribeck", **NEGATIVE),
    "undamped": law_of("lugre", **LUGRE | {"sigma_1": 10.0, "sigma_2": 0.0}),
    "undamped ripple": rippled(sigma_2=0.0, sigma_a=0.0),
    "late ripple": rippled(lag=0.2, sigma_a=0.0),
    "driving": own(DQ - 0.1 * sgn(DQ)),
    "load as a factor": own((2.0 + absolute(TAU_LOAD)) * STOP.state + DQ, STOP),
}
"""Laws whose certificate is refused."""


def attack(
    law: FrictionLaw, folder: Path, *, generations: int = 5, cases: int = 0, enough: float = inf
) -> Found:
    proof = certify(law, TRAINED)
    proven = proof.verdict == "proven"
    with attacked(law, folder, longest=proof.largest_step if proven else None) as target:
        chosen = corners(law) if proven else corners(law)[:1]
        return search(target, chosen, generations=generations, cases=cases, enough=enough)


def test_the_search_knows_every_proven_law(registry_models: dict[str, FrictionModel]) -> None:
    proven = {
        name
        for name, model in registry_models.items()
        if certify(model.laws[0], TRAINED).verdict == "proven"
    }
    assert proven <= {*FITTED, *MADE}
    assert {certify(law, TRAINED).verdict for law in MADE.values()} == {"proven"}


@pytest.mark.ci
@pytest.mark.parametrize("name", FITTED)
def test_no_energy_from_a_fitted_proven_law(
    name: str, registry_models: dict[str, FrictionModel], tmp_path: Path
) -> None:
    assert attack(registry_models[name].laws[0], tmp_path).share < ROUNDING


@pytest.mark.ci
@pytest.mark.parametrize("law", MADE.values(), ids=MADE)
def test_no_energy_from_a_proven_law(law: FrictionLaw, tmp_path: Path) -> None:
    assert attack(law, tmp_path).share < ROUNDING


def test_factors_beyond_their_limits_are_refused(tmp_path: Path) -> None:
    _, (least, _) = find_scale_limits(rippled())
    with attacked(rippled(), tmp_path) as target:
        with pytest.raises(SimulationError) as caught:
            target.component.initialise(start={"viscous_scale[1]": 0.99 * least})
        said = f"fmi2SetReal: viscous_scale[1] is {0.99 * least:g}; expected {least:g} to inf."
        assert str(caught.value).endswith(said)
        target.component.reset()
        target.component.initialise(start={"viscous_scale[1]": least})
        assert target.component.get(["viscous_scale[1]"]) == least


@pytest.mark.soak
@pytest.mark.parametrize("name", [*FITTED, *MADE])
def test_no_energy_from_a_proven_law_in_a_million_cases(
    name: str, registry_models: dict[str, FrictionModel], tmp_path: Path
) -> None:
    law = MADE[name] if name in MADE else registry_models[name].laws[0]
    million = attack(law, tmp_path, generations=_MILLION // (STARTS * POPULATION), cases=_MILLION)
    assert million.cases >= _MILLION
    assert million.share < ROUNDING


@pytest.mark.ci
@pytest.mark.parametrize("law", FAULTY.values(), ids=FAULTY)
def test_energy_from_a_law_that_is_not_proven(law: FrictionLaw, tmp_path: Path) -> None:
    assert certify(law, TRAINED).verdict != "proven"
    found = attack(law, tmp_path, enough=ENERGY)
    assert found.share > ENERGY
    # The same inputs drive the equations for ever, from rest or after sliding; no generated C steps
    # them.
    rows, gains = found.rows.tolist(), []
    for speed in (0.0, 0.1, -0.1):
        stepper = Stepper(law)
        stepper.step(1.0, speed, *rows[0][2:])
        rounds = np.array([[stepper.step(*row) for row in rows] for _ in range(30)])
        power = rounds[-20:] * found.rows[:, 0] * found.rows[:, 1]
        gains.append(np.all(power.sum(axis=1) < -ENERGY * np.abs(power).sum(axis=1)))
    assert any(gains)
