"""ParFam-H: derivatives against finite differences, and the guarantees of each stage."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from containing import Containing
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_limits

from hesr_model.errors import ArtifactError, FitError, HesrError
from hesr_model.fitting.fit import fit_joint, fit_models
from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.inputs import MOVING
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate, evolve, family, refine
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import UNIT_FUNCTIONS, Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.laws.parfam.laws import ParFamH
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.support.files import models_folder

ALPHA, BETA = 12.0, 25.0
QUICK = {"cells": 2, "starts": 4, "candidates": 2, "functions": ("tanh",)}


def motion(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Uneven time stamps and a velocity that reverses and rests."""
    rng = np.random.default_rng(seed)
    t = 10.0 * seed + np.cumsum(rng.uniform(0.004, 0.016, rows))
    dq = np.sin(1.7 * t) * (0.7 + 0.4 * np.sin(0.31 * t))
    dq[rows // 2 : rows // 2 + 20] = 0.0
    return t, dq


def record(rows: int = 600, seed: int = 0, noise: float = 0.05, log: str = "run") -> FrictionRecord:
    """Torque of a ParFam law of known structure: eq. 9 and 11 in a loop."""
    t, dq = motion(rows, seed)
    moving = min(abs(dq[0]) / MOVING, 1.0)  # h begins in the steady state of a motion, as laws do
    target, states = np.tanh(BETA * dq), []
    h = moving**2 * (3.0 - 2.0 * moving) * target[0]
    for k in range(rows):
        if k:
            h = target[k] + (h - target[k]) * np.exp(-ALPHA * (t[k] - t[k - 1]))
        states.append(h)
    x = np.stack([np.ones(rows), dq, states, ALPHA * (target - states)], axis=1)
    tau = x @ [0.4, 2.0, 6.0, 0.1] + 5.0 * np.tanh(x @ [0.1, 0.8, -1.4, 0.05])
    tau += noise * np.random.default_rng(seed + 100).normal(size=rows)
    zero = np.zeros(rows)
    return FrictionRecord(log=log, joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=tau)


def features_of(*records: FrictionRecord, how: str = "exact") -> HysteresisFeatures:
    return HysteresisFeatures(
        rows=JointRows.from_records(records, coefficients=3), discretisation=how
    )


@pytest.fixture(scope="module", params=["exact", "euler"])
def features(request: pytest.FixtureRequest) -> HysteresisFeatures:
    """Return three records with uneven steps."""
    records = [record(rows, k, log=f"run {k}") for k, rows in enumerate((200, 60, 150))]
    return features_of(*records, how=request.param)


def candidate(g: str | None = "tanh", **more: object) -> Candidate:
    everything = {
        "g": g,
        "alpha": ALPHA,
        "beta": BETA,
        "c": np.array([0.4, 2.0, 6.0, 0.1]),
        "theta": np.array([0.1, 0.8, -1.4, 0.05]) if g else np.zeros(4),
        "gain": 5.0 if g else 0.0,
        "c_active": np.ones(4, bool),
        "theta_active": np.full(4, g is not None),
        "cost": 1.0,
    }
    return Candidate(**(everything | more))


# --- features ---------------------------------------------------------------------------------


def test_features_match_the_law_on_every_record(features: HysteresisFeatures) -> None:
    structure = {"linear": ["h"], "units": []}
    values = {"c_h": 1.0, "alpha": ALPHA, "beta": BETA}
    x = features.columns(ALPHA, BETA)
    np.testing.assert_array_equal(x[:, 0], 1.0)
    np.testing.assert_array_equal(x[:, 1], features.rows.dq)
    law = Candidate.law(
        candidate(None, c=np.array([0, 0, 1.0, 0]), c_active=np.array([0, 0, 1, 0], bool)),
        "parfam_h",
        features.discretisation,
    )
    assert (law.structure, dict(law.values)) == (structure, values)
    for k in range(3):
        rows = features.rows.log_index == k
        t = np.cumsum(features.rows.dt[rows])
        h = predict(law, t=t, dq=features.rows.dq[rows])
        np.testing.assert_allclose(x[rows, 2], h, atol=1e-13)
    derivative = ALPHA * (np.tanh(BETA * features.rows.dq) - x[:, 2])
    np.testing.assert_allclose(x[:, 3], derivative, atol=1e-11)


@pytest.mark.parametrize(("alpha", "beta"), [(1.5, 3.0), (ALPHA, BETA), (50.0, 400.0)])
def test_derivatives_of_the_state_agree_with_differences(
    features: HysteresisFeatures, alpha: float, beta: float
) -> None:
    run = features.slopes(None)
    by_h, by_dh = np.zeros(11), np.zeros(11)  # laws tau = h and tau = dh
    by_h[[0, 1, 4]] = by_dh[[0, 1, 5]] = alpha, beta, 1.0
    dh, ddh = (run.evaluate(numbers)[:, :2].copy() for numbers in (by_h, by_dh))
    np.testing.assert_allclose(run.results[:, 2:6], features.columns(alpha, beta), atol=1e-11)
    for i, (by_alpha, by_beta) in enumerate([(1e-5 * alpha, 0.0), (0.0, 1e-5 * beta)]):
        above = features.columns(alpha + by_alpha, beta + by_beta)
        below = features.columns(alpha - by_alpha, beta - by_beta)
        difference = (above - below) / (2.0 * (by_alpha + by_beta))
        for found, expected in ((dh[:, i], difference[:, 2]), (ddh[:, i], difference[:, 3])):
            scale = np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * scale)


def test_alpha_is_limited_so_that_euler_is_stable_at_the_longest_step() -> None:
    data = record(200, 0)
    steps = np.diff(data.t)
    assert features_of(data, how="euler").alpha_limit == pytest.approx(1.0 / steps.max())
    assert features_of(data).alpha_limit == pytest.approx(1.0 / np.median(steps))


# --- candidates -------------------------------------------------------------------------------


@pytest.mark.parametrize("g", list(UNIT_FUNCTIONS))
def test_slopes_of_units_agree_with_differences(g: str) -> None:
    function, slope = UNIT_FUNCTIONS[g]
    x = np.linspace(-3.0, 3.0, 61)
    difference = (function(x + 1e-6) - function(x - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope(x, function(x)), difference, atol=1e-8)


def test_units_cover_all_that_a_structure_may_name() -> None:
    assert set(UNIT_FUNCTIONS) == set(family.FUNCTIONS)


numbers = st.floats(-20, 20, allow_subnormal=False)


@given(
    st.sampled_from([None, *UNIT_FUNCTIONS]),
    st.lists(numbers, min_size=9, max_size=9),
    st.booleans(),
)
def test_the_canonical_form_is_an_equal_law(
    g: str | None, values: list[float], offset: bool
) -> None:
    active = np.array([offset, True, True, True]) & (g is not None)
    before = candidate(
        g,
        c=np.array(values[:4]),
        gain=values[4] if g else 0.0,
        theta=np.where(active, np.array(values[5:]) / 4.0, 0.0),
        theta_active=active,
    )
    after = before.to_canonical()
    x = np.column_stack([np.ones(50), np.random.default_rng(0).uniform(-1, 1, (50, 3))])
    np.testing.assert_allclose(
        after.torque(x), before.torque(x), rtol=1e-10, atol=1e-9 * (1.0 + abs(before.gain))
    )
    # The written law has active coefficients only, so the others must be zero.
    assert np.all(after.theta[~after.theta_active] == 0.0)
    if g in ("tanh", "sin") or (g == "cos" and offset):
        assert after.gain >= 0.0
    if g in ("sin", "cos") and offset:
        assert -np.pi < after.theta[0] <= np.pi
    again = after.to_canonical()
    np.testing.assert_allclose(again.theta, after.theta, atol=1e-14)
    assert again.gain == after.gain


@pytest.mark.parametrize("g", [None, *UNIT_FUNCTIONS])
@pytest.mark.parametrize("offset", [True, False])
def test_the_law_gives_the_torque_of_its_candidate(g: str | None, offset: bool) -> None:
    features = features_of(record(200, 0))
    chosen = candidate(g, theta_active=np.array([offset, True, True, False]) & (g is not None))
    theta = np.where(chosen.theta_active, chosen.theta, 0.0)
    chosen = replace(
        chosen, theta=theta, gain=-chosen.gain, c=chosen.c * [1, 0, 1, 1]
    ).to_canonical()  # fmt: skip
    chosen = replace(chosen, c_active=np.array([True, False, True, True]))
    law = chosen.law("parfam_h", "exact")
    assert law.structure["linear"] == ["1", "h", "dh"]
    samples = features.rows
    torque = predict(law, t=np.cumsum(samples.dt), dq=samples.dq)
    np.testing.assert_allclose(
        torque, chosen.torque(features.columns(chosen.alpha, chosen.beta)), atol=1e-11
    )


# --- stage 1 ----------------------------------------------------------------------------------


def test_the_profile_is_best_near_the_generating_parameters() -> None:
    cells = calibrate.compute_profile(features_of(record(1500, 0, noise=0.0)))
    costs = [cell.cost for cell in cells]
    assert costs == sorted(costs)
    assert len(cells) == np.prod(calibrate.GRID)
    for name, truth in (("alpha", ALPHA), ("beta", BETA)):
        grid = sorted({round(np.log(getattr(cell, name)), 9) for cell in cells})
        assert abs(np.log(getattr(cells[0], name) / truth)) < grid[1] - grid[0]


def test_local_minima_of_the_profile_come_first() -> None:
    grid = [
        Cell(alpha=float(a), beta=float(b), cost=cost)
        for (a, b), cost in zip(
            [(a, b) for a in (1, 2, 4, 8) for b in (1, 2, 4)],
            [9.0, 8.0, 9.0, 7.0, 1.0, 7.5, 9.0, 8.2, 9.0, 5.0, 9.5, 9.1],
            strict=True,
        )
    ]
    chosen = calibrate.select_distinct(sorted(grid, key=lambda cell: cell.cost), 3)
    assert [cell.cost for cell in chosen] == [1.0, 5.0, 7.0]


def test_the_geometric_guess_reads_alpha_from_a_loop_of_h() -> None:
    """At a steep reversal, friction changes sign after the half-life of h."""
    data = record(3000, 0)
    h = features_of(data).columns(4.0, 300.0)[:, 2]
    features = features_of(FrictionRecord(**(vars(data) | {"tau": 7.0 * h})))
    alpha, _ = calibrate.estimate_from_loop(features)
    assert alpha == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("scale", [0.0, 1e-6, 1.0, 1e6])
def test_the_geometric_guess_lies_within_the_bounds(scale: float) -> None:
    data = record(600, 0)
    tau = scale * np.random.default_rng(0).normal(size=600)
    features = features_of(FrictionRecord(**(vars(data) | {"tau": tau})))
    (low, high), (beta_low, beta_high) = calibrate.bounds(features)
    alpha, beta = calibrate.estimate_from_loop(features)
    assert low <= alpha < high
    assert beta_low <= beta <= beta_high


# --- stage 2 ----------------------------------------------------------------------------------


def test_projection_finds_the_generating_argument() -> None:
    data = record(1500, 0, noise=0.0)
    x = features_of(data).columns(ALPHA, BETA)
    cell = Cell(alpha=ALPHA, beta=BETA, cost=np.nan)
    starts = np.random.default_rng(0).normal(size=(32, 4))
    found = evolve.search(cell, "tanh", x, data.tau, starts, keep=3)
    costs = [k.cost for k in found]
    assert costs == pytest.approx(sorted(costs), abs=1e-24)  # the difference is round-off only
    assert len(found) <= 3
    best = found[0].to_canonical()
    assert np.sqrt(best.cost) < 1e-3
    np.testing.assert_allclose(best.torque(x), data.tau, atol=5e-3)
    for k in found:
        assert k.cost == pytest.approx(np.mean((k.torque(x) - data.tau) ** 2), abs=1e-12)
        assert k.cost <= evolve.fit_linear(cell, x, data.tau).cost


def test_a_law_without_a_unit_is_the_least_squares_fit() -> None:
    data = record(300, 0)
    x = features_of(data).columns(ALPHA, BETA)
    found = evolve.fit_linear(Cell(alpha=ALPHA, beta=BETA, cost=np.nan), x, data.tau)
    np.testing.assert_allclose(found.c, np.linalg.lstsq(x, data.tau)[0], rtol=1e-8)
    assert found.g is None
    np.testing.assert_allclose(x.T @ (found.torque(x) - data.tau), 0.0, atol=1e-8)


@pytest.mark.parametrize("g", list(UNIT_FUNCTIONS))
@pytest.mark.parametrize("gamma", [0.0, 1e-2])
def test_the_gradient_of_eq_12_agrees_with_differences(g: str, gamma: float) -> None:
    rng = np.random.default_rng(1)
    x = np.column_stack([np.ones(200), rng.normal(size=(200, 3))])
    y = rng.normal(size=200)
    for seed in range(3):
        active = np.random.default_rng(seed).random(9) < (1.0 if seed == 0 else 0.6)
        objective = evolve.Objective(g, x, y, gamma, active)
        point = 0.5 * np.random.default_rng(seed).normal(size=9)
        _, gradient = objective(point)
        step = 1e-6 * np.eye(9)
        differences = [(objective(point + d)[0] - objective(point - d)[0]) / 2e-6 for d in step]
        np.testing.assert_allclose(
            gradient, differences, rtol=1e-6, atol=1e-7 * np.abs(gradient).max()
        )
        assert np.all(gradient[~active] == 0.0)


def test_eq_12_is_mean_square_plus_weighted_sizes() -> None:
    x = np.column_stack([np.ones(3), [0.5, -1.0, 2.0], [1.0, 0.0, -1.0], [0.1, 0.2, 0.3]])
    y = np.array([1.0, -2.0, 0.5])
    point = np.array([0.3, -0.2, 0.5, 1.0, 2.0, 0.1, -0.4, 0.2, 0.7])
    residual = x @ point[:4] + 2.0 * np.tanh(x @ point[5:]) - y
    expected = np.mean(residual**2) + 0.01 * np.sum(np.abs(point))
    objective = evolve.Objective("tanh", x, y, 0.01, np.ones(9, bool))
    assert objective(point)[0] == pytest.approx(expected, rel=1e-14, abs=0.0)


def test_the_papers_search_truncates_small_coefficients() -> None:
    data = record(800, 0, noise=0.0)
    x = features_of(data).columns(ALPHA, BETA)
    cell = Cell(alpha=ALPHA, beta=BETA, cost=np.nan)
    with threadpool_limits(1):
        found = evolve.search_of_paper(cell, "tanh", x, data.tau, np.random.default_rng(0))
    assert np.all(found.c[~found.c_active] == 0.0)
    assert np.all(found.theta[~found.theta_active] == 0.0)
    assert found.cost == pytest.approx(np.mean((found.torque(x) - data.tau) ** 2))
    assert found.cost < 0.02 * np.var(data.tau)


# --- stage 3 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [None, *UNIT_FUNCTIONS])
@pytest.mark.parametrize("partly", [False, True])
def test_the_jacobian_agrees_with_differences(
    features: HysteresisFeatures, g: str | None, partly: bool
) -> None:
    active = {}
    if partly:
        active["c_active"] = np.array([True, False, True, False])
        if g:
            active["theta_active"] = np.array([False, True, True, False])
    start = candidate(g, **active)
    start = replace(start, c=start.c * start.c_active, theta=start.theta * start.theta_active)
    rows = features.rows.log_index != 1
    problem = refine.Refinement(features, start, rows)
    point = problem.pack()
    jacobian, _ = problem.slopes(point)
    assert jacobian.shape == (rows.sum(), len(point))
    step = 1e-6
    for i in range(len(point)):
        shift = np.zeros(len(point))
        shift[i] = step
        above, below = (problem.slopes(point + k * shift)[1].copy() for k in (1.0, -1.0))
        difference = (above - below) / (2.0 * step)
        scale = max(np.abs(difference).max(), 1e-3)
        np.testing.assert_allclose(jacobian[:, i], difference, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("g", [None, "tanh", "exp"])
def test_packing_keeps_the_candidate(features: HysteresisFeatures, g: str | None) -> None:
    start = candidate(g)
    problem = refine.Refinement(features, start)
    found = problem.unpack(problem.pack())
    for name in ("alpha", "beta", "gain"):
        assert getattr(found, name) == pytest.approx(getattr(start, name), rel=1e-10)
    np.testing.assert_allclose(found.c, start.c, rtol=1e-12)
    np.testing.assert_allclose(found.theta, start.theta, rtol=1e-12)


def test_euler_is_stable_at_every_point_of_the_search(features: HysteresisFeatures) -> None:
    problem = refine.Refinement(features, candidate())
    for far in (-800.0, -5.0, 5.0, 800.0):
        point = problem.pack()
        point[:2] = far
        found = problem.unpack(point)
        (low, high), (beta_low, beta_high) = calibrate.bounds(features)
        assert low * (1 - 1e-9) <= found.alpha <= high * (1 + 1e-9)
        assert beta_low * (1 - 1e-9) <= found.beta <= beta_high * (1 + 1e-9)


def test_refinement_finds_the_generating_coefficients() -> None:
    features = features_of(record(2000, 0, noise=0.0))
    start = candidate(alpha=9.0, beta=18.0, gain=3.0, c=np.array([0.0, 1.0, 4.0, 0.0]))
    found = refine.Refinement(features, start).run(100)
    truth = candidate()
    assert np.sqrt(found.cost) < 1e-9
    assert found.alpha == pytest.approx(ALPHA, rel=1e-6)
    assert found.beta == pytest.approx(BETA, rel=1e-6)
    np.testing.assert_allclose(found.c, truth.c, rtol=1e-4)
    np.testing.assert_allclose(found.theta, truth.theta, rtol=1e-4)
    assert found.gain == pytest.approx(5.0, rel=1e-4)
    assert refine.Refinement(features, found).statistics().shape == (11,)


def test_a_truly_zero_coefficient_is_pruned() -> None:
    """The argument has no dh, and the law no linear term in dq."""
    data = record(3000, 0, noise=0.0)
    features = features_of(data)
    x = features.columns(ALPHA, BETA)
    truth = candidate(c=np.array([0.4, 0.0, 6.0, 0.1]), theta=np.array([0.0, 0.8, -1.4, 0.0]))
    noise = np.random.default_rng(7).normal(size=len(data.t))
    noisy = FrictionRecord(**(vars(data) | {"tau": truth.torque(x) + 0.2 * noise}))
    found = refine.prune(features_of(noisy), candidate())
    np.testing.assert_array_equal(found.c_active, [True, False, True, True])
    np.testing.assert_array_equal(found.theta_active, [False, True, True, False])
    assert found.c[1] == 0.0
    assert np.all(found.theta[[0, 3]] == 0.0)
    structure = found.law("parfam_h", "exact").structure
    assert structure == {
        "linear": ["1", "h", "dh"],
        "units": [{"g": "tanh", "arguments": ["dq", "h"]}],
    }


@pytest.mark.parametrize("g", ["tanh", "cos"])
def test_pruning_does_not_spoil_a_fit(g: str) -> None:
    """A law far from the data: its coefficients are uncertain but still needed."""
    law = FrictionModel.read(models_folder() / "uf850" / "table1.json").laws[0]
    t = 0.005 * np.arange(4000)
    dq = 1.2 * np.sin(0.5 * np.pi * t)
    zero = np.zeros_like(t)
    data = FrictionRecord(
        log="sine", joint="j1", t=t, dq=dq, q=zero, tau_load=zero, tau=predict(law, t=t, dq=dq)
    )
    features = features_of(data, how="euler")
    cell = Cell(alpha=138.6, beta=165.7, cost=np.nan)
    columns = features.columns(cell.alpha, cell.beta)
    with threadpool_limits(1):
        start = evolve.search_of_paper(cell, g, columns, data.tau, np.random.default_rng(0))
    whole = refine.Refinement(features, start).run(refine.FIRST_EVALUATIONS)
    assert refine.prune(features, start).cost < 1.5 * whole.cost


def test_supported_coefficients_are_not_pruned() -> None:
    features = features_of(record(3000, 0, noise=0.05))
    found = refine.prune(features, candidate())
    assert found.c_active[[1, 2, 3]].all()
    assert found.theta_active[[1, 2]].all()


def test_equal_candidates_are_merged() -> None:
    costs = [2.0, 1.0, 1.0 + 1e-9, 2.0 - 1e-9, 3.0]
    kept = refine.select_distinct([candidate(cost=cost) for cost in costs])
    assert [k.cost for k in kept] == [1.0, 2.0 - 1e-9, 3.0]


def test_a_candidate_that_explodes_beyond_the_trained_speeds_is_not_chosen() -> None:
    """An exponential fits these data best and is harmless within the trained range."""
    data = record(600, 0)
    noise = 0.2 * np.random.default_rng(1).normal(size=600)
    rises = 1e-3 * np.exp(9.0 * data.dq) + noise
    explosive = candidate(
        "exp", gain=1e-3, theta=np.array([0.0, 9.0, 0.0, 0.0]), c=np.zeros(4)
    )  # fmt: skip
    spoiled = FrictionRecord(**(vars(data) | {"tau": rises}))
    features = features_of(spoiled)
    folds, trained = features.rows.folds, TrainedRange.from_records([spoiled])
    assert refine.select(features, [explosive, candidate(None)], folds, trained).g is None
    with pytest.raises(FitError) as caught:
        refine.select(features, [explosive], folds, trained)
    assert "every ParFam candidate explodes just outside" in str(caught.value)


def test_the_best_predictor_of_left_out_rows_is_chosen() -> None:
    records = [record(600, 0), record(600, 1, log="two")]
    features = features_of(*records)
    folds = features.rows.folds
    found = [candidate(), candidate(None)]
    chosen = refine.select(features, found, folds, TrainedRange.from_records(records))
    assert chosen.g == "tanh"
    costs = [refine.left_out_cost(features, k, folds) for k in found]
    assert costs[0] < costs[1]
    # An honest out-of-sample error is not below the in-sample one.
    assert costs[0] >= refine.Refinement(features, candidate()).run(60).cost


# --- the estimator ----------------------------------------------------------------------------


def test_a_function_outside_the_family_is_refused() -> None:
    with pytest.raises(FitError) as caught:
        ParFamH(functions=("tanh", "tan"))
    assert str(caught.value) == ("ParFam function 'tan' is unknown; known are tanh, sin, cos, exp.")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (
            {"search": "papr"},
            "ParFam option 'search' is 'papr'; allowed are projection, paper.",
        ),
        (
            {"discretisation": "rk4"},
            "ParFam option 'discretisation' is 'rk4'; allowed are exact, euler.",
        ),
        ({"cells": 0}, "ParFam option 'cells' is 0; expected"),
        ({"starts": 0}, "ParFam option 'starts' is 0; expected"),
        ({"candidates": 0}, "ParFam option 'candidates' is 0; expected"),
        ({"units": 3}, "ParFam option 'units' is 3; allowed are 1, 2."),
        (
            {"search": "paper", "functions": ()},
            "ParFam option 'functions' is empty",
        ),
    ],
)
def test_meaningless_options_are_refused(options: dict[str, object], sentence: str) -> None:
    with pytest.raises(FitError) as caught:
        ParFamH(**options)
    assert str(caught.value) == Containing(sentence)


def test_a_state_outside_the_family_is_refused() -> None:
    with pytest.raises(ArtifactError) as caught:
        ParFamH.form({"linear": ["dq"], "units": [], "state": "odd"})
    known = ", ".join(family.STATES)
    assert str(caught.value) == f"ParFam state 'odd' is unknown; known are {known}."


def test_an_unknown_option_is_refused_by_name() -> None:
    with pytest.raises(FitError, match=r"^law 'parfam_h' does not take these options .*'serach'"):
        fit_joint("parfam_h", [record()], seed=0, options={"serach": "paper"})


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (lambda r: FrictionRecord(**(vars(r) | {"dq": np.abs(r.dq)})), "'j1' never reverses"),
        (
            lambda r: FrictionRecord(
                **{n: v[:10] if isinstance(v, np.ndarray) else v for n, v in vars(r).items()}
            ),
            "'j1': 10 rows for 11 coefficients",
        ),
    ],
)
def test_data_that_do_not_determine_the_law_are_refused(
    data: Callable[[FrictionRecord], FrictionRecord], sentence: str
) -> None:
    with pytest.raises(HesrError, match=sentence):
        fit_joint("parfam_h", [data(record())], seed=0, options=QUICK)


@pytest.mark.parametrize("how", ["exact", "euler"])
@pytest.mark.parametrize("search", ["projection", "paper"])
def test_a_fitted_law_is_in_the_family_and_close(how: str, search: str) -> None:
    data = record(1200, 0, noise=0.05)
    law = fit_joint(
        "parfam_h", [data], seed=0, options=QUICK | {"discretisation": how, "search": search}
    )
    assert law.discretisation == how
    assert family.form(law.structure) == law.form
    error = predict(law, t=data.t, dq=data.dq) - data.tau
    assert np.sqrt(np.mean(error**2)) < 0.15 * np.std(data.tau)


def test_the_same_seed_gives_the_same_law_bit_for_bit() -> None:
    data = [record(600, 0), record(600, 1, log="two")]
    one, again = (fit_joint("parfam_h", data, seed=3, options=QUICK) for _ in range(2))
    assert one == again
    assert list(one.values.values()) == list(again.values.values())


def test_the_result_does_not_depend_on_the_number_of_processes() -> None:
    joints = [[record(500, k)] for k in range(2)]
    settings = {"parfam_h": QUICK}
    alone, shared = (
        fit_models(
            ["parfam_h", "stribeck"], joints, robot="bench", seed=5, options=settings, workers=w
        )
        for w in (1, 2)
    )
    assert alone == shared
    assert list(alone) == ["parfam_h", "stribeck"]
    assert alone["stribeck"].joints == ("j1", "j1")
    periods = np.concatenate([np.diff(r.t) for (r,) in joints])
    assert alone["parfam_h"].sample_time == pytest.approx(np.median(periods), rel=0.05)


def test_progress_is_reported_once_per_fit() -> None:
    told: list[tuple[int, int]] = []
    fit_models(
        ["stribeck"],
        [[record(200, k)] for k in range(3)],
        robot="bench",
        seed=0,
        workers=1,
        progress=lambda done, total: told.append((done, total)),
    )
    done = [of for of, _ in told]
    assert {total for _, total in told} == {300}  # a hundred parts each
    assert (done[0], done[-1]) == (0, 300)
    assert done == sorted(done)


# --- structures -------------------------------------------------------------------------------


def test_a_structure_becomes_the_form_of_eq_11() -> None:
    structure = {
        "linear": ["dh", "1"],
        "units": [
            {"g": "sin", "arguments": ["h"]},
            {"g": "exp", "arguments": ["1", "dq"]},
        ],
    }
    form = family.form(structure)
    names = [c.name for c in form.coefficients]
    assert names == [
        *("c_dh", "c_0", "c_g1", "theta1_h", "c_g2", "theta2_0", "theta2_dq", "alpha", "beta")
    ]
    units = {c.name: c.unit for c in form.coefficients}
    assert units["c_dh"] == "N.m.s"
    assert units["theta2_dq"] == "s/rad"
    assert units["alpha"] == "1/s"


def test_a_structure_without_the_state_has_none() -> None:
    form = family.form({"linear": ["1", "dq"], "units": [{"g": "tanh", "arguments": ["dq"]}]})
    assert form.relaxations == ()
    assert "alpha" not in {c.name for c in form.coefficients}


@pytest.mark.parametrize(
    "structure",
    [
        {},
        {"linear": []},
        {"linear": [], "units": [], "more": 1},
        {"linear": ["v"], "units": []},
        {"linear": [], "units": [{"g": "tan", "arguments": ["h"]}]},
        {"linear": [], "units": [{"g": "sin", "arguments": []}]},
        {"linear": [], "units": [{"g": "sin"}]},
        {"linear": [], "units": [{"g": "sin", "arguments": ["q"]}]},
        {"linear": ["h", "h"], "units": []},
        {"linear": [], "units": [{"g": "sin", "arguments": ["h", "h"]}]},
    ],
)
def test_a_structure_outside_the_family_is_refused(structure: dict[str, object]) -> None:
    with pytest.raises(ArtifactError):
        family.form(structure)
