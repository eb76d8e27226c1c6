"""Rows used by identification, and interpolation of a time-reversed log."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hesr_model.errors import FitError
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.observations import (
    arrange_by_joint,
    average_blocks,
    find_determined_friction,
    friction_columns,
    match_motions,
    peak_speeds,
    slow_speeds,
    stack_blocks,
)
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]


@pytest.fixture
def lift(make_motion: MakeMotion) -> Motion:
    """The third joint hardly exceeds 0.1 rad/s."""
    motion = make_motion(friction=2.0, seconds=4.0)
    dq = motion.dq * [1.0, 1.0, 0.3 / np.abs(motion.dq[:, 2]).max()]
    return replace(motion, dq=dq)


def test_the_slow_threshold_is_a_tenth_or_a_quarter_of_the_peak(
    lift: Motion, arm_model: Robot
) -> None:
    twice = replace(lift, dq=2.0 * lift.dq)
    np.testing.assert_allclose(
        slow_speeds(peak_speeds([lift], arm_model)), [0.1, 0.1, 0.075], rtol=1e-12
    )
    np.testing.assert_allclose(
        slow_speeds(peak_speeds([lift, twice], arm_model)), [0.1, 0.1, 0.1], rtol=1e-12
    )


def test_slow_rows_are_left_out(lift: Motion, arm_model: Robot) -> None:
    base = base_columns(arm_model)
    friction = friction_columns(arm_model, base)
    found = stack_blocks([lift, lift], arm_model, base, friction)
    rigid = arm_model.regressor(lift.q, lift.dq, lift.ddq)[:, :, list(base)]
    for joint, block in enumerate(found):
        speed = lift.dq[:, joint]
        kept = np.abs(speed) > (0.1, 0.1, 0.075)[joint]
        assert 0 < np.count_nonzero(kept) < len(kept)
        rubbing = np.zeros((len(speed), 9))
        rubbing[:, 3 * joint : 3 * joint + 3] = np.column_stack(
            [np.sign(speed), speed, np.ones(len(speed))]
        )
        matrix = np.hstack([rigid[:, joint], rubbing[:, friction.ravel()]])[kept]
        np.testing.assert_allclose(block.matrix, np.vstack([matrix, matrix]), atol=1e-13)
        np.testing.assert_array_equal(block.target, np.tile(lift.tau[kept, joint], 2))


def test_friction_coefficients_follow_their_columns() -> None:
    columns = np.array([[True, True, False], [True, False, True]])
    found = arrange_by_joint(np.array([1.0, 2.0, 3.0, 4.0]), columns)
    np.testing.assert_array_equal(found, [[1.0, 2.0, 0.0], [3.0, 0.0, 4.0]])


def test_averaging_uses_rows_with_opposite_motion(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """A mirror in time: row k pairs with the k-th row from the end of the other log."""
    forward, backward = (make_motion(friction=3.0, reverse=way, seconds=4.0) for way in (0, 1))
    slower = replace(backward, dq=0.5 * backward.dq)
    base = base_columns(arm_model)
    found = average_blocks([forward], [slower], arm_model, base)
    regressors = [
        arm_model.regressor(m.q, m.dq, m.ddq)[:, :, list(base)] for m in (forward, slower)
    ]
    matrix = 0.5 * (regressors[0] + regressors[1][::-1])
    tau = 0.5 * (forward.tau + backward.tau[::-1])
    for joint, block in enumerate(found):
        kept = np.abs(forward.dq[:, joint]) > 0.2
        assert 0 < np.count_nonzero(kept) < len(kept)
        np.testing.assert_allclose(block.matrix, matrix[kept, joint], atol=1e-9)
        np.testing.assert_allclose(block.target, tau[kept, joint], atol=1e-9)


# --- a counterpart sampled at other times -----------------------------------------------------


def one_joint(name: str, t: np.ndarray, run: np.ndarray, tau: np.ndarray) -> Motion:
    """q = run^3, with the given torque."""
    q = (run**3)[:, None]
    return Motion(
        name=name,
        t=t,
        q=q,
        dq=3.0 * run[:, None] ** 2,
        ddq=6.0 * run[:, None],
        tau=tau[:, None],
        q_raw=np.sign(q - 0.1),
    )


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_raw_signals_are_read_linearly_between_samples(late: float) -> None:
    """Torque and raw position have steps, around which a smooth curve would oscillate."""
    t = 0.05 * np.arange(21)
    times = 7.0 + 0.03 * np.arange(44)
    run = 1.29 - (times - 7.0) - late  # the mirror image of t at the end of the log, with a delay
    rng = np.random.default_rng(0)
    forward = one_joint("forward", t, t, rng.normal(size=21))
    backward = one_joint("backward", times, run, np.sign(rng.normal(size=44)))
    there, back = match_motions(forward, backward)
    rows = np.isin(forward.t, there.t)
    read = times[-1] - t + (0.0 if late == 0.0 else -late)
    np.testing.assert_array_equal(rows, (read >= 7.0) & (read <= times[-1]))
    np.testing.assert_allclose(back.t, read[rows], atol=1e-12)
    for name in ("tau", "q_raw"):
        expected = np.interp(read[rows], times, getattr(backward, name)[:, 0])
        np.testing.assert_allclose(getattr(back, name)[:, 0], expected, atol=1e-12)
    # The smooth signals are cubic, so interpolation is exact.
    np.testing.assert_allclose(back.q, there.q, atol=1e-12)
    np.testing.assert_allclose(back.ddq, there.ddq, atol=1e-12)
    for name in ("t", "q", "dq", "ddq", "tau", "q_raw"):
        np.testing.assert_array_equal(getattr(there, name), getattr(forward, name)[rows])


def test_the_position_gap_is_that_of_the_best_shift() -> None:
    """Linear interpolation, with shifts of up to 0.5 s that keep at least half of the rows."""
    t, times = 0.1 * np.arange(12), 0.09 * np.arange(13)
    rng = np.random.default_rng(2)
    forward, backward = (
        replace(one_joint("one", at, at, at), q=rng.normal(size=(len(at), 1))) for at in (t, times)
    )
    distances = []
    for shift in 0.1 * np.arange(-5, 6):
        at = times[-1] - t + shift
        rows = (at >= 0.0) & (at <= times[-1])
        if np.sum(rows) >= 6:
            read = np.interp(at[rows], times, backward.q[:, 0])
            distances.append(np.sqrt(np.mean((forward.q[rows, 0] - read) ** 2)))
    with pytest.raises(FitError) as caught:
        match_motions(forward, backward)
    assert f"differ by {min(distances):.3g} rad on average" in str(caught.value)


def test_friction_that_a_motion_does_not_separate_has_no_columns(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """One direction, one speed in two directions, and both at once."""
    usual = make_motion(seconds=10.0)
    assert np.all(find_determined_friction([usual], arm_model))
    dq = np.abs(usual.dq) + 0.2
    dq[:, 1] = 0.5 * np.where(usual.t < 4.0, 1.0, -1.0)
    dq[:, 2] = -0.5
    found = find_determined_friction([replace(usual, dq=dq)], arm_model)
    np.testing.assert_array_equal(
        found, [[True, True, False], [True, False, True], [True, False, False]]
    )
    assert not np.any(find_determined_friction([replace(usual, dq=0.0 * dq)], arm_model))
