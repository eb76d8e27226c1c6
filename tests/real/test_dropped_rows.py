"""Half the rows of a measured log are lost at random: the same sliding torque, or a refusal."""

import numpy as np
import pytest

from hesr_model.errors import HesrError
from hesr_model.friction.evaluate import predict
from hesr_model.friction.fitting.fit import fit
from hesr_model.health.examine import checked
from hesr_model.logs.robot_log import RobotLog
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import RobotModel

SPEEDS = np.array([-0.6, -0.3, 0.3, 0.6])


def sliding_torques(log: RobotLog, model: RobotModel) -> np.ndarray:
    """Steady torque (n, speeds) of a LuGre law [N.m]."""
    body = identify([log], model)
    law = fit("lugre", *(friction_records(part, model, body) for part in log.parts()))
    t = np.arange(200) * 0.01
    return np.array(
        [[predict(one, t=t, dq=np.full(len(t), v))[-1] for v in SPEEDS] for one in law.laws]
    )


@pytest.mark.parametrize("seed", [0, 1])
def test_half_the_rows_give_the_same_sliding_torque_or_are_refused(
    seed: int, id_logs: list[RobotLog], ur10e_model: RobotModel
) -> None:
    whole = id_logs[0]
    kept = np.sort(
        np.random.default_rng(seed).choice(len(whole.t), len(whole.t) // 2, replace=False)
    )
    half = whole.rows(kept)
    try:
        checked([half], ur10e_model)
        found = sliding_torques(half, ur10e_model)
    except HesrError:  # refused, which is as good
        return
    expected = sliding_torques(whole, ur10e_model)
    np.testing.assert_allclose(found, expected, rtol=0.03)
