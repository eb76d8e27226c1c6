"""Checks of results: impossible bodies, laws without effect or at a bound."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from hesr_model.findings import Finding, of_joint
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.lugre import STATIC_RATIO_BOUNDS
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, all_at_friction
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

CHECKS = ("mass-matrix", "negative-friction", "no-better-than-nothing", "bound", "other-robot")
_STATES = 60
_NOTHING = 0.95  # error over deviation of a law that explains nothing
_AT_BOUND = 0.01
_NEGATIVE = 0.5  # negative Coulomb friction over the residual


def check_body(body: RigidBody, model: Robot) -> Iterator[Finding]:
    """Check that a mass matrix is positive definite and friction brakes."""
    joints = model.description.joints
    lowest, q, joint = _least_inertia(body, model)
    if lowest <= 0.0:
        at = f"{lowest:.2g}, for instance at q = {', '.join(f'{value:.2f}' for value in q)}"
        found = f"the identified mass matrix is not positive definite (eigenvalue {at})"
        remedy = "the identified masses are not physically possible; use longer or faster logs, or "
        yield of_joint("mass-matrix", joints[joint], found, f"{remedy}--physical", "warning")
    for name, (coulomb, _, _), rmse in zip(joints, body.friction, body.rmse, strict=True):
        if -coulomb > _NEGATIVE * rmse:
            found = f"its Coulomb friction is identified as {coulomb:.3g} N.m"
            remedy = "torque or velocity count backwards, or lag each other"
            yield of_joint("negative-friction", name, found, remedy, "warning")


def _least_inertia(body: RigidBody, model: Robot) -> tuple[float, Array, int]:
    lower, upper, _ = model.reach
    q = np.random.default_rng(0).uniform(lower, upper, (_STATES, model.n))
    mass, _ = model.dynamics(body.parameters, q, np.zeros_like(q))
    mass = 0.5 * (mass + mass.transpose(0, 2, 1))
    scale = np.sqrt(np.maximum(np.abs(np.mean(np.diagonal(mass, axis1=1, axis2=2), axis=0)), 1e-12))
    values, vectors = np.linalg.eigh(mass / np.outer(scale, scale))
    state = int(np.argmin(values[:, 0]))
    return float(values[state, 0]), q[state], int(np.argmax(np.abs(vectors[state, :, 0])))


def check_laws(
    models: Mapping[str, FrictionModel], records: Sequence[Sequence[FrictionRecord]]
) -> Iterator[Finding]:
    """Check laws fitted to records [joint][log]."""
    records = all_at_friction(records)
    for name, model in models.items():
        for j, joint in enumerate(model.joints):
            deviation = float(np.std(np.concatenate([record.tau for record in records[j]])))
            if len(model.training_rmse) and model.training_rmse[j] >= _NOTHING * deviation:
                found = (
                    f"the error of the law {name}, {model.training_rmse[j]:.3g}, is no "
                    f"smaller than friction itself, {deviation:.3g}"
                )
                remedy = "the torque contains no friction to be fitted; see 'hesr inspect'"
                yield of_joint("no-better-than-nothing", joint, found, remedy, "warning")
            values = model.laws[j].values
            if {"F_c", "F_s"} <= set(values) and values["F_c"] != 0:
                ratio = values["F_s"] / values["F_c"]
                for bound in STATIC_RATIO_BOUNDS:
                    if abs(np.log(max(ratio, 1e-9) / bound)) < _AT_BOUND:
                        found = f"F_s / F_c of the law {name} hit its limit ({ratio:.3g})"
                        remedy = "the logs do not determine it; record slow motion and standstill"
                        yield of_joint("bound", joint, found, remedy, "warning")


def check_owner(model: FrictionModel, robot: Robot) -> Iterator[Finding]:
    """Check that a law belongs to the robot."""
    own = robot.description
    if model.robot != own.name and model.joints == own.joints:  # else refused elsewhere
        found = (
            f"the law {model.law} was fitted to '{model.robot}' and is evaluated on '{own.name}'"
        )
        yield of_joint("other-robot", "", found, "one of the files is of another robot", "warning")
