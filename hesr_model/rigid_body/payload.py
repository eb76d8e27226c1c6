"""Payload: the ten inertial parameters of a load on the last link, from logs under load.

The regressor's columns of the last link (eq. 5) explain the additional torque::

    tau - Y pi_unloaded = Y_last pi_payload + friction

Friction has its own columns, because a load changes it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hesr_model.errors import FitError
from hesr_model.logs.robot_log import Log, require_moving
from hesr_model.logs.signals import Motion, smooth_logs
from hesr_model.rigid_body import observations
from hesr_model.rigid_body.base_parameters import dependence
from hesr_model.rigid_body.identification import RigidBody, compute_scale
from hesr_model.rigid_body.least_squares import Block, Solution, solve
from hesr_model.robots.robot import LINK_PARAMETERS, Robot
from hesr_model.support.arrays import Array, Integers

# Duration after which residuals count as independent [s]: the mass without payload is then within
# 1.1 standard errors of zero on measured logs, with single rows within 5.
_SEGMENT_DURATION = 1.0
_MIN_SEGMENTS = 10
_MIN_MASS_SIGNIFICANCE = 4.0  # mass in standard errors; twin logs without payload had 3.4


@dataclass(frozen=True, kw_only=True, eq=False)
class Payload:
    """An identified payload, with friction under load; see `RigidBody`."""

    parameters: Array  # (10,) `LINK_PARAMETERS` in the frame of the last joint [kg, kg.m, kg.m2]
    covariance: Array  # residuals correlated within a second, and errors of the unloaded body
    condition: float
    friction: Array
    rmse: Array
    rows: int
    logs: tuple[str, ...]

    @property
    def standard_errors(self) -> Array:
        """Standard errors (10,) of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.parameters[0])

    def to_dict(self) -> dict[str, Any]:
        """Return JSON data."""
        return {
            "parameters": dict(zip(LINK_PARAMETERS, self.parameters.tolist(), strict=True)),
            "standard_errors": self.standard_errors.tolist(),
            "condition": self.condition,
            "friction": self.friction.tolist(),
            "rmse": self.rmse.tolist(),
            "rows": self.rows,
            "logs": list(self.logs),
        }


def identify_payload(logs: Sequence[Log], robot: Robot, unloaded_body: RigidBody) -> Payload:
    """Identify the payload from logs; errors as `identify_payload_motions`, LogError."""
    require_moving(logs, robot.description.joints)
    return identify_payload_motions(smooth_logs(logs, robot), robot, unloaded_body)


def identify_payload_motions(
    motions: Sequence[Motion], robot: Robot, unloaded_body: RigidBody
) -> Payload:
    """Identify the payload on the last link; raises RobotError, FitError."""
    where = "log " + ", ".join(motion.name for motion in motions)
    segments = _number_segments(motions)
    if len(np.unique(segments)) < _MIN_SEGMENTS:
        seconds = sum(motion.t[-1] - motion.t[0] for motion in motions)
        raise FitError(
            f"{where}: lasts {seconds:.3g} s; a payload needs at least "
            f"{_MIN_SEGMENTS * _SEGMENT_DURATION:g} s."
        )
    payload_motions = [
        replace(motion, tau=motion.tau - unloaded_body.torque(robot, motion)) for motion in motions
    ]
    columns = _last_link_columns(robot)
    friction = observations.friction_columns(robot, columns)
    friction &= observations.find_determined_friction(payload_motions, robot)
    blocks = observations.stack_blocks(payload_motions, robot, columns, friction)
    peaks = observations.peak_speeds(payload_motions, robot)
    solution = solve(blocks, scale=compute_scale(robot, columns, friction, peaks), weighted=True)
    if solution.ridge:
        raise FitError(
            f"{where}: the motion does not determine the payload (condition number "
            f"{solution.condition:.2g}); all joints must move fast and far at once."
        )
    block_segments = [segments[block.samples] for block in blocks]
    covariance = _estimate_covariance(blocks, solution, block_segments)
    body_blocks = observations.stack_blocks(motions, robot, unloaded_body.base, friction)
    body_columns = [block.matrix[:, : len(unloaded_body.base)] for block in body_blocks]
    body_errors = unloaded_body.standard_errors
    covariance += _propagate_errors(blocks, solution, body_columns, body_errors)
    payload = Payload(
        parameters=solution.x[:10],
        covariance=covariance[:10, :10],
        condition=solution.condition,
        friction=observations.arrange_by_joint(solution.x[10:], friction),
        rmse=solution.rmse,
        rows=len(segments),
        logs=tuple(motion.name for motion in motions),
    )
    error = float(payload.standard_errors[0])
    if not payload.mass > _MIN_MASS_SIGNIFICANCE * error:
        raise FitError(
            f"{where}: no significant payload; its mass is {payload.mass:.3g} kg with a standard "
            f"error of {error:.2g} kg (at least {_MIN_MASS_SIGNIFICANCE:g} standard errors needed)."
        )
    return payload


def add_payload(unloaded_body: RigidBody, payload: Payload, robot: Robot) -> RigidBody:
    """Return the rigid body with the payload in its last link."""
    columns = list(_last_link_columns(robot))
    parameters = unloaded_body.parameters.copy()
    parameters[columns] += payload.parameters
    payload_map = dependence(robot, unloaded_body.base)[:, columns]
    payload_covariance = payload_map @ payload.covariance @ payload_map.T
    covariance = unloaded_body.covariance
    if covariance is not None:
        covariance = replace(covariance, carried=covariance.carried + payload_covariance)
    return replace(
        unloaded_body,
        parameters=parameters,
        standard_errors=np.sqrt(unloaded_body.standard_errors**2 + np.diag(payload_covariance)),
        covariance=covariance,
        kind="free" if unloaded_body.physical else unloaded_body.kind,
        friction=payload.friction,
        rmse=payload.rmse,
        rows=payload.rows,
        logs=(*unloaded_body.logs, *payload.logs),
    )


def _last_link_columns(robot: Robot) -> tuple[int, ...]:
    return tuple(range(10 * (robot.links - 1), 10 * robot.links))


def _number_segments(motions: Sequence[Motion]) -> Integers:
    parts: list[Integers] = []
    first = 0
    for motion in motions:
        parts.append(first + ((motion.t - motion.t[0]) // _SEGMENT_DURATION).astype(int))
        first = parts[-1][-1] + 1
    return np.concatenate(parts)


def _estimate_covariance(
    blocks: Sequence[Block], solution: Solution, segments: Sequence[Integers]
) -> Array:
    """Return the covariance with residuals correlated in segments (Liang and Zeger 1986)."""
    segment_count = 1 + max(int(np.max(block_segments)) for block_segments in segments)
    gradients = np.zeros((segment_count, len(solution.x)))
    for block, block_rmse, block_segments in zip(blocks, solution.rmse, segments, strict=True):
        residual = (block.target - block.matrix @ solution.x) / block_rmse**2
        np.add.at(gradients, block_segments, block.matrix * residual[:, None])
    inverse = _inverse_hessian(blocks, solution)
    finite_sample_factor = segment_count / (segment_count - 1)
    return np.asarray(inverse @ (gradients.T @ gradients) @ inverse * finite_sample_factor)


def _propagate_errors(
    blocks: Sequence[Block], solution: Solution, carried_columns: Sequence[Array], std_errors: Array
) -> Array:
    """Return the covariance due to errors of the unloaded body, whose columns are carried."""
    slopes = _inverse_hessian(blocks, solution) @ _products(blocks, solution, carried_columns)
    deviations = slopes * std_errors
    return np.asarray(deviations @ deviations.T)


def _inverse_hessian(blocks: Sequence[Block], solution: Solution) -> Array:
    matrices = [block.matrix for block in blocks]
    return np.asarray(np.linalg.inv(_products(blocks, solution, matrices)))


def _products(blocks: Sequence[Block], solution: Solution, columns: Sequence[Array]) -> Array:
    parts = zip(blocks, columns, solution.rmse, strict=True)
    products = [
        block.matrix.T @ block_columns / block_rmse**2 for block, block_columns, block_rmse in parts
    ]
    return np.asarray(np.sum(products, axis=0))
