"""Coverage of intervals and bands on measured logs not used for estimation (UR10e)."""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cosim.study.scores import transpose_records
from hesr_model.fitting.fit import fit_models
from hesr_model.logs.rest import MOVING
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import moving, near_reversals
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

pytestmark = pytest.mark.soak


@pytest.fixture(scope="module")
def body(id_logs: list[Log], ur10e_model: Robot) -> RigidBody:
    return identify(id_logs, ur10e_model)


@pytest.mark.parametrize("law", ["lugre", "stribeck", "lugre_load_ripple"])
def test_a_band_has_its_stated_coverage(
    body: RigidBody,
    id_logs: list[Log],
    unseen_logs: list[Log],
    ur10e_model: Robot,
    law: str,
) -> None:
    trained = transpose_records([friction_records(log, ur10e_model, body) for log in id_logs])
    model = fit_models([law], trained, robot="ur10e", seed=0)[law]
    tested = [friction_records(log, ur10e_model, body) for log in unseen_logs]
    bands = [model.predict_band(records) for records in tested]
    torques = [model.predict(records) for records in tested]
    widths = []
    for k, name in enumerate(model.joints):
        held, width, error, slow, near = [], [], [], [], []
        for records, (lower, upper), torque in zip(tested, bands, torques, strict=True):
            r = records[k]
            held.append((r.tau >= lower[:, k]) & (r.tau <= upper[:, k]))
            width.append((upper - lower)[:, k] / 2.0)
            error.append(np.abs(r.tau - torque[:, k]))
            slow.append(~moving(r.dq, MOVING))
            near.append(near_reversals(r.t, r.dq, MOVING))
        inside, rests, reversals = map(np.concatenate, (held, slow, near))
        share = float(inside.mean())
        constant = float(np.quantile(np.concatenate(error), share))
        widths.append(float(np.concatenate(width).mean()) / constant)
        logs = [float(h.mean()) for h in held]
        sys.stdout.write(
            f"\n{law}, {name}: {share:.3f}, moving {inside[~rests].mean():.3f}, reversals "
            f"{inside[reversals].mean():.3f}, rests {inside[rests].mean():.3f}, worst log "
            f"{min(logs):.3f}, {widths[-1]:.2f} times the constant band\n"
        )
        assert 0.90 <= share <= 0.98
        assert inside[~rests].mean() >= 0.88
        assert inside[reversals].mean() >= 0.88
        assert min(logs) >= 0.80
    assert np.mean(widths) <= 1.05


def beyond(one: RigidBody, other: RigidBody) -> list[bool]:
    """Whether base parameters of two sets of logs differ by more than both stated errors.

    A single log contains no information on differences between logs: the factor of the first set is
    used for both.
    """
    base, own, of_other = list(one.base), one.covariance, other.covariance
    assert own is not None
    assert of_other is not None
    alike = replace(of_other, between=own.between, degrees=own.degrees)
    errors = np.hypot(own.standard_errors, alike.standard_errors)
    return list(np.abs(one.parameters[base] - other.parameters[base]) > 1.96 * errors)


def shares(pairs: Sequence[tuple[RigidBody, RigidBody]], what: str) -> float:
    found = float(np.mean([b for pair in pairs for b in beyond(*pair)]))
    sys.stdout.write(f"\n|z| of base parameters beyond 1.96, {what}: {found:.3f}\n")
    return found


def test_base_parameters_have_their_stated_errors(
    body: RigidBody,
    id_logs: list[Log],
    unseen_logs: list[Log],
    ur10e_model: Robot,
) -> None:
    left_out = [
        (
            identify([log for log in id_logs if log is not out], ur10e_model),
            identify([out], ur10e_model),
        )
        for out in id_logs
    ]
    assert shares(left_out, "left-out logs") <= 0.10
    assert shares([(body, identify(unseen_logs, ur10e_model))], "test logs") <= 0.10
