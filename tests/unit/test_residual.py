from dataclasses import replace

import numpy as np
import pytest

from hesr_model.errors import LogError
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records, require_reversals
from hesr_model.robots.robot import Robot


def test_a_record_holds_the_rigid_body_residual(arm_log: Log, arm_model: Robot) -> None:
    rigid_body = identify([arm_log], arm_model)
    records = friction_records(arm_log, arm_model, rigid_body)
    assert [(r.log, r.joint) for r in records] == [("run", "j1"), ("run", "j2"), ("run", "j3")]
    assert arm_log.dq is not None
    for k, record in enumerate(records):
        np.testing.assert_array_equal(record.t, arm_log.t)
        np.testing.assert_array_equal(record.q, arm_log.q[:, k])
        np.testing.assert_allclose(record.tau + record.tau_load, arm_log.tau[:, k], atol=1e-12)
        np.testing.assert_allclose(record.dq, arm_log.dq[:, k], atol=2e-3)
        # The true friction: 3 N.m of Coulomb and 1.5 N.m.s/rad.
        dq = arm_log.dq[:, k]
        expected = 3.0 * np.sign(dq) + 1.5 * dq
        np.testing.assert_allclose(record.tau, expected, atol=0.05)


def test_a_joint_that_never_reverses_is_named(arm_log: Log, arm_model: Robot) -> None:
    rigid_body = identify([arm_log], arm_model)
    (record, *_) = friction_records(arm_log, arm_model, rigid_body)
    one_way = replace(record, log="one_way", dq=np.abs(record.dq))
    require_reversals([one_way, record])
    message = "one_way: the velocity of joint 'j1'"
    with pytest.raises(LogError, match=message):
        require_reversals([one_way])
