"""External torque on a UR10e: the weight of a payload, and the width of the limits by law."""

import numpy as np
import pytest

from fmu_src.plant.dynamics import transform_parameters
from fmu_src.plant.plant_fmu import PlantBody
from hesr.extras.observer.observation import compute_limits, observe_logs
from hesr.extras.observer.observer_fmu import ObserverLimits
from hesr_model.fitting.fit import fit
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot

pytestmark = pytest.mark.ci

MASS, CENTRE = 2.805, np.array([0.0, 0.0, 0.05])  # a payload that is stated for this robot
WEIGHT = np.array([0.0, 0.0, -9.81 * MASS])


@pytest.fixture(scope="module")
def body(id_logs: list[Log], ur10e_model: Robot) -> PlantBody:
    return PlantBody.from_robot(ur10e_model, identify(id_logs, ur10e_model))


@pytest.fixture(scope="module")
def observers(
    id_logs: list[Log], unseen_logs: list[Log], ur10e_model: Robot, body: PlantBody
) -> dict[str, tuple[FrictionModel, ObserverLimits]]:
    """Laws fitted to the logs of the identification, with limits of the other logs."""
    own = identify(id_logs, ur10e_model)
    parts = [part for log in id_logs for part in log.parts()]
    records = [friction_records(part, ur10e_model, own) for part in parts]
    laws = {name: fit(name, *records, robot="ur10e") for name in ("parfam_s_load", "stribeck")}
    return {name: (law, compute_limits(law, body, unseen_logs)) for name, law in laws.items()}


def test_the_limits_are_no_wider_than_with_stribeck(
    observers: dict[str, tuple[FrictionModel, ObserverLimits]],
    unseen_logs: list[Log],
    body: PlantBody,
) -> None:
    widths = {}
    for name, (law, limits) in observers.items():
        runs = observe_logs(law, body, limits, unseen_logs)
        ends = [run.outputs["tau_ext_upper"] - run.outputs["tau_ext_lower"] for run in runs]
        widths[name] = np.concatenate(ends).mean(axis=0)
    assert np.all(widths["parfam_s_load"] <= widths["stribeck"]), widths


def test_a_payload_missing_in_the_body_appears_as_its_weight(
    observers: dict[str, tuple[FrictionModel, ObserverLimits]],
    unseen_logs: list[Log],
    body: PlantBody,
) -> None:
    law, limits = observers["parfam_s_load"]
    robot, parameters = body.robot, body.parameters.copy()
    point = np.array([MASS, *np.zeros(9)])
    parameters[10 * (robot.links - 1) : 10 * robot.links] -= transform_parameters(
        point, np.eye(3), CENTRE
    )
    log = next(one for one in unseen_logs if "ptp" in one.name)
    [run] = observe_logs(law, PlantBody(robot=robot, parameters=parameters), limits, [log])
    rest = (np.abs(run.dq).max(axis=1) < 0.002) & (run.t - run.t[0] > 1.0)
    assert rest.sum() > 20
    found = np.hstack([run.outputs["force"], run.outputs["moment"]])[rest]
    known = [
        np.concatenate([WEIGHT, np.cross(robot.places(q)[-1][0] @ CENTRE, WEIGHT)])
        for q in log.q[rest]
    ]
    errors = found - known
    force, moment, both = (
        run.outputs[f"{name}_covariance"][rest] for name in ("force", "moment", "force_moment")
    )
    covariance = np.block([[force, both], [both.transpose(0, 2, 1), moment]])
    distance = np.einsum("ni,nij,nj->n", errors, np.linalg.inv(covariance), errors)
    assert np.mean(distance < 12.6) >= 0.95  # of chi squared with six degrees of freedom
    # The weight is known far better than the limits promise, and well apart from zero.
    assert found[:, 2].mean() == pytest.approx(WEIGHT[2], rel=0.1)
    assert np.sqrt(covariance[:, 2, 2].mean()) < 0.3 * abs(WEIGHT[2])
