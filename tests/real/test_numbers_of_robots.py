"""Numbers for simulators of measured robots: as good as the best, with true prices."""

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest
from documents import ROOT
from scipy.optimize import minimize

import hesr
from cosim.study.steps import Job
from cosim.study.study import Study
from hesr.extras.reduction.projection import project
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import rmse
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smooth_logs
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import find_resting_speed, motion_records
from hesr_model.robots.robot import Robot

Array = np.ndarray

LAWS = ("stribeck", "lugre", "lugre_load", "parfam_v", "parfam_s")
STUDIES = {
    "ur10": ROOT / "models" / "ur10" / "study.toml",
    "panda": ROOT / "tests" / "real" / "panda_study.toml",
    "tiago": ROOT / "tests" / "real" / "tiago_study.toml",
    "tx40": ROOT / "tests" / "real" / "tx40_study.toml",
}

WITHOUT_TORQUE = {"tiago": 3}
"""Number of last joints whose currents carry no usable torque, as the study says."""


class Fitted(NamedTuple):
    """Laws of a robot, and the logs that they were fitted to and are judged on."""

    robot: Robot
    body: RigidBody
    training: list[Log]
    tests: list[Log]
    records: list[list[FrictionRecord]]  # [log][joint], of the fit
    models: dict[str, FrictionModel]


@cache
def fit_robot(name: str) -> Fitted:
    path = STUDIES[name]
    study = Study.read(path)
    job = Job(study=study, path=path, progress=lambda *_: None)
    files = job.log_files(path.parent)
    if not all(file.is_file() for file in files.values()):
        pytest.skip("needs the logs in ../shared/data")
    robot = Robot(job.robot)
    logs = {log: job.read(log, file) for log, file in files.items()}
    body, _ = job.rigid_body(logs, robot)
    training = [logs[log] for log in study.logs.training]
    records = [motion_records(motion, robot, body) for motion in smooth_logs(training, robot)]
    models = fit_models(
        LAWS,
        [list(of_joint) for of_joint in zip(*records, strict=True)],
        robot=robot.name,
        seed=0,
        report_left_out=lambda *_: None,
    )
    tests = [log for name, log in logs.items() if name not in job.trained_on]
    return Fitted(robot, body, training, tests, records, models)


def find_moving(records: list[list[FrictionRecord]], j: int) -> list[Array]:
    of_joint = [log_records[j] for log_records in records]
    limit = find_resting_speed(of_joint)
    return [np.abs(record.dq) > limit for record in of_joint]


def join(columns: list[Array], masks: list[Array]) -> Array:
    return np.concatenate([column[mask] for column, mask in zip(columns, masks, strict=True)])


def search_numbers(dq: Array, tau: Array) -> float:
    """Return the least RMSE of Coulomb friction and damping, by a search."""
    scale = np.array([1.0, float(np.std(dq))])

    def compute_error(unknowns: Array) -> float:
        frictionloss, damping = unknowns / scale
        return float(np.mean((frictionloss * np.sign(dq) + damping * dq - tau) ** 2))

    start = np.full(2, 0.5 * np.std(tau))
    bounds = [(0.0, None), (0.0, None)]
    options = {"xatol": 1e-6, "fatol": 1e-9}
    found = minimize(compute_error, start, method="Nelder-Mead", bounds=bounds, options=options)
    return float(np.sqrt(found.fun))


@pytest.mark.parametrize("name", list(STUDIES))
@pytest.mark.parametrize("weight", ["rows", "power"])
def test_numbers_of_good_laws_are_as_good_as_the_best(name: str, weight: str) -> None:
    """Of each law within 10 % of the best on its joint: 3 % of searched numbers, 1 % of energy."""
    fitted = fit_robot(name)
    count = 0
    for model in fitted.models.values():
        torques = [model.predict(log_records) for log_records in fitted.records]
        usable = model.joints[: fitted.robot.n - WITHOUT_TORQUE.get(name, 0)]
        for j, joint in enumerate(usable):
            best = min(other.training_rmse[j] for other in fitted.models.values())
            if model.training_rmse[j] > 1.1 * best:
                continue
            count += 1
            masks = find_moving(fitted.records, j)
            dq = join([log_records[j].dq for log_records in fitted.records], masks)
            tau = join([log_records[j].tau for log_records in fitted.records], masks)
            tau_law = join([torque[:, j] for torque in torques], masks)
            frictionloss, damping = project(dq, tau_law, weight)
            numbers = frictionloss * np.sign(dq) + damping * dq
            ratio = rmse(numbers - tau) / search_numbers(dq, tau)
            energy = (numbers @ dq) / (tau_law @ dq)
            assert weight == "power" or ratio <= 1.03, (model.law, joint)
            assert energy == pytest.approx(1.0, abs=0.01), (model.law, joint)
    assert count >= len(usable)


def read_mujoco_torque(path: Path, joint: str) -> Callable[[Array], Array]:
    """Return MuJoCo's friction torque over the speed of a joint with the class of a file."""
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="0 0 0"/><include file="{path.name}"/><worldbody><body>
        <inertial pos="0 0 0" mass="10" diaginertia="10 10 10"/><joint class="{joint}"/></body>
        </worldbody></mujoco>""",
        {path.name: path.read_bytes()},
    )
    data = mujoco.MjData(model)

    def compute_torque(speeds: Array) -> Array:
        torques = []
        for speed in speeds:
            data.qvel[0] = speed
            data.qacc[0] = 0.0
            mujoco.mj_inverse(model, data)
            torques.append(data.qfrc_inverse[0])
        return np.array(torques)

    return compute_torque


@pytest.mark.parametrize("name", list(STUDIES))
def test_the_price_is_that_of_the_torques_of_mujoco(name: str, tmp_path: Path) -> None:
    """MuJoCo's own friction at the speeds of the test, from the written file."""
    fitted = fit_robot(name)
    model = fitted.models["stribeck"]
    path = tmp_path / "numbers.xml"
    hesr.export(
        model,
        path,
        format="mjcf-joint",
        robot=fitted.robot,
        rigid_body=fitted.body,
        log=fitted.training,
        test_log=fitted.tests,
    )
    comments = path.read_text(encoding="utf-8")
    ET.fromstring(comments)
    parts = [part for log in fitted.tests for part in log.parts()]
    records = [model.records(part, rigid_body=fitted.body, robot=fitted.robot) for part in parts]
    for j, joint in enumerate(model.joints):
        masks = find_moving(records, j)
        dq = join([log_records[j].dq for log_records in records], masks)
        tau = join([log_records[j].tau for log_records in records], masks)
        [printed] = re.findall(rf"{re.escape(joint)}: \S+ and (\S+) N", comments)
        error = read_mujoco_torque(path, joint)(dq) - tau
        assert rmse(error) == pytest.approx(float(printed), rel=2e-3)
