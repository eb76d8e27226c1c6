"""ParFam-H against closed forms: readings of a loop, bounds and significance."""

from dataclasses import replace

import numpy as np
import pytest

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.inference.covariance import correlation_length
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.laws.parfam import calibrate, evolve, refine, trial
from hesr_model.laws.parfam.candidate import UNIT_FUNCTIONS, Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.stribeck import VELOCITY_BOUNDS
from hesr_model.rigid_body.friction_record import FrictionRecord

ALPHA, BETA = 12.0, 25.0


def features_of(t: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> HysteresisFeatures:
    zero = np.zeros_like(t)
    record = FrictionRecord(log="run", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)
    return HysteresisFeatures(
        rows=JointRows.from_records([record], coefficients=3), discretisation="exact"
    )


def linear(c: list[float]) -> Candidate:
    return Candidate(
        g=None,
        alpha=ALPHA,
        beta=BETA,
        c=np.array(c),
        theta=np.zeros(4),
        gain=0.0,
        c_active=np.ones(4, bool),
        theta_active=np.zeros(4, bool),
        cost=np.nan,
    )


# --- stage 1 ----------------------------------------------------------------------------------


def test_the_bounds_follow_from_memory_sample_time_and_speed() -> None:
    t = 0.01 * np.arange(1000)
    alpha, beta = calibrate.bounds(features_of(t, 2.0 * np.sin(2.0 * np.pi * t), t))
    speed = 2.0 / np.sqrt(2.0)
    assert alpha == pytest.approx((1.0, 100.0))
    assert beta == pytest.approx((1.0 / speed, 2000.0 / speed))


@pytest.mark.parametrize("beta", [10.0, 25.0])
def test_the_geometric_guess_reads_beta_from_the_slope_at_rest(beta: float) -> None:
    """tau = level tanh(beta dq) has the slope level beta at rest; an offset has no effect."""
    t = 1e-3 * np.arange(8000)
    dq = np.sin(np.pi * (t / 2.0 + 0.00025))  # equally long forwards and backwards
    _, found = calibrate.estimate_from_loop(features_of(t, dq, 1.5 + 7.0 * np.tanh(beta * dq)))
    assert found == pytest.approx(beta, rel=0.01)


def test_the_geometric_guess_reads_alpha_from_the_width_of_a_loop() -> None:
    """After a reversal h decays as exp(-alpha t): the ratio of its height to its area is alpha."""
    t = 1e-3 * np.arange(20000)
    dq = np.sign(np.sin(np.pi * t / 2.0 + 1e-9))
    h = np.zeros_like(t)
    for k in range(1, len(t)):
        h[k] = dq[k] + (h[k - 1] - dq[k]) * np.exp(-60.0 * 1e-3)
    alpha, _ = calibrate.estimate_from_loop(features_of(t, dq, 3.0 * h))
    assert alpha == pytest.approx(60.0, rel=0.04)


def monomials(x: np.ndarray) -> np.ndarray:
    """Terms of degree three or less."""
    powers = [(i, j, k) for i in range(4) for j in range(4 - i) for k in range(4 - i - j)]
    return np.stack([x[:, 0] ** i * x[:, 1] ** j * x[:, 2] ** k for i, j, k in powers], axis=1)


def scales(features: HysteresisFeatures, alpha: float, beta: float) -> np.ndarray:
    return np.std(features.columns(alpha, beta)[:, 1:], axis=0)


def test_the_profile_is_the_residual_of_cubic_surfaces_over_a_grid() -> None:
    """Ten by ten cells between the bounds, without the last one of alpha."""
    t = 0.01 * np.arange(400)
    dq = np.sin(2.0 * t) + 0.3 * np.sin(5.0 * t)
    tau = np.tanh(40.0 * dq) + dq**3 + 0.1 * np.random.default_rng(0).normal(size=len(t))
    features = features_of(t, dq, tau)
    (alpha_low, alpha_high), (beta_low, beta_high) = calibrate.bounds(features)
    found = {(cell.alpha, cell.beta): cell.cost for cell in calibrate.compute_profile(features)}
    alphas = alpha_low * (alpha_high / alpha_low) ** (np.arange(10) / 10)
    betas = beta_low * (beta_high / beta_low) ** (np.arange(10) / 9)
    np.testing.assert_allclose(sorted({a for a, _ in found}), alphas)
    np.testing.assert_allclose(sorted({b for _, b in found}), betas)
    every = {
        cell: monomials(features.columns(*cell)[:, 1:] / scales(features, *cell))
        for cell in list(found)[::9]
    }
    sound = {cell: columns for cell, columns in every.items() if np.linalg.cond(columns) < 1e5}
    assert len(sound) > 3
    for (alpha, beta), columns in sound.items():
        left = tau - columns @ np.linalg.lstsq(columns, tau)[0]
        assert found[alpha, beta] == pytest.approx(left @ left, rel=1e-6)


def test_courses_end_at_a_reversal_the_record_end_or_200_rows() -> None:
    """Three reversals without the last row before each; torque opposes the motion at first.

    The slope is taken over the first row after friction has changed its sign.
    """
    signs = np.repeat([1.0, -1.0, 1.0, -1.0], [300, 250, 40, 30])
    since = np.concatenate([np.arange(n) for n in (300, 250, 40, 30)])
    dq, tau = signs * (1.0 + 0.1 * since), signs * (2.0 * since - 3.0)
    tau -= np.median(tau)
    courses = calibrate._extract_courses(features_of(0.01 * np.arange(620), dq, tau))
    assert [len(course) for course, _ in courses] == [200, 39, 29]
    for (course, slope), start in zip(courses, (300, 550, 590), strict=True):
        rows = slice(start, start + len(course))
        np.testing.assert_allclose(course, np.sign(dq[start]) * tau[rows], atol=1e-12)
        i = start + int(np.argmax(course >= 0.0))
        assert slope == pytest.approx(abs((tau[i] - tau[i - 1]) / (dq[i] - dq[i - 1])))


# --- stage 2 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("g", ["tanh", "sin", "cos", "exp"])
def test_projection_gives_the_least_squares_cost_and_gradient(g: str) -> None:
    """Kaufman's Jacobian is approximate, but its product with the residual is the gradient."""
    rng = np.random.default_rng(0)
    x = np.column_stack([np.ones(80), rng.normal(size=(80, 3))])
    tau = rng.normal(size=80)
    problem = evolve._ProjectedProblem(g, x, x, tau, 12.0)
    theta = 0.5 * rng.normal(size=(4, 3))
    for k, cost in enumerate(problem.cost(theta)):
        columns = np.column_stack([x, UNIT_FUNCTIONS[g][0](x @ theta[:, k])])
        left = tau - columns @ np.linalg.lstsq(columns, tau)[0]
        assert cost == pytest.approx(np.mean(left**2), rel=1e-9)
    gram, gradient = problem._normal_equations(theta)
    for i in range(4):
        step = 1e-5 * np.eye(4)[:, [i]]
        slope = (problem.cost(theta + step) - problem.cost(theta - step)) / 2e-5
        np.testing.assert_allclose(-2.0 / 80 * gradient[:, i], slope, rtol=1e-5, atol=1e-9)
    # J is the part of gain g'(x theta) x outside the linear columns and g itself.
    for k in range(3):
        value = UNIT_FUNCTIONS[g][0](x @ theta[:, k])
        columns = np.column_stack([x, value])
        gain = np.linalg.lstsq(columns, tau)[0][4]
        slopes = gain * UNIT_FUNCTIONS[g][1](x @ theta[:, k], value)[:, None] * x
        jacobian = slopes - columns @ np.linalg.lstsq(columns, slopes)[0]
        np.testing.assert_allclose(gram[k], jacobian.T @ jacobian, atol=1e-9)


def test_starts_are_normal_with_sizes_from_0_3_to_2() -> None:
    starts = evolve.starting_points(np.random.default_rng(0), 20000, 3)
    assert starts.shape == (20000, 3)
    sizes = np.sqrt(np.mean(starts**2))
    assert sizes == pytest.approx(np.sqrt((2.0**3 - 0.3**3) / (3.0 * 1.7)), rel=0.02)
    assert np.all(np.abs(starts.mean(axis=0)) < 0.03)


# --- structures -------------------------------------------------------------------------------


def test_bounds_of_a_structure_follow_from_its_rows() -> None:
    t = 0.01 * np.arange(1000)
    dq = 2.0 * np.sin(2.0 * np.pi * t)
    samples = features_of(t, dq, t).rows
    speed, fastest = np.sqrt(2.0), np.abs(dq).max()
    unit = {"g": "tanh", "arguments": ["1", "dq", "h", "dh"]}
    found = trial.search_space(
        {"linear": ["1", "h", "h_bump"], "units": [unit], "state": "generalised",
         "denominator": ["dq", "h"]}, samples,
    )  # fmt: skip
    expected = {
        "alpha": (1.0, 100.0), "beta": (1.0 / speed, 2000.0 / speed), "kappa": (0.05, 2000.0),
        "v_s": (0.02, VELOCITY_BOUNDS[1]), "theta1_0": (-12.0, 12.0),
        "theta1_dq": (-12.0 / speed, 12.0 / speed), "theta1_h": (-12.0, 12.0),
        "theta1_dh": (-12.0, 12.0), "d_dq": (-0.45 / fastest, 0.45 / fastest),
        "d_h": (-0.45, 0.45),
    }  # fmt: skip
    assert [name for name, _ in found.bounds] == list(expected)
    for name, limits in found.bounds:
        assert limits == pytest.approx(expected[name], rel=1e-9), name
    assert found.linear == ("c_0", "c_h", "c_h_bump", "c_g1")
    assert [(name, float(value)) for name, value in found.values] == [("v_0", 1e-3)]
    bristle = trial.search_space(
        {"linear": ["h", "h_bump"], "units": [], "state": "bristle"}, samples
    )
    assert bristle.bounds == (
        ("rho", STATIC_RATIO_BOUNDS),
        ("v_s", VELOCITY_BOUNDS),
        ("kappa", (0.05, 2000.0)),
    )


# --- stage 3 ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("statistic", "stays"), [(1.8, False), (2.2, True)])
def test_a_coefficient_is_kept_from_two_standard_errors(statistic: float, stays: bool) -> None:
    """An offset of the given number of standard errors, by a residual constructed for it.

    In a linear problem its square equals the cost of dropping it: both criteria agree.
    """
    t = 0.01 * np.arange(2000)
    dq = np.sin(1.7 * t) * (0.7 + 0.4 * np.sin(0.31 * t))
    features = features_of(t, dq, t)
    truth = linear([0.0, 2.0, 6.0, 0.3])
    problem = refine.Refinement(features, truth)
    slopes, _ = problem.slopes(problem.pack())
    residual = 0.1 * np.random.default_rng(1).normal(size=len(t))
    residual -= slopes @ np.linalg.lstsq(slopes, residual)[0]
    variance = residual @ residual / (len(t) - 6) * correlation_length(residual)
    error = np.sqrt(variance * np.linalg.inv(slopes.T @ slopes)[2, 2])
    start = replace(truth, c=np.array([statistic * error, 2.0, 6.0, 0.3]))
    tau = start.torque(features.columns(ALPHA, BETA)) + residual
    features = features_of(t, dq, tau)
    found = refine.Refinement(features, start).run(refine.FIRST_EVALUATIONS)
    statistics = refine.Refinement(features, found).statistics()
    assert statistics[2] == pytest.approx(statistic, rel=1e-3)
    np.testing.assert_array_equal(refine.prune(features, start).c_active, [stays, 1, 1, 1])


def test_candidates_with_costs_within_a_millionth_are_merged() -> None:
    costs = [1.0 + 2.1e-6, 1.0, 1.0 + 0.9e-6, 3.0]
    found = refine.select_distinct([replace(linear([0.0] * 4), cost=cost) for cost in costs])
    assert [k.cost for k in found] == [1.0, 1.0 + 2.1e-6, 3.0]


def test_the_simplest_of_tied_candidates_is_kept() -> None:
    large, small = linear([0.0] * 4), replace(linear([0.0] * 4), c_active=np.eye(4, dtype=bool)[2])
    found = refine.select_distinct([replace(large, cost=1.0), replace(small, cost=1.0 + 0.9e-6)])
    assert [k.c_active.sum() for k in found] == [1]
    found = refine.select_distinct([replace(large, cost=1.0 + 0.9e-6), replace(small, cost=1.0)])
    assert [k.c_active.sum() for k in found] == [1]


def test_the_left_out_error_is_that_of_a_converged_refinement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    t = 0.01 * np.arange(900)
    dq = np.sin(2.0 * t) + 0.4 * np.sin(5.1 * t)
    truth = linear([0.2, 1.0, 3.0, 0.1])
    clean = features_of(t, dq, np.zeros(900))
    noise = 0.3 * np.random.default_rng(0).normal(size=900)
    features = features_of(t, dq, truth.torque(clean.columns(ALPHA, BETA)) + noise)
    folds = features.rows.folds
    start = replace(truth, alpha=3.0 * ALPHA, beta=0.3 * BETA)
    settled = refine.left_out_cost(features, start, folds, portions=refine.PORTIONS)
    monkeypatch.setattr(refine, "FOLD_EVALUATIONS", 3)
    assert refine.left_out_cost(features, start, folds) != pytest.approx(settled, rel=1e-3)
    found = refine.left_out_cost(features, start, folds, portions=refine.PORTIONS)
    assert found == pytest.approx(settled, rel=1e-4)


def test_the_left_out_cost_is_averaged_over_all_rows() -> None:
    """For a linear law at undetermined (alpha, beta), these are the least-squares coefficients."""
    t = 0.01 * np.arange(600)
    dq = np.sin(2.0 * t)
    tau = 2.0 * dq + 0.5 + 0.1 * np.random.default_rng(3).normal(size=len(t))
    features = features_of(t, dq, tau)
    start = replace(linear([0.5, 2.0, 0.0, 0.0]), c_active=np.array([True, True, False, False]))
    folds = features.rows.folds
    columns = np.column_stack([np.ones(600), dq])
    total = 0.0
    for fold in folds:
        c = np.linalg.lstsq(columns[~fold], tau[~fold])[0]
        total += np.sum((tau - columns @ c)[fold] ** 2)
    assert refine.left_out_cost(features, start, folds) == pytest.approx(total / 600, rel=1e-6)
