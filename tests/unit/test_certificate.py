"""Passivity certificates: proofs that hold on random steps, and cycles that generate energy."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
import sympy
from oracles.over_log import StatesOverLog
from oracles.stepper import Stepper

from hesr_model.audit.attack import attack
from hesr_model.audit.audit import audit
from hesr_model.audit.certificate import (
    certify,
    find_scale_limits,
    find_storage_factors,
)
from hesr_model.audit.tones import ToneCycles, find_generating_cycle, judge_cycles
from hesr_model.equations.functions import absolute, cardinal_sine, sgn
from hesr_model.equations.memory import Relaxation, Stop
from hesr_model.fitting.estimator import registry
from hesr_model.friction.inputs import DQ, INPUTS, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.scales import add_scales
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.support.files import models_folder

TRAINED = TrainedRange(
    sample_time=0.01, dq=(-1.0, 1.0), q=(-1.0, 1.0), tau_load=(-20.0, 30.0), tau=(-20.0, 20.0)
)
STEPS, SOAK = 10_000, 1_000_000


def law_of(name: str, structure: dict[str, object] | None = None, **values: float) -> FrictionLaw:
    form = registry()[name].form(structure or {})
    return FrictionLaw(name=name, structure=structure or {}, form=form, values=values)


def own(output: sympy.Expr, *memory: Relaxation | Stop, **values: float) -> FrictionLaw:
    coefficients = tuple(Coefficient(name=k, unit="1", description="any") for k in values)
    form = LawForm(coefficients=coefficients, memory=memory, output=output)
    return FrictionLaw(name="own", form=form, values=values)


STOPS = {
    "stops": [["1", 0], ["p", 2], ["load", 4], ["root", 1], ["plus", 0], ["minus", 8]],
    "viscous": ["1", "a"],
}
STOP_VALUES = {
    "F_1": 2.0, "F_p_3": 1.0, "F_load_5": 3.0, "F_root_2": 1.0, "F_plus_1": 0.5, "F_minus_9": 0.4,
    "sigma_2": 1.0, "sigma_a": 20.0, "tau_0": 0.3, "v_a": 0.1, "v_s": 0.1, "T": 0.05,
    "load_scale": 20.0,
}  # fmt: skip
LUGRE = {"sigma_0": 5e3, "sigma_1": 0.0, "sigma_2": 3.0, "F_c": 4.0, "F_s": 6.0, "v_s": 0.05,
         "tau_0": 0.2}  # fmt: skip
WAVES = {"ripple200_cos": 0.3, "ripple200_sin": -0.4, "lag": 0.004}


def stops() -> FrictionLaw:
    return law_of("parfam_s", STOPS, **STOP_VALUES)


def rippled(window: float = 0.015, **changed: float) -> FrictionLaw:
    structure = {**STOPS, "ripple": [200], "window": window}
    return law_of("parfam_s", structure, **STOP_VALUES | WAVES | changed)


def dahl() -> FrictionLaw:
    numbers = {f"kappa_{i}": 10.0 ** (5 - i) for i in range(1, 6)}
    numbers |= {f"F_{i}": float(i) for i in range(1, 6)}
    return law_of("dahl", **numbers, sigma_2=2.0, tau_0=-0.4)


def worst_step(law: FrictionLaw, count: int, seed: int) -> float:
    """Least tau dq - dS over random steps, relative to the terms compared; >= 0 if proven.

    Steps of 1 us to 10 s, velocities over ten decades, jumping loads.
    """
    rng = np.random.default_rng(seed)
    k = find_storage_factors(law)
    factors = [k[m.name] for m in law.form.memory]
    dt = 10.0 ** rng.uniform(-6.0, 1.0, count)
    v = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-7.0, 2.0, count)
    load = 30.0 * rng.normal(size=count)
    dt[0] = 0.0
    t, q = np.cumsum(dt), np.zeros(count)
    tau = predict(law, t=t, dq=v, q=q, tau_load=load) - law.values["tau_0"]
    arguments = (*(c.symbol for c in law.form.coefficients), *INPUTS)
    memory = StatesOverLog(law.form.memory, arguments, ())
    values = (*law.values.values(), v, q, load)
    begins = np.arange(count) == 0
    states = memory(values, np.diff(t, prepend=0.0), begins, law.start, "exact")[::2]
    stored = sum((f * x**2 for f, x in zip(factors, states, strict=True)), np.zeros(count))
    power = tau * v * np.diff(t, prepend=0.0)
    margin = power[1:] - np.diff(stored)
    size = np.maximum(np.maximum(stored[1:], stored[:-1]), np.abs(power[1:]))
    return float(np.min(margin / size))


# --- proofs -----------------------------------------------------------------------------------

PROVEN = [stops(), dahl(), law_of("lugre", **LUGRE)]


@pytest.mark.parametrize(
    "law", [stops(), dahl(), law_of("lugre", **LUGRE)], ids=lambda law: law.name
)
def test_proven_laws_are_passive_on_random_steps(law: FrictionLaw) -> None:
    assert certify(law, TRAINED).largest_step == inf
    assert worst_step(law, STEPS, 0) > -1e-9


@pytest.mark.soak
@pytest.mark.parametrize(
    "law", [stops(), dahl(), law_of("lugre", **LUGRE)], ids=lambda law: law.name
)
def test_proven_laws_are_passive_on_a_million_steps(law: FrictionLaw) -> None:
    assert worst_step(law, SOAK, 1) > -1e-9


def test_a_proof_names_its_premises() -> None:
    found = certify(stops(), TRAINED)
    assert found.verdict == "proven"
    assert found.storage.startswith("S = 3e-05 x_1^2")
    assert any("F(x_load_5) = 3 >= 0" in said for said in found.rests_on)
    assert any("f(v) >= 1 N.m.s/rad" in said for said in found.rests_on)


def broken(**changed: float) -> FrictionLaw:
    return replace(stops(), values=STOP_VALUES | changed)


@pytest.mark.parametrize(
    ("law", "why"),
    [
        (broken(F_1=-0.1), "the factor of x_1 is negative"),
        (broken(sigma_2=-0.5), "friction is"),
        (law_of("lugre", **LUGRE | {"sigma_1": 10.0}), "Barabanov and Ortega require"),
        (
            own(
                TAU_LOAD * sympy.Symbol("x", real=True),
                Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=1),
            ),
            "the factor of x depends on",
        ),
        (
            own(
                sympy.Symbol("x", real=True) ** 2,
                Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=1),
            ),
            "the factor of x depends on",
        ),
        (
            own(
                sympy.Symbol("x", real=True),
                Stop(name="x", unit="1", velocity=-DQ, deflection=1e-3, bound=1),
            ),
            "the velocity of the stop",
        ),
        (own(Q * DQ), "not a sum of waves"),
        (own(DQ + TAU_LOAD), "load is in the torque itself"),
    ],
)
def test_missing_proofs_have_a_reason(law: FrictionLaw, why: str) -> None:
    found = certify(law, TRAINED)
    assert found.verdict != "proven"
    assert why in found.rests_on[0]


def test_lugre_follows_the_condition_of_barabanov_and_ortega() -> None:
    """Passive for sigma_2 >= sigma_1 (F_s - F_c)/F_c, sampled exactly at any step."""
    enough = 10.0 * (6.0 - 4.0) / 4.0
    proven = certify(law_of("lugre", **LUGRE | {"sigma_1": 10.0, "sigma_2": enough}), TRAINED)
    assert (proven.verdict, proven.largest_step) == ("proven", inf)
    assert "|z| <= 0.0012 rad times coulomb_scale at the start" in proven.rests_on
    less = certify(law_of("lugre", **LUGRE | {"sigma_1": 10.0, "sigma_2": 0.999 * enough}), TRAINED)
    assert less.verdict != "proven"


STEEP = {"c_0": 0.0, "c_dq": 10.0, "c_g1": -5.4, "theta1_0": -1.01e5, "theta1_dq": 1e5}
NEGATIVE = {"F_c": 4.0, "F_s": -4.0, "v_s": 2e-5, "sigma_2": 3.0, "tau_0": 0.0}


@pytest.mark.parametrize(
    ("law", "why"),
    [
        (law_of("parfam_v", registry()["parfam_v"].typical, **STEEP), "at 1.01 rad/s friction"),
        (law_of("stribeck", **NEGATIVE), "less than back"),
        (law_of("stribeck", **NEGATIVE | {"v_s": 1e-11}), "less than back"),
        (law_of("lugre", **LUGRE | {"F_s": -4.0, "v_s": 2e-5}), "rate of z has no bound"),
        (own(absolute(DQ) * (absolute(DQ) - 0.5) * sgn(DQ)), "less than back"),
        (own((3.0 + cardinal_sine(DQ)) * DQ), "no sufficient bound"),
    ],
    ids=["steep tanh", "negative F_s", "near rest", "bristle", "negative at low speed", "unknown"],
)
def test_what_happens_between_grid_points_is_no_proof(law: FrictionLaw, why: str) -> None:
    found = certify(law, TRAINED)
    assert found.verdict in ("refuted", "tested")
    assert why in found.rests_on[0]


# --- factors ----------------------------------------------------------------------------------


def test_limits_of_factors_of_laws_without_ripple() -> None:
    free = [(0.0, None), (0.0, None)]
    for law in (*PROVEN, law_of("lugre", **LUGRE | {"sigma_1": 10.0})):  # the last one is open
        assert find_scale_limits(law) == free
    # Either part alone would drive.
    mixed = own(3.0 * sympy.tanh(DQ) - DQ + DQ * absolute(DQ))
    assert certify(mixed, TRAINED).verdict == "proven"
    assert find_scale_limits(mixed) == [(1.0, 1.0), (1.0, 1.0)]
    both = own(2.0 * sympy.tanh(DQ) + DQ + 1e-3 * sympy.cos(100 * Q - 0.1 * DQ))
    assert certify(both, TRAINED).verdict == "proven"
    assert find_scale_limits(both) == [(1.0, 1.0), (1.0, 1.0)]


def test_damping_limits_the_viscous_factor() -> None:
    law = law_of("lugre", **LUGRE | {"sigma_1": 10.0, "sigma_2": 8.0})
    assert find_scale_limits(law)[0] == (0.0, None)
    least, greatest = find_scale_limits(law)[1]
    assert (least, greatest) == (pytest.approx(5.0 / 8.0, rel=1e-4), None)
    assert least >= 5.0 / 8.0


def test_ripple_limits_the_viscous_factor_to_where_the_proof_holds() -> None:
    law = rippled()
    coulomb, (least, greatest) = find_scale_limits(law)
    assert (coulomb, greatest) == ((0.0, None), None)
    for share, proven in ((least, True), (0.999 * least, False)):
        viscous = {n: share * law.values[n] for n in ("sigma_2", "sigma_a")}
        found = certify(replace(law, values={**law.values, **viscous}), TRAINED)
        assert (found.verdict == "proven") == proven


def generated(law: FrictionLaw, factors: dict[str, float], seed: int) -> float:
    """Largest energy [J] of random closed paths, in their third cycle."""
    whole = replace(law, form=add_scales(law.form), values={**law.values, **factors})
    rng = np.random.default_rng(seed)
    most = -inf
    for _ in range(60):
        dt = 10.0 ** rng.uniform(-4.0, -1.0)
        n = int(rng.integers(20, 200))
        phase = 2.0 * np.pi * np.arange(n) / n
        dq = 10.0 ** rng.uniform(-2.0, 1.0) * np.sin(phase) + 0.1 * rng.normal(size=n)
        dq = np.tile(dq - dq.mean(), 3)
        q = np.cumsum(dq) * dt
        tau = predict(whole, t=dt * np.arange(3 * n), dq=dq, q=q, tau_load=0.0 * q)
        most = max(most, -float(np.sum((tau * dq)[-n:]) * dt))
    return most


@pytest.mark.parametrize("seed", range(3))
def test_factors_within_their_limits_generate_no_energy(seed: int) -> None:
    law = rippled()
    limits = dict(zip(("coulomb_scale", "viscous_scale"), find_scale_limits(law), strict=True))
    low = {name: least for name, (least, _) in limits.items()}
    for changed in ({}, {"coulomb_scale": 5.0}, {"viscous_scale": 5.0}):
        assert generated(law, low | changed, seed) < 1e-12
    assert generated(law, dict.fromkeys(low, 0.0), seed) > 1e-4


# --- ripple -----------------------------------------------------------------------------------


def test_ripple_with_a_window_is_certified_at_any_step() -> None:
    found = certify(rippled(), TRAINED)
    assert (found.verdict, found.largest_step) == ("proven", inf)


def test_ripple_with_too_large_a_lag_is_not_certified() -> None:
    assert certify(rippled(lag=0.2, sigma_a=0.0), TRAINED).verdict != "proven"


def test_sampled_ripple_without_a_mean_is_certified_up_to_a_step() -> None:
    x = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=1)
    law = own(x.state + 20.0 * DQ + 0.5 * sympy.cos(200 * (Q - 0.004 * DQ)), x)
    found = certify(law, TRAINED)
    # 20 = 0.5 * 200 * (mean distance of the lag from (0, h)): h = 0.4 s and lag.
    assert found.verdict == "proven"
    assert found.largest_step == pytest.approx(0.4, rel=0.15)


def test_sine_and_cosine_of_an_order_count_as_one() -> None:
    x = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=1)
    angle = 200 * (Q - 0.004 * DQ)

    def step(cosine: float, sine: float) -> float | None:
        waves = cosine * sympy.cos(angle) + sine * sympy.sin(angle)
        return certify(own(x.state + 20.0 * DQ + waves, x), TRAINED).largest_step

    of_one = step(0.5, 0.0)
    assert of_one == step(0.3, -0.4) == step(-0.4, 0.3) == step(0.0, 0.5)


def test_ripple_amplitude_may_fall_with_speed_like_a_filter() -> None:
    x = Stop(name="x", unit="1", velocity=DQ, deflection=1e-3, bound=1)
    wave = 0.5 * sympy.cos(200 * (Q - 0.004 * DQ))
    filtered, other = (
        certify(own(x.state + 20.0 * DQ + wave / amplitude, x), TRAINED)
        for amplitude in (1 + 4 * DQ**2, 1 + DQ)
    )
    assert filtered.verdict == "proven"
    assert "more than smoothing" in other.rests_on[0]


@pytest.mark.parametrize("dt", [1e-4, 0.004, 0.05, 2.0])
def test_no_closed_path_generates_energy(dt: float) -> None:
    """Random closed paths with ripple and a moving load: the work of the tenth round."""
    law, rng = rippled(), np.random.default_rng(0)
    for _ in range(10):
        dq = rng.normal(size=30) * 10.0 ** rng.uniform(-4.0, 1.0)
        dq -= dq.mean()
        load = 30.0 * rng.normal(size=30)
        stepper, q = Stepper(law), 0.0
        for _ in range(10):
            work = 0.0
            for v, tau_load in zip(dq, load, strict=True):
                q += v * dt
                work += stepper.step(dt, float(v), q, float(tau_load)) * v * dt
        assert work > -1e-12


# --- refutations ------------------------------------------------------------------------------


def test_table_i_is_refuted_by_its_cycles() -> None:
    model = FrictionModel.read(models_folder() / "uf850" / "table1.json")
    still = replace(TRAINED, sample_time=0.005, dq=(-1.2, 1.2), tau_load=(0.0, 0.0))
    found = [certify(law, still) for law in model.laws]
    energies = [c.cycle.energy if c.cycle else 0.0 for c in found]
    assert [c.verdict for c in found[:2]] == ["refuted", "refuted"]
    assert energies[:2] == pytest.approx([12.4, 20.6], abs=0.05)


def test_load_is_refuted_as_a_factor_but_not_as_a_bound() -> None:
    x = Stop(name="x", unit="1", velocity=DQ, deflection=1e-4, bound=1)
    factor = own((2.0 + absolute(TAU_LOAD)) * x.state + DQ, x)
    found = certify(factor, TRAINED)
    assert found.verdict == "refuted"
    assert found.cycle is not None
    assert found.cycle.swing > 0.0
    assert found.cycle.energy > 1e-7
    assert f"{found.cycle.energy:.3g} J per cycle" in found.cycle.text
    bound = replace(x, bound=2.0 + absolute(TAU_LOAD))
    # 6 frequencies, 8 amplitudes, 3 loads, 4 x 8 x 2 small motions with a moving load, and tones.
    tones = 256 + 4 * 16 * 8
    assert attack(own(x.state + DQ, bound), TRAINED) == (None, 6 * 8 * 3 + 4 * 8 * 2 + tones)
    assert certify(own(x.state + DQ, bound), TRAINED).verdict == "proven"


def test_driving_at_low_speed_is_refuted() -> None:
    found = certify(own(DQ - 0.1 * sgn(DQ)), TRAINED)
    assert found.verdict == "refuted"
    assert "less than back" in found.rests_on[0]


@pytest.mark.parametrize(
    ("law", "energy"),
    [
        # Up to 5.4 N.m - (10 v - 5.4 N.m) at v = 1.01 rad/s; less 0.01 N.m back at 0.001 rad/s.
        (law_of("parfam_v", registry()["parfam_v"].typical, **STEEP), 0.689),
        (law_of("stribeck", **NEGATIVE), 8.0 * np.exp(-(0.05**2)) * 2.0 - 8.0),
    ],
    ids=["steep tanh", "negative F_s"],
)
def test_speeds_at_which_a_proof_fails_refute_it(law: FrictionLaw, energy: float) -> None:
    found = certify(law, TRAINED)
    assert found.verdict == "refuted"
    assert found.cycle is not None
    assert found.cycle.energy == pytest.approx(energy, rel=1e-2)
    assert f"{found.cycle.amplitude:.3g} rad/s forward and" in found.cycle.text


def test_an_offset_does_not_count_as_driving() -> None:
    found = certify(own(DQ + 3.0), TRAINED)
    assert (found.verdict, found.storage, found.largest_step) == ("proven", "S = 3 q", inf)
    viscous, offset = found.rests_on
    assert viscous == "f(v) >= 1 N.m.s/rad at all speeds"
    assert "3 N.m" in offset


def test_without_an_offset_the_storage_names_none() -> None:
    assert certify(own(DQ), TRAINED).storage == "S = 0"


# Dissipates in slow sines; at fast small motion h leads the speed by its derivative.
FAST = {"alpha": 40.0, "beta": 120.0, "c_0": 0.0, "c_dq": 4.0, "c_h": 4.0, "c_dh": -0.05}


def fast() -> FrictionLaw:
    structure = {"linear": ["1", "dq", "h", "dh"], "units": []}
    return law_of("parfam_h", structure, **FAST)


def test_a_law_that_generates_only_in_fast_tones_is_refuted() -> None:
    """The cycle goes on to generate energy in a finer simulation from rest."""
    assert audit(fast(), TRAINED).generated == 0.0  # in sines up to 2 Hz
    certificate = certify(fast(), TRAINED)
    assert certificate.verdict == "refuted"
    cycle, energy, tried_count = find_generating_cycle(fast(), TRAINED, (0.0,))
    assert cycle is not None
    assert certificate.cycle is not None
    assert certificate.cycle.tones == cycle.describe()
    assert certificate.sequences > tried_count
    frequency = cycle.frequency[0]
    t = np.linspace(0.0, 60.0 / frequency, 60 * 1000 + 1)
    dq = np.zeros_like(t)
    for multiple, amplitude, phase in zip(
        cycle.multiples[0], cycle.amplitudes[0], cycle.phases[0], strict=True
    ):
        dq += amplitude * np.cos(2.0 * np.pi * multiple * frequency * t + phase)
    tau = predict(fast(), t=t, dq=dq, q=np.zeros_like(t), tau_load=np.zeros_like(t))
    work = float(np.trapezoid((tau * dq)[-1001:], t[-1001:]))
    assert work == pytest.approx(-energy, rel=0.2)


def test_a_pair_of_tones_of_a_fitted_law_generates_energy() -> None:
    """20 Hz of 2 mrad/s and 40 Hz of 8 mrad/s."""
    pair = ToneCycles(
        frequency=np.array([20.0]),
        multiples=np.array([[1, 2, 0]]),
        amplitudes=np.array([[2e-3, 8e-3, 0.0]]),
        phases=np.zeros((1, 3)),
        tau_load=np.zeros(1),
    )
    share, energy = judge_cycles(fast(), TRAINED, pair, 60)
    assert share[0] > 0.1
    assert energy[0] > 0.0


@pytest.mark.parametrize("law", PROVEN, ids=lambda law: law.name)
def test_no_tones_of_a_proven_law_generate_energy(law: FrictionLaw) -> None:
    cycle, energy, tried_count = find_generating_cycle(law, TRAINED, (-20.0, 0.0, 30.0))
    assert (cycle, energy) == (None, 0.0)
    assert tried_count > 500
