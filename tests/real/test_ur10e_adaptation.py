"""A law of other days, adapted to seconds of a new day of the UR10e."""

from pathlib import Path

import numpy as np
import pytest

from hesr_model.audit.certificate import certify
from hesr_model.errors import FitError
from hesr_model.fitting.days import adapt, build_prior
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription

Records = list[list[FrictionRecord]]  # [joint][log]


def records(logs: list[Log], robot: Robot, body: RigidBody) -> Records:
    of_logs = [friction_records(log, robot, body) for log in logs]
    return [list(of_joint) for of_joint in zip(*of_logs, strict=True)]


def first(log: Log, seconds: float) -> Log:
    return log.rows(log.t - log.t[0] <= seconds)


def fitted(of_joints: Records) -> FrictionModel:
    return fit_models(["parfam_s"], of_joints, robot="ur10e", seed=0)["parfam_s"]


def errors(model: FrictionModel, of_joints: Records) -> np.ndarray:
    """RMSE by joint [N.m] with a causal velocity."""
    rows = [r[0].causal for r in of_joints]
    return np.sqrt(np.mean((model.predict(rows) - np.stack([r.tau for r in rows], 1)) ** 2, axis=0))


def mean(ratios: np.ndarray) -> float:
    return float(np.exp(np.mean(np.log(ratios))))


@pytest.mark.ci
def test_half_a_minute_of_work_keeps_what_other_days_know(
    id_logs: list[Log], unseen_logs: list[Log], ur10e_model: Robot
) -> None:
    """The full fit is that to all training logs, 100 s of excitation; tested on Fourier motions."""
    *fourier, work = unseen_logs
    body = identify(id_logs, ur10e_model)
    full = fitted(records(id_logs, ur10e_model, body))
    seconds = records([first(work, 30.0)], ur10e_model, body)
    model, _ = adapt(build_prior([full]), seconds)
    unseen = [records([log], ur10e_model, body) for log in fourier]
    own, best, alone = (
        np.concatenate([errors(one, log) for log in unseen])
        for one in (model, full, fitted(seconds))
    )
    assert mean(own / best) <= 1.10
    assert mean(own / alone) <= 0.80


@pytest.mark.ci
def test_logs_that_do_not_determine_a_law_are_refused(
    ur10e_data: Path, ur10e: RobotDescription, id_logs: list[Log], ur10e_model: Robot
) -> None:
    files = [ur10e_data / f"friction_sine_joint{k}.csv" for k in range(1, 7)]
    heads = [first(Log.read(file, ur10e), 5.5) for file in files]
    body = identify(id_logs, ur10e_model)
    with pytest.raises(FitError, match="torque does not determine the law"):
        fitted(records(heads, ur10e_model, body))


@pytest.mark.ci
def test_seconds_of_a_new_day_suffice_with_a_prior_of_other_days(
    id_logs: list[Log], unseen_logs: list[Log], ur10e_model: Robot
) -> None:
    new, *earlier = id_logs  # of three days; the first unseen log is of the new one
    body = identify(earlier, ur10e_model)
    prior = build_prior([fitted(records(earlier, ur10e_model, body))])
    unseen = records(unseen_logs[:1], ur10e_model, body)
    full = errors(fitted(records([new], ur10e_model, body)), unseen)
    adapted = {}
    for seconds in (10.0, 30.0):
        model, _ = adapt(prior, records([first(new, seconds)], ur10e_model, body))
        adapted[seconds] = errors(model, unseen)
        assert mean(adapted[seconds] / full) <= 1.05
        assert np.max(adapted[seconds] / full) <= 1.10
        for law, trained in zip(model.laws, prior.trained, strict=True):
            assert certify(law, trained).verdict == "proven"
    short = first(new, 10.0)
    own = identify([short], ur10e_model)
    alone = fitted(records([short], ur10e_model, own))
    errors_alone = errors(alone, records(unseen_logs[:1], ur10e_model, own))
    assert mean(adapted[10.0] / errors_alone) <= 0.8
