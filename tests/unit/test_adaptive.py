"""Adaptive friction: adaptation, standstill and passivity."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_models import NOISE, SPEED, STEP, coloured, lugre, model, motion, stops, truth

from hesr.extras.adaptive.component import TUNING, adaptive_component
from hesr.extras.adaptive.monitor import Follower, JointEstimates, adaptive_components
from hesr_model.audit.certificate import certify, find_min_viscous_scale, find_storage_factors
from hesr_model.equations.stepping import ComponentRun, Steps
from hesr_model.errors import ExportError, SimulationError
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.records import predict_record
from hesr_model.laws.stribeck import Stribeck
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.robots.transmission import Coupling

LAWS = [pytest.param(lugre, id="LuGre"), pytest.param(stops, id="ParFam-S")]


def followed(record: FrictionRecord, law: FrictionLaw, *, adapt: bool = True) -> JointEstimates:
    [found] = Follower(model(law)).follow([record], adapt=adapt)
    return found


def steady(
    law: FrictionLaw,
    seconds: float = 60.0,
    *,
    seed: int = 0,
    level: float = 1.0,
    viscosity: float = 1.0,
    noise: float = NOISE,
) -> FrictionRecord:
    return truth(
        law,
        *motion(seconds, seed),
        seed=seed,
        noise=noise,
        level=lambda t: np.full_like(t, level),
        viscosity=lambda t: np.full_like(t, viscosity),
    )


@pytest.mark.parametrize("law", LAWS)
def test_without_adaptation_the_law_is_unchanged(law) -> None:
    record = steady(law(), 5.0)
    found = followed(record, law(), adapt=False)
    np.testing.assert_allclose(found.outputs["tau"], predict_record(law(), record), rtol=1e-12)
    assert set(found.outputs["health"]) <= {1.0, 2.0}
    assert set(found.outputs["level"]) == {1.0}


@pytest.mark.parametrize("law", LAWS)
def test_true_factors_are_found(law) -> None:
    found = followed(steady(law(), 90.0, level=1.15, viscosity=0.8), law()).outputs
    assert found["level"][-1] == pytest.approx(1.15, abs=0.04)
    assert found["viscosity"][-1] == pytest.approx(0.8, abs=0.06)
    assert abs(found["offset"][-1]) < 0.3
    for name, true in (("level", 1.15), ("viscosity", 0.8)):
        assert abs(found[name][-1] - true) < 4.0 * found[f"{name}_sd"][-1]


@pytest.mark.parametrize("law", LAWS)
def test_a_correct_fit_does_not_drift(law) -> None:
    record = steady(law(), 60.0)
    found = followed(record, law())
    worse = np.mean((found.outputs["tau"] - record.tau) ** 2) / np.mean(
        (found.tau_fixed - record.tau) ** 2
    )
    assert worse < 1.01
    assert set(found.outputs["drift"]) == set(found.outputs["shift"]) == {0.0}


def at_work(law: FrictionLaw) -> tuple[ComponentRun, tuple[str, ...], tuple[str, ...]]:
    """A run after half a minute of adaptation, with the names of its outputs and states."""
    component = adaptive_component(law, TUNING, noise=NOISE, speed=SPEED)
    steps = Steps(component)
    values = law.values | {"noise": NOISE, "speed_least": 0.02 * SPEED, "level_start": 1.0,
                           "viscosity_start": 1.0}  # fmt: skip
    run = steps.run(values, law.start, [q.name for q in component.inputs])
    record = steady(law, 30.0, level=1.1)
    run.begin(record.dq[0], record.q[0], record.tau_load[0], 0.0, 0.0, 0.0)
    for v, q, load, tau in zip(record.dq, record.q, record.tau_load, record.tau, strict=True):
        run.step(STEP, v, q, load, tau + load, load, 1.0)
    return run, steps.observed, tuple(e.name for e in component.remembered)


KEPT = ("level", "viscosity", "offset", *(f"P_{i}{j}" for i in range(3) for j in range(i, 3)))


def kept(run: ComponentRun, names: tuple[str, ...]) -> list[float]:
    return [run.remembered[names.index(name)] for name in KEPT]


@pytest.mark.parametrize(
    ("reason", "inputs"),
    [
        (1.0, (0.5, 0.0, 5.0, 30.0, 5.0, 0.0)),
        (2.0, (0.0, 0.0, 5.0, 18.0, 5.0, 1.0)),
        (2.0, (0.9 * TUNING.rest * SPEED, 0.0, 5.0, 18.0, 5.0, 1.0)),
        (4.0, (0.5, 0.0, 5.0, 200.0, 5.0, 1.0)),
        (4.0, (0.5, 0.0, 5.0, np.nan, 5.0, 1.0)),
        (4.0, (0.5, 0.0, 5.0, np.inf, 5.0, 1.0)),
    ],
)
def test_factors_freeze_and_health_gives_the_reason(
    reason: float, inputs: tuple[float, ...]
) -> None:
    run, names, remembered = at_work(stops())
    before = kept(run, remembered)
    for _ in range(200):
        seen = dict(zip(names, run.step(STEP, *inputs), strict=True))
    assert seen["health"] == reason
    assert kept(run, remembered) == before


def test_an_hour_at_rest_changes_nothing() -> None:
    run, _, remembered = at_work(lugre())
    before = kept(run, remembered)
    for k in range(3600):
        run.step(1.0, 1e-3 * (-1) ** k, 0.0, 5.0, 9.0, 5.0, 1.0)
    assert kept(run, remembered) == before


def test_a_saturated_motor_is_not_learned() -> None:
    law = lugre()
    component = adaptive_component(law, TUNING, noise=NOISE, speed=SPEED)
    values = law.values | {"noise": NOISE, "torque_limit": 30.0, "level_start": 1.0,
                           "viscosity_start": 1.0}  # fmt: skip
    steps = Steps(component)
    run = steps.run(values, law.start, [q.name for q in component.inputs])
    run.begin(0.5, 0.0, 0.0, 31.0, 5.0, 1.0)
    for _ in range(300):
        seen = dict(zip(steps.observed, run.step(STEP, 0.5, 0.0, 0.0, 31.0, 5.0, 1.0), strict=True))
    assert (seen["health"], seen["level"]) == (3.0, 1.0)


@pytest.mark.parametrize("law", LAWS)
def test_a_collision_is_not_learned(law) -> None:
    record = steady(law(), 60.0)
    hit = (record.t > 40.0) & (record.t < 40.4)
    pushed = replace(record, tau=record.tau + 60.0 * np.sin(np.pi * (record.t - 40.0) / 0.4) * hit)
    free, struck = followed(record, law()).outputs, followed(pushed, law()).outputs
    after = record.t > 39.9
    for factor in ("level", "viscosity"):
        assert np.abs(struck[factor] - free[factor])[after].max() < 0.02
    assert not np.any(struck["drift"])
    assert not np.any(struck["shift"])


def test_learning_does_not_depend_on_the_step() -> None:
    """Learning depends on elapsed time, not on the number of samples."""
    law = lugre()
    found = []
    for step in (0.002, 0.01):
        t, dq, q, load = motion(30.0, step=step)
        record = truth(
            law,
            t,
            dq,
            q,
            load,
            level=lambda t: np.full_like(t, 1.2),
            viscosity=np.ones_like,
            noise=0.0,
        )
        found.append(followed(record, law).outputs["level"][-1])
    assert found[0] == pytest.approx(found[1], abs=5e-3)


def test_the_offset_moves_slowly() -> None:
    record = steady(stops(), 20.0)
    found = followed(replace(record, tau=record.tau + 2.5), stops()).outputs["offset"]
    rate = np.abs(np.diff(found)) / STEP
    assert rate.max() <= TUNING.offset_rate * NOISE * (1.0 + 1e-9)
    assert found[-1] > 0.3


# --- the certificate --------------------------------------------------------------------------


def test_viscous_friction_stays_above_the_bound_for_ripple() -> None:
    law = stops()
    least = find_min_viscous_scale(law)
    assert 0.0 < least < 1.0
    for share, verdict in ((1.001 * least, "proven"), (0.98 * least, "tested")):
        values = {n: v * (share if n.startswith("sigma") else 1.0) for n, v in law.values.items()}
        found = certify(replace(law, values=values), model(law).trained[0]).verdict
        assert (found == "proven") == (verdict == "proven")
    found = followed(steady(law, 20.0, viscosity=0.3), law).outputs["viscosity"]
    assert found.min() >= least


def fuzzed(steps: int, seed: int) -> None:
    """Random torques, jumps, saturation and NaN: no energy is generated, all factors stay in the
    box."""
    law = stops(ripple=())
    component = adaptive_component(law, TUNING, noise=NOISE, speed=SPEED)
    names = ["tau", "level", "viscosity", "offset", "level_sd", "viscosity_sd", "offset_sd"]
    values = law.values | {"noise": NOISE, "speed_least": 0.02, "torque_limit": 80.0,
                           "level_start": 1.0, "viscosity_start": 1.0}  # fmt: skip
    run = Steps(component, names).run(values, law.start, [q.name for q in component.inputs])
    factors = find_storage_factors(law)
    k = np.array([factors[m.name] for m in law.form.memory])
    rng = np.random.default_rng(seed)
    run.begin(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    offset, stored = 0.0, float(k @ np.square(run.states))
    boxes = [
        TUNING.level,
        TUNING.viscosity,
        (-TUNING.offset * NOISE, TUNING.offset * NOISE),
        (0.0, TUNING.level_sd),
        (0.0, TUNING.viscosity_sd),
        (0.0, TUNING.offset_sd * NOISE),
    ]
    low, high = np.array(boxes).T
    for _ in range(steps // 1000):
        dq = rng.normal(size=1000) * 10.0 ** rng.uniform(-4, 1, 1000)
        q, load = rng.normal(size=(2, 1000)) * np.array([[3.0], [30.0]])
        dt = 10.0 ** rng.uniform(-6, 1, 1000)
        odd = rng.standard_t(1.2, size=1000) * 10.0 ** rng.uniform(-2, 2)
        tau = 14.0 * np.sign(dq) + 10.0 * dq + odd
        tau[rng.random(1000) < 0.01] = np.nan
        tau[rng.random(1000) < 0.01] = np.inf
        adapt = rng.random(1000) < 0.9
        rows = np.stack([dt, dq, q, load, tau + load, load, adapt], axis=1).tolist()
        for row in rows:
            seen = run.step(*row)
            torque = seen[0] - offset - law.values["tau_0"]
            after = float(k @ np.square(run.states))
            taken = torque * row[1] * row[0]
            assert taken - (after - stored) >= -1e-9 * max(1.0, abs(taken))
            offset, stored = seen[3], after
            assert np.all((low - 1e-12 <= seen[1:]) & (np.array(seen[1:]) <= high + 1e-12))


def test_no_measurement_generates_energy() -> None:
    fuzzed(10_000, 0)


@pytest.mark.soak
def test_a_million_adaptations_generate_no_energy() -> None:
    fuzzed(1_000_000, 1)


# --- refusals ---------------------------------------------------------------------------------


def test_a_law_without_bounds_cannot_adapt() -> None:
    law = FrictionLaw(name="stribeck", form=Stribeck.form({}), values={
        "F_c": 1.0, "F_s": 1.0, "v_s": 0.1, "sigma_2": 1.0, "tau_0": 0.0})  # fmt: skip
    with pytest.raises(ExportError, match="has neither stops nor bristles"):
        adaptive_components(model(law))


def test_incomplete_models_are_refused() -> None:
    known = model(lugre())
    with pytest.raises(SimulationError, match=("training ranges and errors are missing")):
        adaptive_components(replace(known, training_rmse=()))
    coupled = replace(known, coupling=Coupling(((2.0,),)))
    with pytest.raises(SimulationError, match="adaptation does not support coupled joints"):
        adaptive_components(coupled)
    with pytest.raises(SimulationError, match="none, not j1"):
        Follower(known).follow([])


def test_noise_has_the_stated_level() -> None:
    found = coloured(200_000, STEP, 0.1, 2.0, 0)
    assert found.std() == pytest.approx(2.0, rel=0.05)
