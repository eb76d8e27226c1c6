"""Replaying a log through an FMU."""

import numpy as np
import pytest

from fmu_src import model_file
from fmu_src.friction.replay import replay, require_finite
from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict


@pytest.fixture(scope="module")
def log():
    t = 0.005 * np.arange(12_000)
    return t, np.column_stack([np.sin(t), np.cos(2 * t), -np.sin(3 * t)])


def test_replay_equals_the_prediction_of_the_model(friction_fmu, log):
    t, dq = log
    torque = replay(friction_fmu, t, dq)
    for i, law in enumerate(FrictionModel.read(model_file("uf850-table1")).laws):
        expected = predict(law, t=t, dq=dq[:, i])
        assert np.abs(torque[:, i] - expected).max() <= 1e-12 * np.abs(expected).max()


def test_the_first_sample_is_read_before_any_step(friction_fmu, log):
    t, dq = log
    both = replay(friction_fmu, t[:2], dq[:2])
    np.testing.assert_array_equal(replay(friction_fmu, t[:1], dq[:1]), both[:1])


def test_start_values_are_set(friction_fmu, log):
    t, dq = (x[:50] for x in log)
    start = {"start_mode": 2, "h_start[1]": 0.9, "joint[2].c_0": 1.0}
    assert not np.allclose(replay(friction_fmu, t, dq, start=start), replay(friction_fmu, t, dq))


def test_unsuitable_logs_are_refused(friction_fmu, log):
    t, dq = (x[:50] for x in log)
    with pytest.raises(SimulationError, match=r"'dq' has the shape \(50, 2\); expected \(50, 3\)"):
        replay(friction_fmu, t, dq[:, :2])
    with pytest.raises(SimulationError, match="'q' has the shape"):
        replay(friction_fmu, t, dq, q=dq[:-1])
    with pytest.raises(SimulationError, match="increase at row 20"):
        replay(friction_fmu, np.where(np.arange(50) == 20, t[19], t), dq)
    with pytest.raises(SimulationError, match="log to be replayed"):
        replay(friction_fmu, [], np.zeros((0, 3)))


def test_missing_values_are_reported_with_their_time(friction_fmu, log):
    t, dq = (x[:50].copy() for x in log)
    dq[30, 1] = np.nan
    with pytest.raises(SimulationError, match=r"at t = 0\.145 s: fmi2SetReal: dq\[2\] is nan"):
        replay(friction_fmu, t, dq)


def test_torques_that_are_not_finite_are_reported(friction_fmu):
    torque = np.zeros((4, 3))
    torque[2, 1] = np.inf
    with pytest.raises(SimulationError, match=r"t = 0\.2 s tau\[2\] is not"):
        require_finite(friction_fmu, np.arange(4) / 10.0, torque)
