"""Laws are judged on rows that neither they nor their body were fitted to."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cosim.study.law_choice import add_left_out_errors
from hesr_model.errors import FitError
from hesr_model.fitting import left_out
from hesr_model.fitting.days import Nuisance
from hesr_model.fitting.fit import fit_joint, fit_models
from hesr_model.fitting.left_out import judge_laws
from hesr_model.friction.band import REST
from hesr_model.friction.records import predict_record
from hesr_model.inference.choice import PLAIN
from hesr_model.inference.folds import Fold, split_into_folds, thin
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.identification import RigidBody, identify_motions
from hesr_model.rigid_body.residual import motion_records, transform_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.robots.transmission import Transmission

MakeMotion = Callable[..., Motion]
LAWS = (PLAIN, "constant")
WORST = 1


def noisy(motion: Motion, seed: int = 0) -> Motion:
    noise = 0.1 * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=motion.tau + noise)


def judge(
    motions: Sequence[Motion], robot: Robot, laws: Sequence[str] = LAWS, **settings: Any
) -> tuple[LeftOutErrors, list[Fold], list[RigidBody]]:
    folds = split_into_folds(motions, 3)
    bodies = [identify_motions(fold.training, robot) for fold in folds]
    errors = judge_laws(laws, motions, robot, folds, bodies, workers=1, **settings)
    return errors, folds, bodies


def test_errors_are_those_of_a_fit_without_the_fold(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """The law is fitted and its torque compared here, by the body of each fold."""
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    errors, folds, bodies = judge([motion], arm_model)
    assert errors.laws == LAWS
    assert errors.failed == {}
    assert errors.counts.all()
    for number, (fold, body) in enumerate(zip(folds, bodies, strict=True)):
        (judged,) = fold.judged
        np.testing.assert_array_equal(errors.fold_of_row[0][judged], number)
        pieces = [motion_records(thin(piece), arm_model, body) for piece in fold.training]
        for j in range(3):
            law = fit_joint(PLAIN, [piece[j] for piece in pieces], seed=0)
            record = motion_records(motion, arm_model, body)[j]
            expected = predict_record(law, record.causal) - record.tau
            np.testing.assert_allclose(
                errors.errors[PLAIN][0][judged, j], expected[judged], rtol=1e-9, atol=1e-12
            )
            for name in ("tau", "dq", "tau_load"):
                np.testing.assert_array_equal(
                    getattr(errors, name)[0][judged, j], getattr(record, name)[judged]
                )
    for j in range(3):
        assert errors.rmse(PLAIN, j) < 0.3 < errors.rmse("constant", j)


def test_bands_contain_the_errors_on_left_out_rows(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """A drift of the torque that three seconds of a fold do not show."""
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    motion = replace(motion, tau=motion.tau + 0.3 * np.sin(0.5 * motion.t)[:, None])
    errors, _, _ = judge([motion], arm_model)
    body = identify_motions([motion], arm_model)
    records = motion_records(motion, arm_model, body)
    model = fit_models([PLAIN], [[record] for record in records], robot="arm", seed=0, workers=1)[
        PLAIN
    ]
    judged_model = add_left_out_errors(model, errors)
    is_moving = np.abs(motion.dq) >= REST
    left_out = -errors.joint_errors[PLAIN][0]  # measured less predicted
    shares = {}
    for name, banded_model in (("fit", model), ("left out", judged_model)):
        lower, upper = banded_model.predict_band(records)
        torque = banded_model.predict(records)
        is_inside = (left_out >= lower - torque) & (left_out <= upper - torque)
        shares[name] = [float(is_inside[is_moving[:, j], j].mean()) for j in range(3)]
    assert min(shares["fit"]) < 0.9
    # Loads of the band are those of the final body.
    assert shares["left out"] == pytest.approx([0.95] * 3, abs=0.025)
    assert judged_model.left_out_rmse == tuple(errors.rmse(PLAIN, j) for j in range(3))


def test_a_fold_does_not_see_its_rows(arm_model: Robot, make_motion: MakeMotion) -> None:
    """Other torques in the rows of a fold change its errors there by just that."""
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    errors, folds, bodies = judge([motion], arm_model)
    (judged,) = folds[WORST].judged
    changed = replace(motion, tau=motion.tau + 100.0 * judged[:, None])
    other = judge_laws(
        LAWS, [changed], arm_model, split_into_folds([changed], 3), bodies, workers=1
    )
    for law_name in LAWS:
        difference = other.errors[law_name][0] - errors.errors[law_name][0]
        np.testing.assert_allclose(difference[judged], -100.0, atol=1e-9)
    assert not np.allclose(other.errors[PLAIN][0][~judged], errors.errors[PLAIN][0][~judged])


def test_a_law_that_cannot_be_fitted_in_a_fold_has_a_reason(
    arm_model: Robot, make_motion: MakeMotion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It stops nothing, and no fold of it is judged."""
    whole = left_out.load_or_fit
    calls = []

    def fail_later(law_name: str, *arguments: Any, **settings: Any) -> Any:
        calls.append(law_name)
        if law_name == "constant" and calls.count("constant") > 3:
            return FitError("law 'constant': no")
        return whole(law_name, *arguments, **settings)

    monkeypatch.setattr(left_out, "load_or_fit", fail_later)
    errors, _, _ = judge([noisy(make_motion(friction=3.0, seconds=12.0))], arm_model)
    assert errors.laws == (PLAIN,)
    assert errors.failed == {"constant": "law 'constant': no"}


def test_a_joint_without_a_reversal_in_a_fold_does_not_hide_the_others(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """Without the first third the second joint never reverses, and no law with memory fits it."""
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    dq = motion.dq.copy()
    late = motion.t > 4.0
    dq[late, WORST] = np.abs(dq[late, WORST]) + 0.1
    errors, _, _ = judge([replace(motion, dq=dq)], arm_model, ("lugre", *LAWS))
    assert errors.failed == {}
    assert errors.laws == ("lugre", *LAWS)
    np.testing.assert_array_equal(errors.counts[:, WORST], [False, True, True])
    assert errors.counts[:, [0, 2]].all()
    assert np.isfinite([errors.rmse("lugre", j) for j in range(3)]).all()


def test_a_law_that_no_fold_can_train_has_a_reason(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    body = identify_motions([motion], arm_model)
    folds = [replace(fold, training=()) for fold in split_into_folds([motion], 3)]
    errors = judge_laws(LAWS, [motion], arm_model, folds, [body] * 3, workers=1)
    assert errors.laws == ()
    assert "leaves nothing to train on" in errors.failed[PLAIN]
    assert not errors.counts.any()


def test_offsets_of_a_log_are_fitted_to_its_judged_rows(
    arm_model: Robot, make_motion: MakeMotion
) -> None:
    """Each of the logs has its own offset, which no other log can tell."""
    motions = [noisy(make_motion(name=f"day{k}", friction=3.0, seconds=6.0), k) for k in range(3)]
    motions = [replace(m, tau=m.tau + 4.0 * (k - 1)) for k, m in enumerate(motions)]
    folds = split_into_folds(motions, 3)
    body = replace(identify_motions(motions, arm_model))
    apart = judge_laws([PLAIN], motions, arm_model, folds, [body] * 3, workers=1)
    offset: tuple[Nuisance, ...] = ("offset",)
    fitted = judge_laws([PLAIN], motions, arm_model, folds, [body] * 3, per_log=offset, workers=1)
    for j in range(3):
        assert apart.rmse(PLAIN, j) > 2.0
        assert fitted.rmse(PLAIN, j) < 0.5


def test_coupled_joints_are_judged_where_friction_acts(
    arm: RobotDescription, make_motion: MakeMotion
) -> None:
    """Laws have errors at motors for the choice, and at joints for the report."""
    matrix = ((50.0, 0.0, 0.0), (0.0, 40.0, 0.0), (0.0, 6.0, 30.0))
    coupled = RobotDescription(**{**dict(arm), "transmission": Transmission(matrix=matrix)})
    robot = Robot(coupled)
    coupling = coupled.coupling
    assert coupling is not None
    motion = noisy(make_motion(friction=3.0, seconds=12.0))
    errors, folds, bodies = judge([motion], robot)
    for law_name in LAWS:
        (at_joints,) = errors.joint_errors[law_name]
        (at_friction,) = errors.errors[law_name]
        np.testing.assert_allclose(at_friction, coupling.torque(at_joints))
        assert not np.allclose(at_friction, at_joints)
    (judged,) = folds[0].judged
    records = transform_records(motion_records(motion, robot, bodies[0]))
    tau = np.column_stack([record.tau for record in records])
    np.testing.assert_allclose(errors.tau[0][judged], tau[judged])
