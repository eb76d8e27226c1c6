"""Covariance of an identified payload, hand-computed over segments of correlated time."""

import numpy as np
import pytest

from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.least_squares import Block, Solution
from hesr_model.rigid_body.observations import stack_blocks
from hesr_model.rigid_body.payload import _estimate_covariance, _number_segments, _propagate_errors
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder


def moving(t: np.ndarray, dq: np.ndarray) -> Motion:
    return Motion(name="m", t=t, q=dq, dq=dq, ddq=dq, tau=dq, q_raw=dq)


def solved(x: np.ndarray, rmse: list[float]) -> Solution:
    size = np.array(rmse)
    return Solution(
        x=x, condition=1.0, ridge=0.0, pull=np.zeros_like(x), weights=1.0 / size, rmse=size
    )


@pytest.fixture
def blocks() -> list[Block]:
    rng = np.random.default_rng(0)
    return [Block(matrix=rng.normal(size=(n, 2)), target=rng.normal(size=n)) for n in (6, 4)]


X = np.array([0.3, -0.2])
RMSE = [2.0, 0.5]
SEGMENTS = [np.array([0, 0, 1, 1, 2, 2]), np.array([0, 1, 1, 3])]


def test_segments_are_numbered_across_logs() -> None:
    """Segments last one second; a new log begins a new segment."""
    one, two = np.array([5.0, 5.4, 5.99, 6.0, 7.5]), np.array([0.0, 0.9, 1.1])
    motions = [moving(t, np.ones((len(t), 1))) for t in (one, two)]
    np.testing.assert_array_equal(_number_segments(motions), [0, 0, 0, 1, 2, 3, 3, 4])


def test_rows_of_slow_joints_are_left_out() -> None:
    dq = np.array([[1.0, 0.05, 0.0], [0.09, 1.0, 1.0], [-0.11, 0.5, 0.0], [0.1, -0.2, 0.0]])
    robot = Robot(RobotDescription.read(models_folder() / "uf850" / "robot.toml"))
    motion = moving(np.arange(4.0), dq)
    found = [
        block.samples for block in stack_blocks([motion], robot, (0,), np.ones((3, 3), dtype=bool))
    ]
    np.testing.assert_array_equal(found[0], [0, 2])
    np.testing.assert_array_equal(found[1], [1, 2, 3])
    np.testing.assert_array_equal(found[2], [1])


def test_the_covariance_is_the_sandwich_of_sums_over_segments(blocks: list[Block]) -> None:
    """H^-1 (sum g g') H^-1 n / (n - 1), rows weighted by the residual of their joint."""
    rows = np.vstack([b.matrix / s for b, s in zip(blocks, RMSE, strict=True)])
    left = np.concatenate(
        [(b.target - b.matrix @ X) / s for b, s in zip(blocks, RMSE, strict=True)]
    )
    own = np.concatenate(SEGMENTS)
    inverse = np.linalg.inv(rows.T @ rows)
    sums = [rows[own == k].T @ left[own == k] for k in range(4)]
    expected = inverse @ sum(np.outer(g, g) for g in sums) @ inverse * 4 / 3
    found = _estimate_covariance(blocks, solved(X, RMSE), SEGMENTS)
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_errors_of_the_unloaded_body_are_propagated(blocks: list[Block]) -> None:
    """The least-squares response to an error in each parameter of the unloaded body."""
    rng = np.random.default_rng(1)
    carried = [rng.normal(size=(len(b.target), 3)) for b in blocks]
    errors = np.array([0.1, 0.2, 0.05])
    rows = np.vstack([b.matrix / s for b, s in zip(blocks, RMSE, strict=True)])
    off = np.vstack([c / s for c, s in zip(carried, RMSE, strict=True)]) * errors
    spread = np.linalg.lstsq(rows, off)[0]
    found = _propagate_errors(blocks, solved(X, RMSE), carried, errors)
    np.testing.assert_allclose(found, spread @ spread.T, rtol=1e-10)
