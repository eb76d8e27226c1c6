"""Laws over a log and step by step: against closed forms, an ODE solver and each other."""

import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.over_log import step_coefficients
from oracles.stepper import Stepper
from scipy.integrate import solve_ivp

from hesr_model.equations.functions import NUMPY, absolute, sgn
from hesr_model.equations.memory import Relaxation
from hesr_model.equations.recurrence import recurrence
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import DQ, TAU_LOAD, Q
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import predict, record_start
from hesr_model.rigid_body.friction_record import FrictionRecord

A, B, C, D = (Coefficient(name=n, unit="1", description=n) for n in "abcd")
a, b, c, d = (k.symbol for k in (A, B, C, D))


def phi(z: np.ndarray) -> np.ndarray:
    return np.asarray(NUMPY["share"](z, np.expm1(-z), False))


def hysteresis(alpha: float, beta: float, **more: object) -> FrictionLaw:
    """Law whose torque is the state of eq. 9 itself."""
    h = Relaxation(name="h", unit="1", drive=a * sympy.tanh(b * DQ), rate=a)
    form = LawForm(coefficients=(A, B), memory=(h,), output=h.state)
    return FrictionLaw(name="h", form=form, values={"a": alpha, "b": beta}, **more)


def with_derivative(law: FrictionLaw) -> FrictionLaw:
    """The same law, with the derivative of its state as torque."""
    (relaxation,) = law.form.relaxations
    form = LawForm(
        coefficients=law.form.coefficients,
        memory=(relaxation,),
        output=relaxation.derivative,
    )
    return FrictionLaw(
        name="dh",
        form=form,
        values=law.values,
        discretisation=law.discretisation,
        start=law.start,
    )


# --- phi --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_phi_is_accurate_to_the_last_digits(sign: float) -> None:
    z = sign * np.concatenate(
        [
            [5e-324, 1e-300, 1e-16, 1e-8, np.nextafter(1e-3, 0.0), 1e-3, np.nextafter(1e-3, 1.0)],
            np.geomspace(1e-12, 30.0, 400),
        ]
    )
    with mpmath.workdps(60):
        exact = [float(-mpmath.expm1(-mpmath.mpf(x)) / mpmath.mpf(x)) for x in z.tolist()]
    np.testing.assert_allclose(phi(z), exact, rtol=5e-16)


def test_limits_of_phi() -> None:
    np.testing.assert_array_equal(phi(np.array([0.0, -0.0])), [1.0, 1.0])
    np.testing.assert_allclose(phi(np.array([1e3, 1e60])), [1e-3, 1e-60], rtol=1e-15)


# --- one step ---------------------------------------------------------------------------------

rates = st.floats(0.0, 1e4)
drives = st.floats(-1e3, 1e3)
periods = st.floats(1e-4, 0.1)


def relaxed(x: float, drive: float, rate: float, dt: float, how: str = "exact") -> float:
    factor, increment = step_coefficients(np.array(drive), np.array(rate), np.array(dt), how)
    return float(factor * x + increment)


@given(st.floats(-10, 10), drives, rates, periods)
def test_the_exact_step_matches_the_closed_form(
    x: float, drive: float, rate: float, dt: float
) -> None:
    with mpmath.workdps(50):
        r, u = mpmath.mpf(rate), mpmath.mpf(drive)
        driven = -u * mpmath.expm1(-r * dt) / r if rate else u * dt
        expected = float(x * mpmath.exp(-r * dt) + driven)
    size = abs(x) + abs(drive) * dt
    assert relaxed(x, drive, rate, dt) == pytest.approx(
        expected, rel=1e-15, abs=1e-15 * size + 1e-300
    )


@given(st.floats(-10, 10), drives, rates, periods, st.integers(2, 50))
def test_splitting_an_exact_step_changes_nothing(
    x: float, drive: float, rate: float, dt: float, parts: int
) -> None:
    whole, split = relaxed(x, drive, rate, dt), x
    for _ in range(parts):
        split = relaxed(split, drive, rate, dt / parts)
    assert split == pytest.approx(whole, rel=1e-13, abs=1e-13 * (abs(x) + abs(drive) * dt) + 1e-300)


@pytest.mark.parametrize(("drive", "rate"), [(3.0, 7.0), (-40.0, 0.0), (0.5, 300.0)])
def test_the_exact_step_solves_the_differential_equation(drive: float, rate: float) -> None:
    solution = solve_ivp(
        lambda _, x: drive - rate * x, (0.0, 0.05), [0.8], method="DOP853", rtol=1e-12, atol=1e-13
    )
    assert relaxed(0.8, drive, rate, 0.05) == pytest.approx(solution.y[0, -1], rel=1e-10)


def test_the_exact_step_is_stable_where_euler_is_not() -> None:
    assert relaxed(5.0, 2e6, 1e6, 0.01) == pytest.approx(2.0, rel=1e-15, abs=0.0)


def test_the_euler_step_is_eq_10() -> None:
    assert relaxed(0.4, 3.0, 20.0, 0.005, "euler") == pytest.approx(
        0.9 * 0.4 + 0.015, rel=1e-15, abs=0.0
    )


@pytest.mark.parametrize(("rate", "found"), [(100.0, "1"), (250.0, "2.5")])
def test_an_unstable_euler_step_is_refused(rate: float, found: str) -> None:
    with pytest.raises(SimulationError) as caught:
        step_coefficients(np.ones(3), np.array([1.0, rate, 2.0]), np.full(3, 0.01), "euler")
    assert f"* step < 1, found {found}" in str(caught.value)


def test_a_negative_rate_counts_as_zero() -> None:
    # A relaxing state does not grow, whatever the inputs: here it would, by e^40.
    x = Relaxation(name="x", unit="1", drive=DQ, rate=-TAU_LOAD)
    law = FrictionLaw(
        name="guarded", form=LawForm(coefficients=(), memory=(x,), output=x.state), values={}
    )
    t = 0.1 * np.arange(5)
    found = predict(law, t=t, dq=np.ones(5), tau_load=np.array([0.0, 400.0, 400.0, -3.0, -3.0]))
    free = [0.0, 0.1, 0.2]
    for _ in range(2):
        free.append(free[-1] * np.exp(-0.3) + (1.0 - np.exp(-0.3)) / 3.0)
    np.testing.assert_allclose(found, free, rtol=1e-15)


# --- a whole log ------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.floats(0, 1), drives), min_size=1, max_size=60), st.floats(-5, 5))
def test_the_recurrence_equals_the_loop(pairs: list[tuple[float, float]], start: float) -> None:
    factors, increments = (np.array(column) for column in zip(*pairs, strict=True))
    x, expected = start, [start]
    for factor, increment in pairs[1:]:
        x = factor * x + increment
        expected.append(x)
    solved = recurrence(factors, increments, start)
    np.testing.assert_allclose(solved, expected, rtol=1e-14, atol=1e-12)


def test_the_recurrence_leaves_its_arguments_alone() -> None:
    factors, increments = np.full(5, 0.5), np.ones(5)
    recurrence(factors, increments, 3.0)
    np.testing.assert_array_equal(factors, 0.5)
    np.testing.assert_array_equal(increments, 1.0)


def test_euler_over_a_log_is_eq_10_by_hand() -> None:
    t = np.array([1.0, 1.005, 1.01, 1.02])
    dq = np.array([0.3, 0.002, -0.001, -0.4])
    law = hysteresis(11.37, 256.84, discretisation="euler")
    target = np.tanh(256.84 * dq)
    h = [0.1]  # no motion yet at the first sample
    h.append((1 - 11.37 * 0.005) * h[0] + 11.37 * 0.005 * target[1])
    h.append((1 - 11.37 * 0.005) * h[1] + 11.37 * 0.005 * target[2])
    h.append((1 - 11.37 * 0.01) * h[2] + 11.37 * 0.01 * target[3])
    np.testing.assert_allclose(predict(law, t=t, dq=dq, start=(0.1,)), h, rtol=1e-13)
    # The derivative is taken at the updated state.
    derivative = 11.37 * (target - np.array(h))
    found = predict(with_derivative(law), t=t, dq=dq, start=(0.1,))
    np.testing.assert_allclose(found, derivative, rtol=1e-13)


def test_an_exact_log_follows_the_differential_equation_of_held_inputs() -> None:
    t = np.array([0.0, 0.004, 0.011, 0.013, 0.03])
    dq = np.array([0.0, 0.01, -0.02, 0.005, 0.4])
    x, expected = 0.0, [0.0]
    for k in range(1, len(t)):
        target = np.tanh(100.0 * dq[k])
        solution = solve_ivp(
            lambda _, h, target=target: 30.0 * (target - h),
            (t[k - 1], t[k]),
            [x],
            method="DOP853",
            rtol=1e-12,
            atol=1e-14,
        )
        x = float(solution.y[0, -1])
        expected.append(x)
    np.testing.assert_allclose(predict(hysteresis(30.0, 100.0), t=t, dq=dq), expected, atol=1e-11)


def test_euler_converges_to_exact() -> None:
    def largest_difference(samples: int) -> float:
        t = np.linspace(0.0, 2.0, samples)
        dq = np.sin(5.0 * t)
        both = [
            predict(hysteresis(20.0, 3.0, discretisation=how), t=t, dq=dq)
            for how in ("exact", "euler")
        ]
        return float(np.abs(both[0] - both[1]).max())

    coarse, fine = largest_difference(1001), largest_difference(4001)
    assert coarse / fine == pytest.approx(4.0, rel=0.05)
    assert fine < 5e-3


def test_the_first_sample_reads_the_start_of_the_states() -> None:
    law = hysteresis(10.0, 50.0, start=(0.25,))
    t, dq = np.array([4.0, 4.01]), np.array([0.0, 0.1])
    assert predict(law, t=t, dq=dq)[0] == 0.25
    assert predict(law, t=t, dq=dq, start=(-0.5,))[0] == -0.5
    derivative = 10.0 * (0.0 - 0.25)
    assert predict(with_derivative(law), t=t, dq=dq)[0] == pytest.approx(
        derivative, rel=1e-15, abs=0.0
    )


def test_missing_inputs_are_zero() -> None:
    form = LawForm(coefficients=(A,), output=a * DQ + TAU_LOAD + sympy.cos(Q))
    law = FrictionLaw(name="u", form=form, values={"a": 2.0})
    t, dq = np.arange(3.0), np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(predict(law, t=t, dq=dq), 2.0 * dq + 1.0)
    given_all = predict(law, t=t, dq=dq, q=[np.pi] * 3, tau_load=[5.0, 6.0, 7.0])
    np.testing.assert_allclose(given_all, 2.0 * dq + [5.0, 6.0, 7.0] - 1.0, rtol=1e-15)


def test_a_law_without_inputs_fills_every_sample() -> None:
    law = FrictionLaw(name="k", form=LawForm(coefficients=(A,), output=a), values={"a": 1.5})
    torque = predict(law, t=[0.0, 0.1, 0.2], dq=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(torque, [1.5, 1.5, 1.5])
    torque[0] = 0.0  # the array belongs to the caller
    assert Stepper(law).step(0.1, 7.0) == 1.5


def test_laws_of_the_same_form_are_independent() -> None:
    t = np.arange(50) * 0.01
    dq = np.sin(t)
    first = predict(hysteresis(10.0, 50.0), t=t, dq=dq)
    predict(hysteresis(90.0, 3.0), t=t, dq=dq)
    np.testing.assert_array_equal(predict(hysteresis(10.0, 50.0), t=t, dq=dq), first)


def test_nothing_is_divided_by_zero_at_rest() -> None:
    z = Relaxation(name="z", unit="rad", drive=DQ, rate=a * absolute(DQ))
    law = FrictionLaw(
        name="z",
        form=LawForm(coefficients=(A,), memory=(z,), output=z.state + z.derivative),
        values={"a": 1e4},
        start=(3e-5,),
    )
    rest = predict(law, t=np.arange(4) * 0.01, dq=np.zeros(4))
    np.testing.assert_array_equal(rest, 3e-5)  # a relaxation with rate zero never forgets


def test_euler_refuses_long_steps() -> None:
    law = hysteresis(11.37, 256.84, discretisation="euler")
    t = np.array([0.0, 0.005, 0.1])
    with pytest.raises(SimulationError, match=r"\* step < 1, found 1\.08"):
        predict(law, t=t, dq=np.zeros(3))


# --- step by step -----------------------------------------------------------------------------


def test_a_stepper_does_not_move_in_a_zero_step() -> None:
    stepper = Stepper(hysteresis(10.0, 50.0), start=(0.25,))
    assert stepper.step(0.0, 0.3) == 0.25
    assert stepper.x == [0.25]
    moved = stepper.step(0.01, 0.3)
    assert moved == pytest.approx(
        0.25 * np.exp(-0.1) - np.expm1(-0.1) * np.tanh(15.0), rel=1e-14, abs=0.0
    )
    assert stepper.step(0.0, 0.3) == moved


def test_steppers_of_one_law_do_not_share_their_states() -> None:
    law = hysteresis(10.0, 50.0)
    one, other = Stepper(law), Stepper(law)
    one.step(0.1, 1.0)
    other.step(0.0, 0.0)
    assert other.x == [0.0]
    assert law.start == (0.0,)


coefficients = st.floats(0.05, 20.0)

RATES = (
    a,
    b * absolute(DQ),
    c * absolute(DQ) / (1.0 + d * sympy.exp(-((DQ / b) ** 2))),
    a * (1 - sympy.exp(-((DQ / c) ** 2))) + d * absolute(DQ),
    a + b * absolute(TAU_LOAD) / 10,
)
DRIVES = (DQ, a * sympy.tanh(b * DQ), c * DQ + d, a * sgn(DQ), b * sympy.sin(Q) * TAU_LOAD)
OUTPUTS = (
    DQ,
    sgn(DQ),
    DQ**3,
    absolute(DQ) * TAU_LOAD,
    sympy.cos(c * Q) ** 2,
    sympy.exp(-((DQ / d) ** 2)),
    sympy.tanh(a * DQ - b),
    sympy.Integer(1),
)


@st.composite
def random_laws(draw: st.DrawFn) -> FrictionLaw:
    chosen = draw(st.lists(st.tuples(st.sampled_from(DRIVES), st.sampled_from(RATES)), max_size=3))
    relaxations = tuple(
        Relaxation(name=f"x{i}", unit="1", drive=drive, rate=rate)
        for i, (drive, rate) in enumerate(chosen)
    )
    terms = draw(st.lists(st.sampled_from(OUTPUTS), min_size=1, max_size=4))
    states = [s for r in relaxations for s in (r.state, r.derivative)]
    inner = sum(states, sympy.Integer(0))
    output = a * sum(terms) + sum(b * s for s in states) + c * sympy.tanh(d * inner)
    values = {k.name: draw(coefficients) for k in (A, B, C, D)}
    return FrictionLaw(
        name="random",
        form=LawForm(coefficients=(A, B, C, D), memory=relaxations, output=output),
        values=values,
        discretisation=draw(st.sampled_from(["exact", "euler"])),
        start=tuple(draw(st.floats(-1, 1)) for _ in relaxations),
    )


@settings(max_examples=60, deadline=None)
@given(random_laws(), st.integers(0, 2**32 - 1))
def test_a_whole_log_equals_the_log_step_by_step(law: FrictionLaw, seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Uneven steps, short enough for Euler at the largest rates, with rests and reversals.
    t = 2.0 + np.cumsum(rng.uniform(1e-5, 4e-4, 120))
    dq = 2.0 * np.sin(rng.uniform(100, 400) * (t - 2.0))
    dq[40:50] = 0.0
    q, load = np.cumsum(dq) * 0.01, rng.normal(size=len(t)) * 5.0
    torque = predict(law, t=t, dq=dq, q=q, tau_load=load)
    stepper = Stepper(law)
    steps = np.diff(t, prepend=t[0])
    stepped = np.array(
        [stepper.step(*row) for row in np.stack([steps, dq, q, load], axis=1).tolist()]
    )
    np.testing.assert_allclose(torque, stepped, rtol=0, atol=1e-12 * np.abs(stepped).max())


def test_division_by_a_zero_coefficient_gives_nan() -> None:
    """As in arrays and in C: the caller checks for values that are not finite."""
    form = LawForm(coefficients=(A, B), output=DQ * b / a)
    law = FrictionLaw(name="odd", form=form, values={"a": 0.0, "b": 2.0})
    with np.errstate(divide="ignore", invalid="ignore"):
        torque = predict(law, t=[0.0, 1.0], dq=[0.0, 3.0])
        assert not np.isfinite(Stepper(law).step(0.1, 3.0))
    assert np.isnan(torque[0])
    assert not np.isfinite(torque[1])


# --- initial state ----------------------------------------------------------------------------


def started(
    start: float, samples: int, **more: object
) -> tuple[FrictionLaw, dict[str, np.ndarray]]:
    """A law whose torque is its state, and a log of it with a non-zero initial state."""
    law = hysteresis(3.0, 5.0, start_samples=samples)
    t = 0.01 * np.arange(50)
    dq = 2.0 + np.sin(9.0 * t)
    tau = predict(law, t=t, dq=dq, start=(start,))
    return law, {"t": t, "dq": dq, "q": 0.0 * t, "tau_load": 0.0 * t, "tau": tau}


def record(**log: np.ndarray) -> FrictionRecord:
    return FrictionRecord(log="made", joint="j1", **log)


@pytest.mark.parametrize("start", [-0.95, -0.31, 0.0, 0.62, 0.99])
def test_the_start_is_estimated_from_the_first_torques(start: float) -> None:
    law, log = started(start, 5)
    assert record_start(law, record(**log))[0] == pytest.approx(start, abs=1e-4)


def test_only_the_first_samples_count() -> None:
    law, log = started(0.4, 5)
    log["tau"][5:] += 7.0
    assert record_start(law, record(**log))[0] == pytest.approx(0.4, abs=1e-4)
    log["tau"][4] += 7.0
    assert record_start(law, record(**log))[0] > 0.9


def test_a_start_is_a_reachable_state() -> None:
    """|h| <= tanh(5 * 3) bounds the search, whatever the torque."""
    law, log = started(2.5, 5)
    assert record_start(law, record(**log))[0] == pytest.approx(1.0, abs=1e-3)
    log["dq"] = 0.1 * np.sin(9.0 * log["t"])
    assert record_start(law, record(**log))[0] == pytest.approx(np.tanh(0.5), abs=1e-3)


def test_laws_without_estimation_keep_their_start() -> None:
    law, log = started(0.4, 0)
    assert record_start(law, record(**log)) == law.start == (0.0,)
    law, log = started(0.4, 5)
    log["dq"] *= 0.0  # nothing drives the state, so its reach is zero
    assert record_start(law, record(**log)) == (0.0,)
