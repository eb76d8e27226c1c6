"""Torque constants of a measured UR10e; a known payload confirms the stated ones."""

import numpy as np
import pytest

from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth
from hesr_model.rigid_body.torque_constants import torque_constants
from hesr_model.robots.robot import Robot


@pytest.mark.parametrize("mass_error", [0.1, 0.2])
def test_the_model_masses_give_two_of_six(
    mass_error: float, id_logs: list[Log], ur10e_model: Robot
) -> None:
    stated = ur10e_model.description.log.torque_per_ampere
    assert stated
    # As if none were stated.
    gains = np.array([1.0, 5.0, 20.0, 3.0, 30.0, 10.0])
    motions = [
        smooth(
            log.__class__(name=log.name, t=log.t, q=log.q, dq=log.dq, tau=log.tau / stated * gains)
        )
        for log in id_logs
    ]
    found = torque_constants(motions, ur10e_model, gains, mass_error=mass_error)
    assert [c.determined for c in found] == [False, True, True, False, False, False]
    assert found[1].value == pytest.approx(stated[1], rel=0.1)
    assert found[2].value == pytest.approx(stated[2], rel=0.2)
    for constant, true in zip(found[1:3], stated[1:3], strict=True):
        assert abs(constant.value - true) < 2.5 * constant.error
