"""Streamed identification: the estimate equals that of the batch for any split into motions."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hesr_model.errors import FitError
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body import identification
from hesr_model.rigid_body.accumulation import StreamedProblem
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.robots.robot import Robot

MakeMotion = Callable[..., Motion]


@pytest.fixture
def motions(make_motion: MakeMotion) -> list[Motion]:
    """Three noisy logs."""
    rng = np.random.default_rng(1)
    made = [make_motion(name=f"log{k}", seconds=2.0 + k, friction=2.0) for k in range(3)]
    return [replace(m, tau=m.tau + 0.1 * rng.standard_normal(m.tau.shape)) for m in made]


def of(model: Robot, motions: list[Motion]) -> RigidBody:
    stream = StreamedProblem(model)
    for motion in motions:
        stream.add(motion)
    if not stream.is_consistent:
        again = StreamedProblem(model, stream.min_speeds)
        for motion in motions:
            again.add(motion)
        assert again.is_consistent
        stream = again
    return stream.body(motions, "the logs")


def assert_alike(one: RigidBody, other: RigidBody) -> None:
    for name in ("parameters", "friction", "rmse", "standard_errors"):
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-9 * float(np.abs(b).max()))
    assert one.condition == pytest.approx(other.condition, rel=1e-9)
    assert (one.base, one.rows, one.logs, one.ridge) == (
        other.base,
        other.rows,
        other.logs,
        other.ridge,
    )


def test_the_body_equals_that_of_the_batch(
    arm_model: Robot, motions: list[Motion], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identification, "ROWS_AT_ONCE", 300)
    assert_alike(of(arm_model, motions), identify_motions(motions, arm_model))


def test_the_body_equals_that_of_the_batch_with_a_slow_joint(
    arm_model: Robot, motions: list[Motion]
) -> None:
    """Its slow rows are known only at the end."""
    slow = np.array([1.0, 0.1, 1.0])
    slower = [replace(m, dq=m.dq * slow) for m in motions]
    stream = StreamedProblem(arm_model)
    for motion in slower:
        stream.add(motion)
    assert not stream.is_consistent
    assert_alike(of(arm_model, slower), identify_motions(slower, arm_model))


def test_the_covariance_of_a_sample_is_conservative(
    arm_model: Robot, motions: list[Motion]
) -> None:
    stream = StreamedProblem(arm_model)
    for motion in motions:
        stream.add(motion)
    whole = stream.body(motions, "the logs")
    part = stream.body([motion.rows(slice(0, 400)) for motion in motions], "the logs")
    np.testing.assert_array_equal(part.parameters, whole.parameters)
    assert np.median(part.standard_errors / whole.standard_errors) > 1.0


def test_too_few_rows_are_refused(arm_model: Robot, motions: list[Motion]) -> None:
    stream = StreamedProblem(arm_model)
    stream.add(motions[0].rows(slice(0, 20)))
    with pytest.raises(FitError, match="robot 'R7': 20 samples cannot determine"):
        stream.body([motions[0]], "robot 'R7'")
    still = StreamedProblem(arm_model)
    still.add(replace(motions[0], dq=0.0 * motions[0].dq))
    with pytest.raises(FitError, match="robot 'R7': joint 'j1' is never faster than"):
        still.body([motions[0]], "robot 'R7'")


def test_friction_that_one_way_motion_does_not_separate_is_left_out_as_in_the_batch(
    arm_model: Robot, one_way: Motion
) -> None:
    noise = 0.1 * np.random.default_rng(1).standard_normal(one_way.tau.shape)
    one_way = replace(one_way, tau=one_way.tau + noise)
    batch = identify_motions([one_way], arm_model)
    np.testing.assert_array_equal(
        batch.friction != 0.0, [[True, False, False], [True, True, False], [True, True, True]]
    )
    assert_alike(of(arm_model, [one_way]), batch)
