"""The rigid body is the kind that predicts best what it was not identified from."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.study.starter import Bench, start_bench
from hesr_model.errors import FitError
from hesr_model.inference.folds import split_into_folds
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.choice import choose_body, identify_kind
from hesr_model.rigid_body.identification import Kind, RigidBody, identify_motions
from hesr_model.robots.robot import Robot, RobotDescription

MakeMotion = Callable[..., Motion]


def noisy(motion: Motion, sigma: float, seed: int = 0) -> Motion:
    noise = sigma * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=motion.tau + noise)


@pytest.fixture
def wrong(arm: RobotDescription) -> Robot:
    """The arm, with a model file whose masses are a third too large."""
    robot = Robot(arm)
    robot.nominal_parameters = 1.3 * robot.nominal_parameters
    return robot


def test_a_right_model_file_is_kept_with_a_short_noisy_log(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    choice = choose_body([noisy(make_motion(friction=3.0, seconds=5.0), 3.0)], arm_model)
    assert choice.kind == choice.body.kind == "nominal"
    np.testing.assert_array_equal(choice.body.parameters, arm_model.nominal_parameters)
    np.testing.assert_allclose(choice.body.friction[:, 0], 3.0, atol=0.7)
    assert choice.body.base == ()
    assert choice.body.torque_spread(arm_model, make_motion()) is None
    assert "(5 s) determine no better one" in choice.sentence


def test_wrong_masses_give_way(wrong: Robot, arm_model: Robot, make_motion: MakeMotion) -> None:
    choice = choose_body([noisy(make_motion(friction=3.0, seconds=20.0), 0.3)], wrong)
    assert choice.kind in ("physical", "free")
    other = make_motion(seconds=7.0)
    error = choice.body.torque(wrong, other) - other.tau
    assert np.sqrt(np.mean(error**2, axis=0)) == pytest.approx(0.0, abs=0.2)
    rmse = choice.left_out_rmse
    np.testing.assert_allclose(rmse[choice.kind], 0.3, rtol=0.2)
    assert np.all(rmse["nominal"] > rmse[choice.kind])
    np.testing.assert_array_equal(choice.body.left_out_rmse, rmse[choice.kind])
    assert "by left-out blocks: error 0." in choice.sentence


def test_bodies_of_folds_have_not_seen_what_they_are_judged_on(
    wrong: Robot, make_motion: MakeMotion
) -> None:
    motion = noisy(make_motion(friction=3.0, seconds=10.0), 0.3)
    folds = split_into_folds([motion], 4)
    choice = choose_body([motion], wrong, folds=folds, kinds=("free",))
    bodies = choice.fold_bodies["free"]
    assert len(bodies) == 4
    for fold, body in zip(folds, bodies, strict=True):
        assert body is not None
        expected = identify_motions(fold.training, wrong)
        np.testing.assert_allclose(body.parameters, expected.parameters, rtol=1e-9, atol=1e-9)


def test_what_is_impossible_is_not_chosen(arm: RobotDescription, make_motion: MakeMotion) -> None:
    motion = noisy(make_motion(friction=3.0, seconds=6.0), 0.3)
    known = Robot(arm.model_copy(update={"known": ("j1.m",)}))
    choice = choose_body([motion], known)
    assert choice.kind == "nominal"
    assert list(choice.reasons) == ["physical"]
    assert "excludes 'known'" in choice.reasons["physical"]

    bare = Robot(arm)
    bare.nominal_parameters = np.zeros_like(bare.nominal_parameters)
    choice = choose_body([motion], bare)
    assert choice.kind != "nominal"
    assert "its model file has no masses" in choice.reasons["nominal"]
    with pytest.raises(FitError, match="has no masses; choose another 'body'"):
        choose_body([motion], bare, kinds=("nominal",))


def test_less_than_three_seconds_are_not_judged(arm_model: Robot, make_motion: MakeMotion) -> None:
    choice = choose_body([make_motion(friction=3.0, seconds=2.0)], arm_model)
    assert choice.kind == "nominal"
    assert choice.left_out_rmse == {}
    assert choice.body.left_out_rmse.size == 0
    assert choice.sentence.endswith("(2 s) are too short to judge.")


def test_a_rigid_body_keeps_its_kind_in_a_file(
    arm_model: Robot, make_motion: MakeMotion, tmp_path: Path
) -> None:
    body = choose_body([noisy(make_motion(friction=3.0, seconds=5.0), 3.0)], arm_model).body
    body.write(tmp_path / "body.json")
    back = RigidBody.read(tmp_path / "body.json")
    assert back.kind == "nominal"
    np.testing.assert_array_equal(back.left_out_rmse, body.left_out_rmse)
    np.testing.assert_array_equal(back.parameters, body.parameters)


def test_motion_one_way_determines_no_offset(arm_model: Robot, make_motion: MakeMotion) -> None:
    motion = make_motion()
    one_way = replace(motion, dq=np.abs(motion.dq) + 0.2)
    kinds: tuple[Kind, ...] = ("free", "physical")
    for kind in kinds:
        body = identify_kind([one_way], arm_model, kind)
        assert np.abs(body.friction).max() < 1e3
        np.testing.assert_array_equal(body.friction[:, 2], 0.0)


def test_a_negative_mass_of_a_bench_is_held_and_named(tmp_path: Path) -> None:
    """A stiff contact that turns back slowly looks like a negative mass."""
    bench = Bench(kind="sliding", joints=("axis",))
    log = {"columns": {"t": "t", "q": ["q"], "tau": ["f"]}}
    start_bench(tmp_path / "bench", bench, log)
    robot = Robot(tmp_path / "bench" / "robot.toml")
    t = np.arange(0.0, 12.0, 0.01)
    q = 0.3 * np.sin(t)[:, None]
    dq = 0.3 * np.cos(t)[:, None]
    tau = 5.0 * np.sign(dq) + 20.0 * q
    motion = Motion(name="run", t=t, q=q, dq=dq, ddq=-q, tau=tau, q_raw=q)
    body = identify_motions([motion], robot, holds=False)
    assert body.parameters[0] < -10.0
    choice = choose_body([motion], robot, kinds=("free",))
    assert choice.body.held == ("axis.m",)
    assert choice.body.parameters[0] == robot.nominal_parameters[0] == 1.0
    assert choice.sentence.endswith("axis.m; the model file's 1 kg is used.")
    # An empty list of known parameters excludes nothing.
    assert identify_kind([motion], robot, "physical").parameters[0] > 0.0
