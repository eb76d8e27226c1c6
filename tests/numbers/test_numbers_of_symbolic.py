"""The stages of the symbolic search: intermediate steps of each."""

from dataclasses import replace

import numpy as np
import pytest
from unchanged import Unchanged

from hesr_model.fitting.joint_rows import JointRows
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.laws.parfam import calibrate, evolve, refine
from hesr_model.laws.parfam.calibrate import Cell
from hesr_model.laws.parfam.candidate import UNIT_FUNCTIONS, Candidate
from hesr_model.laws.parfam.features import HysteresisFeatures
from hesr_model.rigid_body.friction_record import FrictionRecord

CELL = Cell(alpha=12.0, beta=25.0, cost=0.0)


@pytest.fixture(params=["exact", "euler"])
def features(request: pytest.FixtureRequest, exact: HysteresisFeatures) -> HysteresisFeatures:
    return replace(exact, discretisation=request.param)


def candidate(g: str | None = "tanh") -> Candidate:
    return Candidate(
        g=g, alpha=9.0, beta=18.0, c=np.array([0.4, 2.0, 6.0, 0.1]),
        theta=np.array([0.1, 0.8, -1.4, 0.05]), gain=-3.0 if g else 0.0,
        c_active=np.ones(4, bool), theta_active=np.full(4, g is not None), cost=1.0,
    )  # fmt: skip


# --- stage 1 ----------------------------------------------------------------------------------


def test_the_first_stage(features: HysteresisFeatures, unchanged: Unchanged) -> None:
    cells = calibrate.compute_profile(features)
    chosen = calibrate.select_distinct(cells, 12)
    courses = calibrate._extract_courses(features)
    unchanged(
        {
            "bounds": calibrate.bounds(features),
            "cells": np.array([[c.alpha, c.beta, c.cost] for c in cells]).T.tolist(),
            "chosen": np.array([[c.alpha, c.beta, c.cost] for c in chosen]).T.tolist(),
            "guess": calibrate.estimate_from_loop(features),
            "lengths": [len(course) for course, _ in courses],
            "sums": [float(course.sum()) for course, _ in courses],
            "slopes": [slope or 0.0 for _, slope in courses],
            "rate": calibrate._settling_rate(features, [course for course, _ in courses]),
            "cubic": calibrate._cubic_features(features.columns(12.0, 25.0))[7:-1:97],
        }
    )


def test_slow_loops_and_loops_in_fast_samples(unchanged: Unchanged) -> None:
    """Reversals more rows apart than are examined, and reversals that hardly settle."""
    found = {}
    for name, rate, step in (("slow", 0.6, 0.005), ("fast", 9.0, 0.004)):
        t = step * np.arange(4000)
        dq = np.cos(rate * t) + 0.2 * np.cos(0.31 * rate * t)
        flat = np.zeros_like(t)
        record = FrictionRecord(log="one", joint="j1", t=t, dq=dq, q=flat, tau_load=flat, tau=flat)
        features = HysteresisFeatures(
            rows=JointRows.from_records([record], coefficients=3), discretisation="exact"
        )
        h = features.columns(4.0, 30.0)[:, 2]
        record = replace(record, tau=7.0 * h + 0.5 * dq + 0.3)
        features = replace(features, rows=JointRows.from_records([record], coefficients=3))
        courses = calibrate._extract_courses(features)
        found[name] = {
            "guess": calibrate.estimate_from_loop(features),
            "lengths": [len(course) for course, _ in courses],
            "slopes": [slope or 0.0 for _, slope in courses],
        }
    unchanged(found)


def test_cells_whose_neighbours_are_better_come_last() -> None:
    """Each of the eight neighbours hides a cell, and no other cell does."""
    for better in set(range(25)) - {12}:
        costs = np.full(25, 10.0) + 0.01 * np.arange(25)
        costs[12], costs[better] = 5.0, 4.0
        far = 24 * (better < 12)  # a corner that does not touch the better one
        costs[far] = 6.0
        cells = [
            Cell(alpha=2.0 ** (k // 5), beta=2.0 ** (k % 5), cost=float(costs[k]))
            for k in range(25)
        ]
        near = max(abs(better // 5 - 2), abs(better % 5 - 2)) == 1
        order = [c.cost for c in calibrate.select_distinct(sorted(cells, key=lambda c: c.cost), 25)]
        assert order[0] == 4.0
        assert (order.index(5.0) < order.index(6.0)) == (not near), better


# --- stage 2 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("g", list(UNIT_FUNCTIONS))
def test_the_second_stage(g: str, exact: HysteresisFeatures, unchanged: Unchanged) -> None:
    rows = slice(None, None, 2)
    x, tau = exact.columns(CELL.alpha, CELL.beta)[rows], exact.rows.tau[rows]
    starts = evolve.starting_points(np.random.default_rng(3), 6, 4)
    problem = evolve._ProjectedProblem(g, x / [1.0, *x[:, 1:].std(axis=0)], x, tau, 2.0)
    theta = np.random.default_rng(6).uniform(-0.4, 0.4, (4, 6))
    gram, gradient = problem._normal_equations(theta)
    # An offset inside exp acts as a gain, so round-off alone decides the step length there.
    step = problem._step(theta, np.geomspace(1e-3, 1e2, 6))[1 if g == "exp" else 0 :]
    unchanged(
        {
            "starts": starts,
            "cost": problem.cost(theta),
            "gram": gram.reshape(6, -1).tolist(),
            "gradient": gradient,
            "step": step,
            "linear": evolve.fit_linear(CELL, x, tau),
        },
        atol=1e-6,
    )


def test_selection_in_the_search_of_a_unit(
    exact: HysteresisFeatures, monkeypatch: pytest.MonkeyPatch, unchanged: Unchanged
) -> None:
    """Recorded: the costs of all starts after each round, which select the survivors."""
    x, tau = exact.columns(CELL.alpha, CELL.beta)[::3], exact.rows.tau[::3]
    starts = evolve.starting_points(np.random.default_rng(3), 8, 4)
    found = {"rounds": np.array(evolve.ROUNDS).ravel(), "limits": [evolve.ARGUMENT_LIMIT]}
    for rounds in (((1, 1.0),), ((2, 0.5),), ((2, 0.5), (2, 0.4)), ((4, 0.3),)):
        monkeypatch.setattr(evolve, "ROUNDS", rounds)
        for limit in (0.7, 12.0):
            problem = evolve._ProjectedProblem(
                "tanh", x / [1.0, *x[:, 1:].std(axis=0)], x, tau, limit
            )
            theta, cost = problem.minimise(starts.T.copy())
            found[f"{rounds} {limit}"] = {"theta": theta, "cost": cost}
            kept = evolve.search_arguments("tanh", x, x, tau, starts, 2, limit)
            found[f"{rounds} {limit}"]["kept"] = np.array(kept)
        found[f"{rounds}"] = evolve.search(CELL, "sin", x, tau, starts, 3)
    unchanged(found, rtol=1e-5)


@pytest.mark.parametrize("g", ["tanh", "exp"])
def test_the_search_of_the_paper(
    g: str, exact: HysteresisFeatures, monkeypatch: pytest.MonkeyPatch, unchanged: Unchanged
) -> None:
    x, tau = exact.columns(CELL.alpha, CELL.beta)[::4], exact.rows.tau[::4]
    monkeypatch.setattr(evolve, "HOPS", 1)
    found = evolve.search_of_paper(CELL, g, x, tau, np.random.default_rng(4))
    point = np.random.default_rng(5).normal(size=9)
    objective = evolve.Objective(g, x, tau, evolve.GAMMA, np.arange(9) != 3)
    unchanged(
        {"found": found, "objective": objective(point)},
        rtol=1e-3,
        atol=1e-5,
    )


# --- stage 3 ----------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [None, "tanh", "sin", "exp"])
def test_the_third_stage(
    g: str | None,
    features: HysteresisFeatures,
    monkeypatch: pytest.MonkeyPatch,
    unchanged: Unchanged,
) -> None:
    start = candidate(g)
    if g == "exp":  # its offset is in the gain
        start = replace(start, theta=start.theta * [0, 1, 1, 1], theta_active=np.arange(4) > 0)
    problem = refine.Refinement(features, start)
    point = problem.pack()
    first = problem.run(4)
    slopes, residual = problem.slopes(point)
    folds = features.rows.folds
    found = {
        "point": point,
        "residual": residual.copy(),
        "jacobian": slopes[3::89].tolist(),
        "first": first,
        "statistics": refine.Refinement(features, first).statistics(),
        "still": refine._find_acceptable_cost(features, first),
        "canonical": first.to_canonical(),
        "less": [refine._remove_coefficient(first, k) for k in (2, 5, 8)],
    }
    monkeypatch.setattr(refine, "FOLD_EVALUATIONS", 3)
    found["left out"] = refine.left_out_cost(features, start, folds)
    unchanged(found, rtol=1e-5)


def test_effort_of_the_third_stage() -> None:
    """The extent of refinement matters only if time is short."""
    assert refine.ROUNDS == ((8, 10), (16, 4))
    assert (refine.FIRST_EVALUATIONS, refine.PRUNED_EVALUATIONS, refine.FOLD_EVALUATIONS) == (
        60,
        12,
        8,
    )
    assert (refine.SIGNIFICANCE, refine.HOPEFUL_RATIO, refine.TIE_TOLERANCE) == (2.0, 1.1, 1e-6)
    assert (evolve.GAMMA, evolve.HOPS, evolve.STEP, evolve.TRUNCATION) == (1e-3, 10, 1.0, 0.02)
    assert evolve.ROWS == 600


def test_candidates_are_pruned_and_chosen(
    exact: HysteresisFeatures,
    records: list[FrictionRecord],
    monkeypatch: pytest.MonkeyPatch,
    unchanged: Unchanged,
) -> None:
    evaluations: list[int] = []
    run = refine.Refinement.run

    def counted(self: refine.Refinement, most: int) -> object:
        evaluations.append(most)
        return run(self, most)

    monkeypatch.setattr(refine.Refinement, "run", counted)
    pruned = refine.prune(exact, candidate("sin"))
    before = list(evaluations)
    evaluations.clear()
    # From alpha = 9, refinements after pruning end before they converge, at costs that differ by
    # 30 % between BLAS kernels: no tie.
    found = [
        candidate(None),
        replace(candidate("tanh"), alpha=10.0),
        replace(candidate("sin"), alpha=30.0),
    ]
    folds, trained = exact.rows.folds, TrainedRange.from_records(records)
    chosen = refine.select(exact, found, folds, trained)
    unchanged(
        {
            "pruned": {"c": pruned.c_active, "theta": pruned.theta_active, "cost": pruned.cost},
            "evaluations": before,
            "chosen": {"c": chosen.c_active, "theta": chosen.theta_active, "cost": chosen.cost},
            "of those": evaluations[:7],  # round-off decides the later path
            "kinds": sorted(set(evaluations)),
        },
        rtol=1e-3,
    )
