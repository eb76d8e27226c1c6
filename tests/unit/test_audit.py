"""The audit on laws with a known verdict, and on the published laws."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sympy
from oracles.stepper import Stepper

from hesr_model.audit import audit as module
from hesr_model.audit.audit import ENCODER_NOISE, Audit, audit, explodes
from hesr_model.equations.functions import absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange, find_excess
from hesr_model.laws.lugre import LuGre
from hesr_model.laws.stribeck import Stribeck
from hesr_model.logs.noise import standard_normal
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.files import models_folder
from hesr_model.support.typed_files import from_json, to_json

TRAINED = TrainedRange(
    sample_time=0.005, dq=(-1.2, 1.2), q=(-0.8, 0.8), tau_load=(-20.0, 40.0), tau=(-25.0, 25.0)
)
STRIBECK = {"F_c": 9.0, "F_s": 12.0, "v_s": 0.05, "sigma_2": 8.0, "tau_0": 0.0}
LUGRE = STRIBECK | {"sigma_0": 4000.0, "sigma_1": 20.0}


def law(
    output: sympy.Expr,
    *relaxations: Relaxation,
    values: Mapping[str, float] | None = None,
    **more: object,
) -> FrictionLaw:
    names = values or {}
    form = LawForm(
        coefficients=tuple(Coefficient(name=n, unit="1", description=n) for n in names),
        memory=relaxations,
        output=output,
    )
    return FrictionLaw(**({"name": "test", "form": form, "values": names} | more))


def stribeck(**values: float) -> FrictionLaw:
    return FrictionLaw(name="stribeck", form=Stribeck.form({}), values=STRIBECK | values)


def lugre(**values: float) -> FrictionLaw:
    return FrictionLaw(name="lugre", form=LuGre.form({}), values=LUGRE | values)


def symbol(name: str) -> sympy.Symbol:
    return sympy.Symbol(name, real=True)


def first_order(rate: sympy.Expr, drive: sympy.Expr = DQ) -> Relaxation:
    return Relaxation(name="x", unit="1", drive=drive, rate=rate)


# --- the published laws -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def table_1() -> tuple[FrictionLaw, ...]:
    return FrictionModel.read(models_folder() / "uf850" / "table1.json").laws


@pytest.mark.parametrize(
    ("joint", "driving", "generated", "at", "slope", "chatter"),
    [
        (0, (-0.68, 0.81), 12.4, (0.4, 0.05), 6557, 16),
        (1, (-0.85, 0.81), 20.6, (0.6, 0.05), -4730, 16),
        (2, (-0.0056, 0.0093), 0.0, None, 2282, 5),
    ],
)
def test_table_1_drives_generates_and_chatters(
    table_1: tuple[FrictionLaw, ...],
    joint: int,
    driving: tuple[float, float],
    generated: float,
    at: tuple[float, float] | None,
    slope: float,
    chatter: float,
) -> None:
    found = audit(table_1[joint], TRAINED)
    assert len(found.driving) == 1
    assert found.driving[0] == pytest.approx(driving, rel=0.01)
    assert found.generated == pytest.approx(generated, abs=0.05)
    if at is None:
        assert found.generating is None
    else:
        assert found.generating is not None
        assert (found.generating.amplitude, found.generating.frequency) == pytest.approx(at)
        assert found.generating.work == -found.generated
        assert found.generating.share < -0.99
    assert found.slope == pytest.approx(slope, abs=0.6)
    assert found.jump == 0.0
    assert found.chatter == pytest.approx(chatter, abs=0.5)
    assert not found.explodes


@pytest.mark.parametrize(("joint", "inertia", "bound"), [(0, 3.0, 0.92e-3), (2, 0.6, 0.53e-3)])
def test_the_slope_bounds_the_explicit_step(
    table_1: tuple[FrictionLaw, ...], joint: int, inertia: float, bound: float
) -> None:
    slope = audit(table_1[joint], TRAINED).slope
    assert slope is not None
    assert 2.0 * inertia / slope == pytest.approx(bound, abs=0.006e-3)
    assert coasting(table_1[joint], inertia, 0.95 * bound) < 1e-5
    assert coasting(table_1[joint], inertia, 1.05 * bound) > 1e-4


def coasting(of: FrictionLaw, inertia: float, dt: float) -> float:
    """Largest speed of a joint after a kick of 1e-5 rad/s, its law coupled explicitly."""
    stepper = Stepper(replace(of, discretisation="exact"))
    offset = stepper.step(0.0, 0.0)
    speeds = [1e-5]
    for _ in range(200):
        speeds.append(speeds[-1] - dt / inertia * (stepper.step(dt, speeds[-1]) - offset))
    return max(map(abs, speeds[1:]))


def test_table_1_generates_more_in_slower_cycles(
    table_1: tuple[FrictionLaw, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "FREQUENCIES", (0.01,))
    assert audit(table_1[0], TRAINED).generated == pytest.approx(63, abs=0.5)
    assert audit(table_1[1], TRAINED).generated == pytest.approx(104, abs=0.5)


# --- passivity --------------------------------------------------------------------------------


@pytest.mark.parametrize("sample_time", [0.001, 0.005, 0.0106])
@pytest.mark.parametrize("passive", [stribeck(), stribeck(F_s=2.0), lugre(), lugre(F_s=5.0)])
def test_stribeck_and_lugre_are_passive(passive: FrictionLaw, sample_time: float) -> None:
    found = audit(passive, replace(TRAINED, sample_time=sample_time))
    assert found.driving == ()
    assert found.driving_both_ways == ()
    assert found.generated == 0.0
    assert found.generating is None
    assert not found.explodes


@pytest.mark.parametrize("biased", [stribeck(tau_0=-15.0), lugre(tau_0=-15.0)])
def test_an_offset_drives_one_way_but_generates_no_energy(biased: FrictionLaw) -> None:
    found = audit(biased, TRAINED)
    # Condition: 9 + 3 exp(-(v/0.05)^2) + 8 v < 15.
    assert found.driving == (pytest.approx((0.0, 0.75), rel=1e-3),)
    assert found.driving_both_ways == ()
    assert found.generated == 0.0


def test_a_torque_of_position_alone_does_no_work() -> None:
    # Twelve times per turn of a motor behind 101:1: above the sampling rate at full speed.
    ripple = law(3.0 * sympy.cos(1212.0 * Q) + 5.0 + 2.0 * TAU_LOAD)
    found = audit(ripple, TRAINED)
    assert found.generated == 0.0
    assert found.driving_both_ways == ()
    braked = audit(law(3.0 * sympy.cos(1212.0 * Q) + sgn(DQ)), TRAINED)
    assert (braked.driving, braked.generated) == ((), 0.0)
    assert braked.largest == pytest.approx(4.0, rel=1e-3)


def test_velocity_ranges_end_at_sign_changes_of_the_torque() -> None:
    found = audit(law(DQ * (DQ - 0.3) * (DQ - 0.7) * (DQ + 0.501)), TRAINED)
    assert found.driving == (
        pytest.approx((-1.2, -0.501), rel=1e-3),
        pytest.approx((0.3, 0.7), rel=1e-3),
    )
    both_ways = audit(law(DQ * (DQ**2 - 0.25)), TRAINED)
    assert both_ways.driving == (pytest.approx((-0.5, 0.5), rel=1e-3),)
    assert both_ways.driving_both_ways == (pytest.approx((0.0, 0.5), rel=1e-3),)
    assert audit(law(-DQ), TRAINED).driving == ((-1.2, 1.2),)


def test_the_worst_trained_load_decides() -> None:
    found = audit(law((1.0 - TAU_LOAD / 20.0) * sgn(DQ)), TRAINED)
    assert found.driving == ((-1.2, 1.2),)
    assert found.generating is not None
    assert found.generating.tau_load == 40.0
    # Four quarters of amplitude / (2 pi frequency), each against -1 N.m.
    assert found.generated == pytest.approx(4.0 * 1.2 / (2.0 * np.pi * 0.05), rel=1e-3)
    assert audit(law(absolute(TAU_LOAD) * sgn(DQ)), TRAINED).generated == 0.0
    # Without load this law drives.
    unloaded = law((absolute(TAU_LOAD) - 5.0) * sgn(DQ))
    assert audit(unloaded, TRAINED).driving == ((-1.2, 1.2),)
    assert audit(unloaded, replace(TRAINED, tau_load=(6.0, 40.0))).driving == ()


@pytest.mark.parametrize("discretisation", ["exact", "euler"])
def test_states_are_taken_in_steady_sliding(discretisation: str) -> None:
    # x settles at -dq / 2, which exceeds dq / 3.
    slow = law(
        DQ / 3.0 + symbol("x"),
        first_order(sympy.Integer(2), -DQ),
        discretisation=discretisation,
    )
    found = audit(slow, TRAINED)
    assert found.driving == ((-1.2, 1.2),)
    assert found.generating is not None
    # The damping at w is Re(1/3 - 1/(2 + j w)); the work is damping amplitude^2 / (2 f).
    damping = 1.0 / 3.0 - 2.0 / (4.0 + (2.0 * np.pi * 0.05) ** 2)
    assert found.generated == pytest.approx(-damping * 1.2**2 / (2.0 * 0.05), rel=0.03)


# --- at rest ----------------------------------------------------------------------------------


def test_slopes_at_rest() -> None:
    viscous = audit(law(3.0 * DQ), TRAINED)
    assert (viscous.slope, viscous.slope_of_step) == pytest.approx((3.0, 3.0))
    bristles = audit(lugre(), TRAINED)
    assert bristles.slope == pytest.approx(20.0 + 8.0, rel=1e-3)
    assert bristles.slope_of_step == pytest.approx(4000.0 * 0.005 + 20.0 + 8.0, rel=1e-3)
    constant = audit(law(sympy.Float(2.0)), TRAINED)
    assert (constant.jump, constant.slope, constant.slope_of_step) == (0.0, 0.0, 0.0)


def test_the_slope_is_taken_at_the_start_states() -> None:
    state = symbol("x")
    # The derivative of the state follows the velocity before the state does.
    of_start = law(DQ * state, first_order(sympy.Integer(40)), start=(3.0,))
    assert audit(of_start, TRAINED).slope == pytest.approx(3.0)
    assert audit(of_start, TRAINED).slope_of_step == pytest.approx(3.0 * np.exp(-0.2), rel=1e-3)
    assert audit(law(symbol("dx"), first_order(sympy.Integer(40))), TRAINED).slope == 1.0


def test_a_jump_has_no_slope() -> None:
    found = audit(stribeck(), TRAINED)
    assert found.jump == pytest.approx(24.0)
    assert found.slope is None
    assert found.slope_of_step is None
    assert found.chatter == pytest.approx(12.0, rel=0.05)


@pytest.mark.parametrize("share", [0.4, 0.6])
def test_a_jump_needs_most_of_the_rise_across_rest(share: float) -> None:
    """A law with a jump and a slope so steep that the jump is little of the change at rest."""
    found = audit(law(share * sgn(DQ) + (1.0 - share) * 1e6 * DQ), TRAINED)
    if share < 0.5:
        assert (found.jump, found.slope) == (0.0, pytest.approx(1e6))
    else:
        assert (found.jump, found.slope) == (pytest.approx(2.0 * share, rel=2e-3), None)


def test_the_worst_load_decides_at_rest() -> None:
    found = audit(law(0.1 * absolute(TAU_LOAD) * DQ), TRAINED)
    assert found.slope == pytest.approx(4.0)
    assert found.chatter == pytest.approx(4.0 * np.sqrt(2.0) * ENCODER_NOISE / 0.005, rel=0.03)


def test_chatter_is_the_response_to_encoder_noise() -> None:
    assert audit(law(3.0 * DQ), TRAINED).chatter == pytest.approx(
        3.0 * np.sqrt(2.0) * ENCODER_NOISE / 0.005, rel=0.03
    )
    assert audit(law(1e5 * Q), TRAINED).chatter == pytest.approx(1e5 * ENCODER_NOISE, rel=0.03)


# --- beyond the trained range -----------------------------------------------------------------


def test_largest_torques_inside_and_just_outside() -> None:
    found = audit(law(2.0 * DQ + 0.25 * TAU_LOAD), TRAINED)
    assert found.largest == pytest.approx(2.0 * 1.2 + 0.25 * 40.0)
    assert found.largest_outside == pytest.approx(2.0 * 1.8 + 0.25 * 55.0)
    assert not found.explodes


@pytest.mark.parametrize(
    ("output", "refused"),
    [
        (25.0 / 1.2**2 * DQ * absolute(DQ), False),  # 2.25 times
        (25.0 / 1.2**3 * DQ**3, True),  # 3.4 times
        (25.0 / sympy.sinh(12) * sympy.sinh(10 * DQ), True),
        (sympy.exp(500 * (DQ - 1.2)), True),  # overflows
        (1 / (DQ - 1.8), True),  # infinite at the edge
    ],
)
def test_explosion_beyond_the_range_is_detected(output: sympy.Expr, refused: bool) -> None:
    one = law(output)
    assert explodes(one, TRAINED) is refused
    found = audit(one, TRAINED)
    assert found.explodes is refused
    to_json(found)


def test_a_law_that_fails_beyond_the_range_explodes() -> None:
    # rate * dt reaches 1 at 1.5 rad/s.
    unstable = law(
        symbol("x"), first_order(absolute(DQ) / 0.0075, DQ / 0.0075), discretisation="euler"
    )
    found = audit(unstable, TRAINED)
    assert found.largest_outside is None
    assert found.explodes
    assert explodes(unstable, TRAINED)


def test_a_guarded_negative_rate_does_not_explode() -> None:
    # Without the guard the state would grow by e^12 in a cycle beyond the trained range.
    guarded = law(symbol("x"), first_order(1.5 - DQ))
    assert not explodes(guarded, TRAINED)
    assert np.isfinite(audit(law(symbol("x"), first_order(0.5 - DQ)), TRAINED).largest)


def test_a_law_that_fails_within_the_range_cannot_be_audited() -> None:
    with pytest.raises(SimulationError, match=r"^law 'test': torque is not finite within"):
        audit(law(sympy.exp(2000 * DQ)), TRAINED)


# --- results ----------------------------------------------------------------------------------


@pytest.mark.parametrize("audited", [stribeck(), lugre(), law(-DQ)])
def test_an_audit_survives_json_and_is_reproducible(audited: FrictionLaw) -> None:
    found = audit(audited, TRAINED)
    assert from_json(Audit, to_json(found), Path("audit.json"), "an audit") == found
    assert audit(audited, TRAINED) == found


def test_a_cycle_has_the_work_of_its_stated_frequency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A damper of -1 N.m.s/rad generates amplitude^2 / (2 f).
    for sample_time, frequency in ((0.005, 0.05), (0.0106, 0.0507), (0.1, 1.0)):
        monkeypatch.setattr(module, "FREQUENCIES", (frequency,))
        found = audit(law(-DQ), replace(TRAINED, sample_time=sample_time)).generating
        assert found is not None
        assert found.frequency == pytest.approx(frequency, rel=0.3)
        assert found.work == pytest.approx(-(1.2**2) / (2.0 * found.frequency))
        assert found.share == pytest.approx(-1.0)


def record(dq: list[float], log: str = "run", dt: float = 0.01) -> FrictionRecord:
    rows = np.array(dq)
    return FrictionRecord(
        log=log,
        joint="j1",
        t=5.0 + dt * np.arange(len(rows)),
        dq=rows,
        q=2.0 * rows,
        tau_load=rows - 1.0,
        tau=10.0 * rows,
    )


def test_ranges_cover_all_records() -> None:
    trained = TrainedRange.from_records(
        [record([-0.5, 0.0, 0.1, 0.2]), record([0.0, 0.7, 0.1], dt=0.02)]
    )
    assert trained.sample_time == 0.01
    assert trained.dq == (-0.5, 0.7)
    assert trained.q == (-1.0, 1.4)
    assert trained.tau_load == pytest.approx((-1.5, -0.3))
    assert trained.tau == (-5.0, 7.0)
    assert trained.speed == 0.7
    assert trained.middle == pytest.approx(0.2)
    assert from_json(TrainedRange, to_json(trained), Path("x.json"), "a range") == trained


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q": (1.0, -1.0)}, "^trained range of 'q' is 1.0 to -1.0"),
        ({"tau": (0.0, np.inf)}, "^trained range of 'tau' is 0.0 to inf"),
        ({"dq": (0.0, 0.0)}, "expected motion and a positive time"),
        ({"sample_time": 0.0}, "expected motion and a positive time"),
    ],
)
def test_invalid_ranges_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ArtifactError, match=message):
        replace(TRAINED, **change)


@pytest.mark.parametrize("wrong", [{}, {"dq": [1.0]}, {"dq": 3}, {"dq": ["a", "b"]}])
def test_invalid_range_data_are_refused(wrong: dict[str, object]) -> None:
    data = to_json(TRAINED) | wrong
    if not wrong:
        del data["tau"]
    said = "key 'dq|range of 'dq' is" if wrong else "key 'tau' is missing"
    with pytest.raises(ArtifactError, match=said):
        from_json(TrainedRange, data, Path("x.json"), "a range")


def test_excess_over_the_trained_range_is_reported_per_input() -> None:
    trained = TrainedRange.from_records([record([-0.5, 0.5])])
    assert find_excess(trained, [record([-0.4, 0.5, -0.5])]) == {}
    wider = replace(trained, q=(-9.0, 9.0))
    found = find_excess(wider, [record([-0.5, 0.6, -0.9, 0.1]), record([0.0] * 4)])
    assert list(found) == ["dq", "tau_load"]
    assert found["dq"].rows == 0.25
    assert (found["dq"].below, found["dq"].above) == pytest.approx((0.4, 0.1))
    upwards = find_excess(wider, [record([0.0, 0.75])])
    assert (upwards["dq"].below, upwards["dq"].above) == (0.0, 0.25)


# --- motions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("sample_time", [0.005, 0.0106, 0.4])
def test_closed_motions_settle_and_pass_each_position_twice(sample_time: float) -> None:
    """At least three seconds of whole half cycles, then one cycle of paired samples."""
    trained = replace(TRAINED, sample_time=sample_time, q=(0.2, 1.0))
    amplitudes = np.array([0.5, 1.2])
    found = module.closed_motions(trained, amplitudes, 0.25)
    half = max(4, round(2.0 / sample_time))
    assert found.rows == 2 * half
    assert found.frequency == pytest.approx(0.5 / (half * sample_time))
    before = found.dq.shape[1] - found.rows
    assert (before % half, before // half) == (0, 2)  # two seconds each
    t = sample_time * (np.arange(found.dq.shape[1]) - before)
    rate = 2.0 * np.pi * found.frequency
    np.testing.assert_allclose(found.dq, amplitudes[:, None] * np.cos(rate * t), atol=1e-12)
    q = 0.6 + amplitudes[:, None] / rate * np.sin(rate * t)
    np.testing.assert_allclose(found.q, q, atol=1e-12)


def test_work_is_power_over_the_settled_cycle() -> None:
    """A damper of 2 N.m.s/rad dissipates amplitude^2 / f, all of it against the motion."""
    motions = module.closed_motions(TRAINED, np.array([0.5, 1.0]), 0.5)
    tau = 2.0 * motions.dq
    tau[:, : -motions.rows] = 1e6  # rows before the cycle do not count
    for one, amplitude in zip(module.measure_cycles(motions, 7.0, tau), (0.5, 1.0), strict=True):
        assert (one.amplitude, one.frequency, one.tau_load) == (amplitude, 0.5, 7.0)
        assert (one.work, one.share) == pytest.approx((amplitude**2 / 0.5, 1.0))
    (still, _) = module.measure_cycles(motions, 7.0, 0.0 * tau)
    assert (still.work, still.share) == (0.0, 0.0)
    (spring, _) = module.measure_cycles(motions, 7.0, motions.q)
    assert (spring.work, spring.share) == (0.0, 0.0)


def test_noise_at_rest_is_encoder_noise() -> None:
    """Three seconds to settle, then 4000 rows; velocity is the backward difference."""
    trained = replace(TRAINED, sample_time=0.01, q=(0.2, 1.0))
    dq, q, settling = module.encoder_noise(trained)
    noise = ENCODER_NOISE * standard_normal(0, 0, np.arange(4301))
    assert settling == 300
    np.testing.assert_allclose(q, 0.6 + noise[1:], rtol=1e-15)
    np.testing.assert_allclose(dq, (noise[1:] - noise[:-1]) / 0.01, rtol=1e-9)
