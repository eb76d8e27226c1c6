"""Laws linear in most coefficients: columns, points, non-negativity and left-out rows."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import sympy
from joint_data import along, law, path, training
from scipy.optimize import lsq_linear

from hesr.extras.laws.strain_wave import StrainWave
from hesr_model.equations.memory import Relaxation
from hesr_model.fitting.declarative import OneForm
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.fitting.separable import MIN_COEFFICIENT, SearchSpace, Separable, left_out_cost
from hesr_model.friction.inputs import DQ, TAU_LOAD
from hesr_model.friction.law import Coefficient, FrictionLaw, LawForm
from hesr_model.friction.predict import predict
from hesr_model.laws.dahl import DahlBasisLoad
from hesr_model.laws.lugre import LuGre, LuGreLoad
from hesr_model.laws.stribeck import Stribeck

LAWS: Mapping[str, tuple[type[OneForm], Mapping[str, float]]] = {
    "stribeck": (Stribeck, {"v_s": 0.1}),
    "lugre": (LuGre, {"deflection": 3e-3, "ratio": 1.4, "v_s": 0.1}),
    "lugre_load": (LuGreLoad, {"deflection": 3e-3, "ratio": 1.7, "v_s": 0.2}),
    "dahl_load": (DahlBasisLoad, {}),
    "strain_wave": (StrainWave, {"x_0": 2e-3}),
}

LUGRE = {"sigma_0": 3000.0, "sigma_1": 20.0, "sigma_2": 6.0, "F_c": 9.0, "F_s": 12.0, "v_s": 0.1,
         "tau_0": 0.4}  # fmt: skip


def samples_of(truth: FrictionLaw, noise: float = 0.0) -> JointRows:
    return JointRows.from_records(training(truth, noise=noise), coefficients=3)


@pytest.fixture(scope="module")
def samples() -> JointRows:
    """Two records, with rests and uneven steps."""
    return samples_of(law("lugre", {}, **LUGRE), noise=0.1)


def problem_of(name: str, samples: JointRows) -> tuple[Separable, np.ndarray]:
    entry, numbers = LAWS[name]
    problem = Separable(entry.core({}), entry().space(), samples)
    return problem, problem.point(numbers)


def torque(problem: Separable, values: Mapping[str, float]) -> np.ndarray:
    """Torque from the law itself, record by record."""
    s = problem.rows
    made = FrictionLaw(name="made", form=problem.form, values=values)
    parts = []
    for k in range(int(s.log_index[-1]) + 1):
        rows = s.log_index == k
        parts.append(
            predict(
                made,
                t=np.cumsum(s.dt[rows]),
                dq=s.dq[rows],
                q=s.q[rows],
                tau_load=s.tau_load[rows],
            )
        )
    return np.concatenate(parts)


# --- columns ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_columns_are_derivatives_of_the_torque(name: str, samples: JointRows) -> None:
    """Differences are exact, because the torque is linear in the unknowns."""
    problem, point = problem_of(name, samples)
    unknowns = 1.0 + np.random.default_rng(1).random(len(problem.space.linear))
    columns = problem.columns(point)
    before = torque(problem, problem.values(point, unknowns))
    np.testing.assert_allclose(columns @ unknowns, before, rtol=0, atol=1e-10 * np.ptp(before))
    for i, name_of in enumerate(problem.space.linear):
        more = unknowns + np.eye(len(unknowns))[i]
        difference = torque(problem, problem.values(point, more)) - before
        scale = 1e-9 * max(np.ptp(before), np.ptp(difference))
        np.testing.assert_allclose(columns[:, i], difference, rtol=0, atol=scale, err_msg=name_of)


def test_columns_follow_the_discretisation(samples: JointRows) -> None:
    problem, _ = problem_of("strain_wave", samples)
    euler = Separable(problem.form, problem.space, samples, "euler")
    point = problem.point({"x_0": 0.1})
    rows = samples.log_index == 0
    values = problem.values(point, np.ones(5))
    expected = predict(
        FrictionLaw(name="made", form=problem.form, values=values, discretisation="euler"),
        t=np.cumsum(samples.dt[rows]),
        dq=samples.dq[rows],
        tau_load=samples.tau_load[rows],
    )
    found = (euler.columns(point) @ np.ones(5))[rows]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.ptp(expected))
    assert np.abs(found - (problem.columns(point) @ np.ones(5))[rows]).max() > 1e-3


def coefficient(name: str) -> Coefficient:
    return Coefficient(name=name, unit="1", description="made for a test")


@pytest.mark.parametrize(
    ("output", "said"),
    [
        (sympy.Symbol("a", real=True) ** 2 * DQ, "'a'"),
        (sympy.exp(sympy.Symbol("a", real=True) * DQ), "'a'"),
        (sympy.Symbol("a", real=True) * sympy.Symbol("b", real=True) * DQ, "'a', 'b'"),
        (sympy.Symbol("a", real=True) * DQ + TAU_LOAD, "an offset"),
    ],
)
def test_a_nonlinear_form_is_refused(output: sympy.Expr, said: str, samples: JointRows) -> None:
    form = LawForm(coefficients=(coefficient("a"), coefficient("b")), output=output)
    with pytest.raises(ValueError, match="not linear in") as caught:
        Separable(form, SearchSpace(bounds=(), linear=("a", "b")), samples)
    assert said in str(caught.value)


def test_an_unknown_inside_a_state_is_refused(samples: JointRows) -> None:
    a = coefficient("a")
    state = Relaxation(name="x", unit="1", drive=a.symbol * DQ, rate=sympy.Integer(3))
    form = LawForm(coefficients=(a,), memory=(state,), output=a.symbol * state.state)
    with pytest.raises(ValueError, match="not linear in"):
        Separable(form, SearchSpace(bounds=(), linear=("a",)), samples)


# --- points -----------------------------------------------------------------------------------


def linear_and_logarithmic(samples: JointRows) -> Separable:
    names = ("positive", "either", "gain")
    p, e, c = (coefficient(n) for n in names)
    form = LawForm(
        coefficients=(p, e, c),
        output=c.symbol * sympy.tanh(p.symbol * DQ + e.symbol),
    )
    bounds = (("positive", (1e-3, 1e3)), ("either", (-2.0, 5.0)))
    return Separable(form, SearchSpace(bounds=bounds, linear=("gain",)), samples)


def test_values_survive_the_conversion_to_a_point_and_back(samples: JointRows) -> None:
    problem = linear_and_logarithmic(samples)
    for positive, either in ((0.02, -1.5), (1.0, 0.0), (700.0, 4.9)):
        point = problem.point({"either": either, "positive": positive, "unused": 1.0})
        np.testing.assert_allclose(problem.numbers(point), [positive, either], rtol=1e-12)
        assert point[0] == pytest.approx(np.log(positive))


def test_values_outside_the_bounds_are_moved_inside(samples: JointRows) -> None:
    problem = linear_and_logarithmic(samples)
    for positive, either in ((1e-9, -7.0), (1e9, 7.0)):
        point = problem.point({"positive": positive, "either": either})
        low, high = problem.bounds.T
        assert np.all(point > low)
        assert np.all(point < high)
        nearest = np.clip([positive, either], [1e-3, -2.0], [1e3, 5.0])
        np.testing.assert_allclose(problem.numbers(point), nearest, rtol=1e-6)


def test_values_hold_every_coefficient_and_follow_their_expressions(samples: JointRows) -> None:
    problem, point = problem_of("lugre_load", samples)
    values = problem.values(point, np.array([8.0, 20.0, 6.0, 0.4, 0.16]))
    assert list(values) == [c.name for c in problem.form.coefficients]
    assert values["sigma_0"] == pytest.approx(8.0 / 3e-3)
    assert values["F_s"] == pytest.approx(1.7 * 8.0)
    assert values["mu"] == pytest.approx(0.02)


# --- solving ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LAWS)
def test_polish_lowers_the_cost_within_the_bounds(name: str, samples: JointRows) -> None:
    problem, point = problem_of(name, samples)
    polished = problem.polish(point)
    low, high = problem.bounds.T
    assert np.all((polished >= low) & (polished <= high))
    before, after = problem.solve(point)[1], problem.solve(polished)[1]
    if len(problem.bounds):
        assert after < before * (1.0 - 1e-6)
    else:
        assert after == before


def test_polish_finds_the_generating_values() -> None:
    clean = samples_of(law("lugre", {}, **LUGRE))
    problem, point = problem_of("lugre", clean)
    found = problem.polish(point, evaluations=60)
    values = problem.values(found, problem.solve(found)[0])
    for name, value in LUGRE.items():
        assert values[name] == pytest.approx(value, rel=1e-3), name


def test_polish_uses_its_rows_only(samples: JointRows) -> None:
    problem, point = problem_of("lugre", samples)
    rows = samples.log_index == 0
    spoilt = replace(samples, tau=np.where(rows, samples.tau, 1e3 * samples.dq**2))
    other, _ = problem_of("lugre", spoilt)
    np.testing.assert_array_equal(
        problem.polish(point, is_used=rows), other.polish(point, is_used=rows)
    )
    assert np.any(problem.polish(point) != other.polish(point))


def test_a_flat_direction_does_not_decide_the_minimum() -> None:
    """At F_s = F_c, v_s has no effect; with the smallest v_s, F_s hardly has one."""
    truth = law("lugre", {}, **LUGRE | {"F_c": 11.0, "v_s": 0.5})
    problem, _ = problem_of("lugre", samples_of(truth, noise=0.1))
    flat = problem.point({"deflection": 3.7e-3, "ratio": 1.0, "v_s": problem.space.bounds[2][1][0]})
    held, settled = problem.polish(flat, evaluations=40), problem.polish_from_corners(flat)
    assert problem.name_numbers(held)["v_s"] == pytest.approx(
        problem.space.bounds[2][1][0], rel=1e-6
    )
    assert problem.solve(settled)[1] < 0.9 * problem.solve(held)[1]
    assert problem.name_numbers(settled)["v_s"] == pytest.approx(0.5, rel=0.1)


def test_the_search_finds_the_basin_for_every_seed() -> None:
    clean = samples_of(law("lugre", {}, **LUGRE), noise=0.3)
    problem, _ = problem_of("lugre", clean)
    costs = []
    for seed in range(3):
        point = problem.polish(problem.search(np.random.default_rng(seed)))
        costs.append(problem.solve(point)[1])
    assert max(costs) < 1.01 * min(costs)
    assert np.sqrt(min(costs) / len(clean.tau)) == pytest.approx(0.3, rel=0.05)


def test_a_law_without_searched_values_is_solved_directly(samples: JointRows) -> None:
    problem, point = problem_of("dahl_load", samples)
    assert point.shape == (0,)
    assert problem.search(np.random.default_rng(0)).shape == (0,)
    unknowns, cost = problem.solve(point)
    columns, least = problem.columns(point), np.full(len(unknowns), -np.inf)
    least[: problem.space.non_negative] = 0.0
    best = lsq_linear(columns, samples.tau, (least, np.inf), method="bvls")
    np.testing.assert_allclose(columns @ (unknowns - best.x), 0.0, atol=1e-6)
    assert cost == pytest.approx(2.0 * best.cost, rel=1e-9)


def test_the_first_unknowns_are_not_negative(samples: JointRows) -> None:
    """Friction that drives: the forces become zero; the offset may be negative."""
    driving = replace(samples, tau=-5.0 * np.tanh(50.0 * samples.dq) - 2.0 * samples.dq - 0.7)
    problem, point = problem_of("lugre", driving)
    unknowns, cost = problem.solve(point)
    assert np.all(unknowns[: problem.space.non_negative] >= 0.0)
    assert unknowns[problem.space.linear.index("tau_0")] < 0.0
    residual = driving.tau - problem.columns(point) @ unknowns
    assert cost == pytest.approx(float(residual @ residual), rel=1e-9)
    # Other terms are divided by F_c, so it gets its least value instead of zero, and the law runs.
    values = problem.values(point, unknowns)
    assert values["F_c"] == MIN_COEFFICIENT
    assert np.all(np.isfinite(torque(problem, values)))


# --- left-out rows ----------------------------------------------------------------------------


@pytest.mark.parametrize("logs", [1, 2, 3])
def test_left_out_cost_equals_individual_refits(logs: int) -> None:
    truth = law("lugre", {}, **LUGRE)
    records = [
        along(truth, path(k, seconds=4.0 + k), noise=0.5, seed=k, log=str(k)) for k in range(logs)
    ]
    samples = JointRows.from_records(records, coefficients=3)
    problem, point = problem_of("strain_wave", samples)
    columns, tau = problem.columns(point), samples.tau
    folds = samples.folds
    assert len(folds) == (4 if logs == 1 else logs)
    squares = []
    for fold in folds:
        x = np.linalg.lstsq(columns[~fold], tau[~fold])[0]
        squares.append((tau[fold] - columns[fold] @ x) ** 2)
    expected = float(np.mean(np.concatenate(squares)))
    assert left_out_cost(columns, tau, folds) == pytest.approx(expected, rel=1e-8)
    assert expected > problem.solve(point)[1] / len(tau)


def test_a_useless_column_costs_on_left_out_rows(samples: JointRows) -> None:
    problem, point = problem_of("lugre", samples)
    columns = problem.columns(point)
    useless = np.random.default_rng(0).normal(size=(len(columns), 40))
    plain = left_out_cost(columns, samples.tau, samples.folds)
    assert left_out_cost(np.hstack([columns, useless]), samples.tau, samples.folds) > plain
