"""Behaviour of every law of the registry in a drive: reversals, accuracy, energy, rest.

The laws are fitted to one joint's friction of known form in fast and very slow motion; every law
then passes the passivity audit. All are joints of one FMU, each with 3 and with 0.6 kg.m2. With
ALL_LAWS in the environment, as in the nightly run, these are all laws of everyday tests.
"""

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from drive_runs import Run, drive, reversals
from registry_models import STUDIED
from scipy.integrate import cumulative_simpson, solve_ivp

from fmu_src.pages.datasheet import EULER
from fmu_src.pages.friction_page import holding_torque, stopping_torque
from hesr_model.audit.audit import audit
from hesr_model.fitting.estimator import estimator
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.dahl import DEFLECTIONS
from hesr_model.rigid_body.friction_record import FrictionRecord

INERTIA = (3.0, 0.6)  # [kg.m2], both for every law
STEPS = (1e-4, 1e-3, 5e-3, 1e-2)  # [s]
REFERENCE = 1e-6  # [s]
GRID = 1e-2  # [s] duration of a held torque
GATE = ("stribeck", "parfam_v", "parfam_h", "mlp_h", "lugre", "lugre_load", "parfam_s")
EXPLAINING = tuple(name for name in STUDIED if name not in ("none", "constant"))
LAWS = EXPLAINING if os.environ.get("ALL_LAWS") else GATE
FORGETS = tuple(name for name in ("parfam_v", "parfam_h", "mlp_h", "rbfnn_h") if name in LAWS)
"""Laws without memory of position: no state, or one that decays at rest (the paper's h)."""
NETWORKS = ("mlp_h", "rbfnn_h")
JUMPS = ("stribeck",)
"""Laws that hold by a jump at rest, if the fit found one."""
REMEMBERS = tuple(name for name in LAWS if name not in (*FORGETS, *JUMPS))


@cache
def records() -> tuple[FrictionRecord, ...]:
    """Torque of five elements with memory, load and viscous friction in fast and slow motion."""
    form = estimator("dahl_load").form({})
    values = {f"kappa_{i}": 1.0 / d for i, d in enumerate(DEFLECTIONS, start=1)}
    values |= {f"F_{i}": f for i, f in enumerate((1.0, 3.0, 3.0, 2.0, 0.5), start=1)}
    values |= {f"mu_{i}": f for i, f in enumerate((0.01, 0.02, 0.02, 0.01, 0.005), start=1)}
    values |= {"sigma_2": 5.0, "tau_0": 0.4}
    truth = FrictionLaw(name="dahl_load", form=form, values=values)
    return tuple(_record(truth, k, peak) for k, peak in enumerate((1.0, 0.3, 0.03)))


def _record(truth: FrictionLaw, seed: int, peak: float) -> FrictionRecord:
    rng = np.random.default_rng(seed)
    t = 0.008 * np.arange(2000)
    angle = np.outer(t, 2.0 * np.pi * np.array([0.11, 0.19, 0.31, 0.43])) + rng.uniform(0, 6, 4)
    dq = peak * np.sin(angle) @ [0.4, 0.3, 0.2, 0.1]
    q = cumulative_simpson(dq, x=t, initial=0.0)
    load = 15.0 * np.sin(1.3 * t) + 10.0 * np.cos(0.7 * t)
    tau = predict(truth, t=t, dq=dq, q=q, tau_load=load) + rng.normal(0.0, 0.1, len(t))
    return FrictionRecord(
        log=f"log{seed}", joint="axis", t=t, dq=dq, q=q, tau_load=load, tau=tau, gear_ratio=101.0
    )


@cache
def fitted() -> dict[str, FrictionLaw]:
    return {name: fit_joint(name, records(), seed=0) for name in LAWS}


def both(values: Mapping[str, float]) -> list[float]:
    """One number per law for both of its joints."""
    return [values[name] for name in LAWS for _ in INERTIA]


def joints_of(name: str) -> slice:
    first = len(INERTIA) * LAWS.index(name)
    return slice(first, first + len(INERTIA))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    laws = {f"{name}_{j}": fitted()[name] for name in LAWS for j, _ in enumerate(INERTIA)}
    return drive(laws, tmp_path_factory.mktemp("drive"), INERTIA * len(LAWS))


@pytest.fixture(scope="module")
def swung() -> np.ndarray:
    """A sine that moves a joint of 0.6 kg.m2 at up to 1 rad/s and reverses it four times.

    For networks it is limited to the measured torque: their own largest torque is at the edge of
    their training range, and exceeding it drives the joint into speeds without friction.
    """
    trained = TrainedRange.from_records(records())
    measured = max(float(np.abs(r.tau).max()) for r in records())
    audits = {name: audit(law, trained).largest for name, law in fitted().items()}
    largest = both(
        {name: min(own, measured) if name in NETWORKS else own for name, own in audits.items()}
    )
    share = np.tile((1.6, 1.2), len(LAWS))
    t = GRID * np.arange(200)
    return np.sin(2.0 * np.pi * t)[:, None] * share * largest


@pytest.fixture(scope="module")
def runs(fmu: Path, swung: np.ndarray) -> dict[float, Run]:
    """Each step is one inner step; the reference is sampled every 0.1 ms."""
    found = {step: Run(fmu, swung, grid=GRID, step=step) for step in STEPS}
    return found | {REFERENCE: Run(fmu, swung, grid=GRID, step=1e-4, substep=REFERENCE)}


@pytest.fixture(params=LAWS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.mark.ci
@pytest.mark.parametrize("law", LAWS)
def test_the_laws_are_passive(law: str) -> None:
    found = audit(fitted()[law], TrainedRange.from_records(records()))
    assert found.generated == 0.0
    assert found.driving_both_ways == ()
    assert not found.explodes


def test_reversals_are_single_at_every_step(name: str, runs: dict[float, Run]) -> None:
    truth, swings = runs[REFERENCE].dq[:, joints_of(name)], 0
    for joint in range(len(INERTIA)):
        true = reversals(truth[:, joint])
        swings += true
        for step in STEPS:
            found = runs[step].dq[:, joints_of(name)][:, joint]
            assert 0 < reversals(found) <= true, step
    assert swings >= 5


def test_the_default_substep_reverses_as_often(
    name: str, fmu: Path, swung: np.ndarray, runs: dict[float, Run], default: Run
) -> None:
    own, inner = default.dq[:, joints_of(name)], runs[1e-3].dq[:, joints_of(name)]
    np.testing.assert_allclose(own, inner[9::10], rtol=0, atol=1e-9 * np.abs(inner).max())


@pytest.fixture(scope="module")
def default(fmu: Path, swung: np.ndarray) -> Run:
    return Run(fmu, swung, grid=GRID, step=GRID, substep=1e-3)


def test_the_error_decreases_with_the_step(name: str, runs: dict[float, Run]) -> None:
    own = joints_of(name)
    truth = runs[REFERENCE].dq[round(GRID / 1e-4) - 1 :: round(GRID / 1e-4), own]
    errors = []
    for step in STEPS:
        rows = round(GRID / step)
        difference = runs[step].dq[rows - 1 :: rows, own] - truth
        errors.append(np.sqrt(np.mean(difference**2, axis=0)))
    assert np.all(np.diff(errors, axis=0) > 0.0)
    order = np.log10(errors[1] / errors[0])  # 0.1 ms to 1 ms
    assert np.all(order > 0.95), order


def test_the_reference_is_the_continuous_motion(runs: dict[float, Run], swung: np.ndarray) -> None:
    """LuGre in a drive is an ordinary differential equation, solved here by SciPy."""
    law, rows = fitted()["lugre"], 60
    k, own = law.values, joints_of("lugre")

    def motion(_t: float, y: np.ndarray, torque: float, inertia: float) -> list[float]:
        v, z = y
        level = k["F_c"] + (k["F_s"] - k["F_c"]) * np.exp(-((v / k["v_s"]) ** 2))
        dz = v - k["sigma_0"] * abs(v) / level * z
        friction = k["sigma_0"] * z + k["sigma_1"] * dz + k["sigma_2"] * v + k["tau_0"]
        return [(torque - friction) / inertia, dz]

    for joint, inertia in enumerate(INERTIA):
        y, speeds = np.zeros(2), []
        for torque in swung[:rows, own][:, joint]:
            solved = solve_ivp(
                motion,
                (0.0, GRID),
                y,
                method="LSODA",
                rtol=1e-10,
                atol=1e-13,
                args=(torque, inertia),
            )
            y = solved.y[:, -1]
            speeds.append(y[0])
        found = runs[REFERENCE].dq[99 : 100 * rows : 100, own][:, joint]
        # The error at 1 us is a thousandth of that at 1 ms, which is 5e-3 rad/s.
        np.testing.assert_allclose(found, speeds, rtol=0, atol=1e-5)


def test_no_step_creates_energy(fmu: Path, swung: np.ndarray, runs: dict[float, Run]) -> None:
    """Kinetic energy increases by the work of the torques minus J (change of speed)^2 / 2."""
    inertia = np.tile(INERTIA, len(LAWS))
    for step in STEPS:
        run = runs[step]
        before = np.vstack([np.zeros(run.dq.shape[1]), run.dq[:-1]])
        torque = np.repeat(swung, round(GRID / step), axis=0)
        work = (torque - run.tau_f) * run.dq * step
        lost = work - 0.5 * inertia * (run.dq**2 - before**2)
        taken = 0.5 * inertia * (run.dq - before) ** 2
        scale = np.abs(work).max(axis=0)
        np.testing.assert_allclose(lost / scale, taken / scale, rtol=0, atol=1e-9)
        assert np.all(taken.sum(axis=0) > 0.0)


@pytest.mark.parametrize("step", STEPS[1:])
def test_a_nudged_joint_comes_to_rest(fmu: Path, step: float) -> None:
    """Only friction without its offset acts; no law returns more than the nudge."""
    nudge, seconds = 0.05, 10.0
    still = both({n: float(predict(law, t=[0.0], dq=[0.0])[0]) for n, law in fitted().items()})
    # Start from rest: elements stretched as in steady motion would push it back further.
    start: dict[str, float] = {f"dq_start[{i}]": nudge for i in range(1, len(still) + 1)}
    start |= {"start_mode": 2}
    tau = np.tile(still, (round(seconds / GRID), 1))
    run = Run(fmu, tau, grid=GRID, step=step, start=start)
    assert np.abs(run.dq).max() < nudge
    holding = [i for i, name in enumerate(np.repeat(LAWS, 2)) if name in REMEMBERS]
    assert np.abs(run.dq[-1, holding]).max() < 1e-6


def offset(law: FrictionLaw) -> float:
    """Mean of the torques of crawling in both directions."""
    return float(np.mean([predict(law, t=[0, 1e12], dq=[0, v])[1] for v in (-1e-9, 1e-9)]))


@pytest.fixture(scope="module", params=[1e-3, 1e-2])
def held(request: pytest.FixtureRequest, fmu: Path) -> np.ndarray:
    """Drift in 60 s, after 5 s, under half the holding torque of each law, or 3 N.m without any."""
    load = {name: offset(law) + 3.0 for name, law in fitted().items()}
    load |= {n: offset(fitted()[n]) + 0.5 * stopping_torque(fitted()[n]) for n in REMEMBERS}
    grid = 0.5
    run = Run(fmu, np.tile(both(load), (round(65.0 / grid), 1)), grid=grid, step=request.param)
    return run.q[-1] - run.q[round(5.0 / request.param) - 1]


@pytest.mark.parametrize("law", REMEMBERS)
def test_laws_with_memory_of_position_hold_a_load(law: str, held: np.ndarray) -> None:
    assert stopping_torque(fitted()[law]) > 0.5
    assert np.abs(held[joints_of(law)]).max() < 10e-6


@pytest.mark.parametrize("law", FORGETS)
def test_laws_without_memory_at_rest_creep(law: str, held: np.ndarray) -> None:
    assert abs(holding_torque(fitted()[law])) < 1e-3
    assert np.abs(held[joints_of(law)]).min() > 1e-3


@pytest.mark.parametrize("law", JUMPS)
@pytest.mark.parametrize("step", [1e-3, 1e-2])
def test_discontinuous_laws_hold_a_load_without_drift(
    law: str, step: float, tmp_path: Path
) -> None:
    """With a given break-away torque; a fit to pre-sliding joints does not find one."""
    own = fitted()[law]
    own = replace(own, values={**own.values, "F_s": own.values["F_c"]})
    share = 0.9 * holding_torque(own)
    assert share > 5.0
    path = drive({law: own}, tmp_path, [0.6])
    run = Run(path, np.full((120, 1), offset(own) + share), grid=0.5, step=step)
    assert not run.q.any()


def test_only_explicit_coupling_chatters() -> None:
    """The limit stated in the documentation: 2 inertia / slope."""
    law = fitted()["parfam_h"]
    found = audit(law, TrainedRange.from_records(records()))
    assert found.slope is not None
    limit = EULER * INERTIA[1] / found.slope
    assert limit < 5e-3
    for step, calm in ((0.9 * limit, True), (1.5 * limit, False)):
        v, x = 1e-6, 0.0
        speeds = []
        rest = float(predict(law, t=[0.0], dq=[0.0])[0])
        for _ in range(50):
            torque = predict(law, t=[0.0, step], dq=[0.0, v], start=(x,))[1]
            v -= step / INERTIA[1] * float(torque - rest)
            speeds.append(v)
        assert (abs(speeds[-1]) < 1e-6) is calm
