"""Physical consistency on measured logs: better with one short log, no loss with long ones."""

from collections.abc import Sequence

import numpy as np
import pytest
from test_ur10e_rigid_body import static_errors

from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.physical import pseudo_inertia
from hesr_model.robots.robot import Robot


def ratios(train: Sequence[Log], test: Sequence[Log], model: Robot) -> np.ndarray:
    """Error on `test` of the consistent fit over that of the free fit, per joint."""
    free, consistent = (
        static_errors(train, test, model, identify(train, model, physical=physical))
        for physical in (False, True)
    )
    return consistent / free


def test_one_log_of_20_s_improves_by_a_tenth(id_logs: list[Log], ur10e_model: Robot) -> None:
    found = ratios([id_logs[2]], id_logs[:2], ur10e_model)
    assert np.all(found < 1.0)
    assert np.exp(np.mean(np.log(found))) < 0.90
    assert np.all(found[[0, 2, 3]] < [0.85, 0.75, 0.90])


@pytest.mark.parametrize("left_out", [1, 2])
def test_two_longer_logs_lose_nothing(
    left_out: int, id_logs: list[Log], ur10e_model: Robot
) -> None:
    train = [log for k, log in enumerate(id_logs) if k != left_out]
    found = ratios(train, [id_logs[left_out]], ur10e_model)
    assert np.all(found < 1.01)
    assert np.exp(np.mean(np.log(found))) < 1.0


def test_every_link_is_physically_possible(id_logs: list[Log], ur10e_model: Robot) -> None:
    body = identify([id_logs[2]], ur10e_model, physical=True)
    for link in body.parameters[:60].reshape(-1, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(link))[0] > 0
    assert np.all(body.parameters[60:] >= 0)
