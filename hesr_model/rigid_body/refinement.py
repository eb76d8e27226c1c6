"""Refinement of the rigid body: identification without the torque of a fitted friction law."""

from collections.abc import Sequence
from dataclasses import replace

from hesr_model.errors import ArtifactError
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.rigid_body.choice import identify_from_logs
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot


def identify_again(
    logs: Sequence[Log],
    robot: Robot,
    body: RigidBody,
    model: FrictionModel,
    *,
    reversed_logs: Sequence[Log] = (),
) -> RigidBody:
    """Identify a rigid body of the same kind without the torque of `model`, fitted with `body`."""
    joints = tuple(robot.description.joints)
    if model.joints != joints:
        raise ArtifactError(
            f"friction model '{model.law}' is for the joints {', '.join(model.joints)}; the "
            f"robot has {', '.join(joints)}."
        )

    def without_friction(log: Log) -> Log:
        log_records = friction_records(log, robot, body)
        return replace(log, tau=log.tau - model.predict(log_records))

    logs, reversed_parts = (
        list(map(without_friction, collect_parts(log_group))) for log_group in (logs, reversed_logs)
    )
    refined_body = identify_from_logs(logs, robot, body.kind, reversed_logs=reversed_parts)
    # The law is that of both sides of a gear, whose own friction would be left out.
    return replace(refined_body, gears=body.gears, sentence=body.sentence)
