"""Projection of friction laws on the numbers that simulators have, and what it costs.

A simulator's joint has Coulomb friction F and damping b:

    tau = F sign(dq) + b dq,    F >= 0, b >= 0

Both are least squares of the law's torque over the moving rows of logs, at the loads and speeds of
these rows. They are never the law's own coefficients: those hold beside the law's other terms.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import nnls

from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import rmse
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.arrays import Array, Mask

Weight = Literal["rows", "power"]
"""What the projection weighs: each moving row alike, or by its speed, which keeps the energy."""

LogRecords = Sequence[Sequence[FrictionRecord]]  # [log][joint]


@dataclass(frozen=True, kw_only=True)
class Price:
    """What the numbers of a joint cost against its law, over moving rows of logs.

    Attributes
    ----------
    law_rmse, rmse : RMSE [N.m] of the law and of the numbers against the measured friction.
    lost_variance : share of the variance of the measured friction that the law explains, and the
        numbers do not.
    energy : energy that the numbers dissipate over that of the law.
    speeds : lowest and highest speed of the rows [rad/s].
    loads : lowest and highest rigid-body torque of the rows [N.m].
    """

    law_rmse: float
    rmse: float
    lost_variance: float
    energy: float
    speeds: tuple[float, float]
    loads: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ReducedJoint:
    """The numbers of a joint.

    Attributes
    ----------
    name : of the joint.
    frictionloss : Coulomb friction F [N.m].
    damping : b [N.m.s/rad].
    armature : inertia of the rotor at the joint [kg.m2]; None if it is not visible beside that of
        the link.
    sliding : whether the units are those of a prismatic joint.
    inertia : what the joint moves in the mean of the logs, with its rotor [kg.m2].
    price : cost of the reduction.
    """

    name: str
    frictionloss: float
    damping: float
    armature: float | None
    sliding: bool
    inertia: float
    price: Price


@dataclass(frozen=True, kw_only=True)
class _MovingRows:
    """Rows of all logs in which a joint moves, with measured friction and that of its law."""

    dq: Array
    tau_load: Array
    tau: Array
    tau_law: Array


def reduce_model(
    model: FrictionModel,
    training: LogRecords,
    tests: LogRecords,
    body: RigidBody | None,
    inertias: Sequence[float],
    weight: Weight = "rows",
) -> list[ReducedJoint]:
    """Return the numbers of each joint from `training`, and their price on `tests`.

    Parameters
    ----------
    model : laws of the joints.
    training, tests : measured friction of each joint in each log.
    body : body with the inertias of the rotors, if it is known.
    inertias : what each joint moves in the mean [kg.m2].
    weight : what the projection weighs.
    """
    all_rows = zip(_find_moving_rows(model, training), _find_moving_rows(model, tests), strict=True)
    joints = []
    for j, (training_rows, test_rows) in enumerate(all_rows):
        frictionloss, damping = project(training_rows.dq, training_rows.tau_law, weight)
        joint = ReducedJoint(
            name=model.joints[j],
            frictionloss=frictionloss,
            damping=damping,
            armature=_find_armature(body, model.joints[j]),
            sliding=model.slides[j],
            inertia=inertias[j],
            price=_compute_price(test_rows, frictionloss, damping),
        )
        joints.append(joint)
    return joints


def project(dq: Array, tau: Array, weight: Weight) -> tuple[float, float]:
    """Return Coulomb friction [N.m] and damping [N.m.s/rad] nearest to a torque.

    The residual of least squares is orthogonal to the velocity, so that the dissipated energy is
    kept where the damping is positive; weighed by speed, it is always kept.

    Parameters
    ----------
    dq, tau : velocity (N,) [rad/s] of moving rows, and the law's torque (N,) [N.m].
    weight : what the projection weighs.
    """
    columns = np.stack([np.sign(dq), dq], axis=1)
    scale = np.max(np.abs(columns), axis=0)
    root_weights = np.sqrt(np.abs(dq)) if weight == "power" else np.ones(len(dq))
    unknowns, _ = nnls(root_weights[:, None] * columns / scale, root_weights * tau)
    frictionloss, damping = unknowns / scale
    return float(frictionloss), float(damping)


def _find_moving_rows(model: FrictionModel, records: LogRecords) -> Iterator[_MovingRows]:
    """Yield the rows of all logs in which each joint moves, joint by joint."""
    torques = [model.predict(log_records) for log_records in records]
    for j in range(len(model.joints)):
        joint_records = [log_records[j] for log_records in records]
        resting_speed = find_resting_speed(joint_records)
        moving: list[Mask] = [np.abs(record.dq) > resting_speed for record in joint_records]
        yield _MovingRows(
            dq=_join([record.dq for record in joint_records], moving),
            tau_load=_join([record.tau_load for record in joint_records], moving),
            tau=_join([record.tau for record in joint_records], moving),
            tau_law=_join([torque[:, j] for torque in torques], moving),
        )


def _join(columns: Sequence[Array], rows: Sequence[Mask]) -> Array:
    """Return the given rows of all logs as one column."""
    return np.concatenate([column[mask] for column, mask in zip(columns, rows, strict=True)])


def _compute_price(rows: _MovingRows, frictionloss: float, damping: float) -> Price:
    tau_reduced = frictionloss * np.sign(rows.dq) + damping * rows.dq
    law_error = rows.tau_law - rows.tau
    error = tau_reduced - rows.tau
    variance = float(np.var(rows.tau))
    return Price(
        law_rmse=rmse(law_error),
        rmse=rmse(error),
        lost_variance=(float(np.var(error)) - float(np.var(law_error))) / variance,
        energy=float(tau_reduced @ rows.dq) / float(rows.tau_law @ rows.dq),
        speeds=(float(np.min(np.abs(rows.dq))), float(np.max(np.abs(rows.dq)))),
        loads=(float(np.min(rows.tau_load)), float(np.max(rows.tau_load))),
    )


def _find_armature(body: RigidBody | None, joint: str) -> float | None:
    """Return the inertia of a rotor [kg.m2] if the body separates it from that of the link."""
    if body is None:
        return None
    name = f"{joint}.Ir"
    if name not in body.names:
        return None
    k = body.names.index(name)
    is_separate = k in body.base or body.kind != "free"
    armature = float(body.parameters[k])
    return armature if is_separate and armature > 0.0 else None
