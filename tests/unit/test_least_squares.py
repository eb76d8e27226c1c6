from dataclasses import replace

import numpy as np
import pytest

from hesr_model.rigid_body.least_squares import Block, Solution, estimate_covariance, solve

TRUTH = np.array([2.0, -1.0, 0.5])
SCALE = np.array([1.0, 10.0, 0.1])


def blocks(*noises: float, rows: int = 400, seed: int = 0) -> list[Block]:
    rng = np.random.default_rng(seed)
    out = []
    for noise in noises:
        matrix = rng.standard_normal((rows, 3)) * SCALE
        out.append(Block(matrix=matrix, target=matrix @ TRUTH + noise * rng.standard_normal(rows)))
    return out


@pytest.mark.parametrize("weighted", [True, False])
def test_without_noise_the_solution_is_exact(weighted: bool) -> None:
    solution = solve(blocks(0.0, 0.0), scale=SCALE, weighted=weighted)
    np.testing.assert_allclose(solution.x, TRUTH, atol=1e-12)
    np.testing.assert_allclose(solution.rmse, 0.0, atol=1e-12)
    assert solution.ridge == 0.0


def test_weights_favour_the_quiet_block() -> None:
    errors = {True: [], False: []}
    for seed in range(20):
        for weighted, found in errors.items():
            solution = solve(blocks(3.0, 0.03, seed=seed), scale=SCALE, weighted=weighted)
            found.append(np.abs(solution.x - TRUTH))
    assert np.all(np.mean(errors[True], axis=0) < 0.1 * np.mean(errors[False], axis=0))


def test_residuals_are_computed_per_block() -> None:
    solution = solve(blocks(1.0, 0.1), scale=SCALE, weighted=True)
    np.testing.assert_allclose(solution.rmse, [1.0, 0.1], rtol=0.1)


def stated(given: list[Block], solution: Solution) -> np.ndarray:
    """Standard errors with each row from a sample of its own."""
    ends = np.cumsum([0, *(len(block.target) for block in given)])
    own = [
        replace(block, samples=np.arange(start, start + len(block.target)))
        for start, block in zip(ends, given, strict=False)
    ]
    labels = np.arange(ends[-1]) % 3
    return estimate_covariance(own, solution, labels).standard_errors


def test_standard_errors_match_the_scatter_of_repetitions() -> None:
    found, claimed = [], []
    for seed in range(200):
        given = blocks(1.0, 0.3, rows=200, seed=seed)
        solution = solve(given, scale=SCALE, weighted=True)
        found.append(solution.x)
        claimed.append(stated(given, solution))
    np.testing.assert_allclose(np.mean(claimed, axis=0), np.std(found, axis=0), rtol=0.15)


def test_rows_of_one_sample_share_their_error() -> None:
    """A repeated block adds no information: its errors must not shrink by sqrt(2)."""
    (one,) = blocks(1.0, rows=200)
    once = replace(one, samples=np.arange(200))
    labels = np.zeros(200, dtype=int)
    errors = []
    for given in ([once], [once, once]):
        solution = solve(given, scale=SCALE, weighted=False)
        errors.append(estimate_covariance(given, solution, labels).standard_errors)
    # The only difference: each of two rows has half of the leverage.
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.03)


def test_undetermined_unknowns_are_pulled_to_zero_and_reported() -> None:
    (block,) = blocks(0.1)
    twice = np.column_stack([block.matrix, block.matrix[:, 0]])
    solution = solve(
        [Block(matrix=twice, target=block.target)], scale=np.append(SCALE, 1.0), weighted=False
    )
    assert solution.ridge > 0
    assert np.isfinite(solution.condition)
    assert solution.condition > 1e12
    np.testing.assert_allclose(solution.x[[0, 3]], 1.0, atol=0.01)
    np.testing.assert_allclose(solution.x[1:3], TRUTH[1:], atol=0.1)


def test_a_column_of_zeros_gets_zero() -> None:
    (block,) = blocks(0.0)
    wider = np.column_stack([block.matrix, np.zeros(len(block.target))])
    solution = solve(
        [Block(matrix=wider, target=block.target)], scale=np.append(SCALE, 1.0), weighted=True
    )
    assert solution.x[3] == 0.0
    np.testing.assert_allclose(solution.x[:3], TRUTH, rtol=1e-4)


def test_a_poorly_excited_column_gets_no_huge_coefficient() -> None:
    (block,) = blocks(0.1)
    faint = 1e-7 * np.random.default_rng(1).standard_normal(len(block.target))
    wider = np.column_stack([block.matrix, faint])
    solution = solve(
        [Block(matrix=wider, target=block.target)], scale=np.append(SCALE, 1.0), weighted=True
    )
    assert abs(solution.x[3]) < 1.0
    np.testing.assert_allclose(solution.x[:3], TRUTH, atol=0.1)


def test_a_target_of_zeros_gives_zeros() -> None:
    (block,) = blocks(0.0)
    still = Block(matrix=block.matrix, target=np.zeros_like(block.target))
    np.testing.assert_array_equal(solve([still, still], scale=SCALE, weighted=True).x, np.zeros(3))


@pytest.mark.parametrize("weighted", [True, False])
def test_weights_follow_from_the_residuals_twice(weighted: bool) -> None:
    """The same in rows: each divided by the residual of its block, twice in succession."""
    given = blocks(3.0, 0.5, 0.1, rows=7)
    matrix = np.concatenate([block.matrix for block in given])
    target = np.concatenate([block.target for block in given])
    weights = np.ones(len(target))
    for _ in range(3 if weighted else 1):
        x = np.linalg.lstsq(weights[:, None] * matrix, weights * target)[0]
        rmse = np.sqrt(np.mean((target - matrix @ x).reshape(3, 7) ** 2, axis=1))
        before, weights = weights, np.repeat(1.0 / rmse, 7)
    found = solve(given, scale=SCALE, weighted=weighted)
    np.testing.assert_allclose(found.x, x, rtol=1e-9)
    np.testing.assert_allclose(found.rmse, rmse, rtol=1e-9)
    rows = before[:, None] * matrix
    singular = np.linalg.svd(rows / SCALE, compute_uv=False)
    assert found.condition == pytest.approx(singular[0] / singular[-1], rel=1e-9)


@pytest.mark.parametrize(("smallest", "ridge"), [(0.11, 0.0), (0.09, 3e-3)])
def test_the_ridge_scales_with_the_largest_singular_value(smallest: float, ridge: float) -> None:
    """Orthogonal columns with singular values 100, 1 and a thousandth or less."""
    scale, singular = np.array([1.0, 10.0, 0.1]), np.array([100.0, 1.0, smallest])
    matrix = np.vstack([np.diag(singular * scale), np.zeros((2, 3))])
    target = np.array([5.0, 3.0, 2.0, 0.7, -0.4])
    found = solve([Block(matrix=matrix, target=target)], scale=scale, weighted=False)
    pull = ridge * 100.0
    x = singular / (singular**2 + pull**2) * target[:3] / scale
    np.testing.assert_allclose(found.x, x, rtol=1e-12)
    assert (found.ridge, found.condition) == (ridge, pytest.approx(100.0 / smallest))
    np.testing.assert_allclose(found.pull, pull * scale, rtol=1e-12)
    squares = np.sum((target - matrix @ x) ** 2)
    np.testing.assert_allclose(found.rmse, np.sqrt(squares / 5), rtol=1e-12)
