"""Projection of friction laws on the numbers that simulators have, and what it costs.

A simulator's joint has Coulomb friction F and damping b:

    tau = F sign(dq) + b dq,    F >= 0, b >= 0

Both are least squares of the law's torque over the moving rows of logs, at the loads and speeds of
these rows. They are never the law's own coefficients, which hold together with its other terms.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from hesr_model.errors import ExportError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.records import rmse
from hesr_model.friction.servo import JointServo
from hesr_model.logs.signals import moving
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import find_resting_speed
from hesr_model.support.arrays import Array, Mask

Weight = Literal["rows", "power"]
"""Weight of a moving row: the same for all, or its speed, which keeps the dissipated energy."""

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
    spread : lowest and highest RMSE [N.m] of the numbers in a log, such as that of a day or of a
        specimen; None of one log.
    """

    law_rmse: float
    rmse: float
    lost_variance: float
    energy: float
    speeds: tuple[float, float]
    loads: tuple[float, float]
    spread: tuple[float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class PositionPrice:
    """What the numbers of a joint cost in positions under a servo.

    Attributes
    ----------
    kp : gain of the servo [N.m/rad].
    law, numbers, in_mujoco : RMSE of positions with the law, with the numbers as dry friction, and
        with them in MuJoCo's soft form [rad; m], infinite if that is unstable.
    is_measured : whether errors are those from measured positions, or from those under the law.
    """

    kp: float
    law: float
    numbers: float
    in_mujoco: float
    is_measured: bool


@dataclass(frozen=True, kw_only=True)
class ReducedJoint:
    """The numbers of a joint.

    Attributes
    ----------
    name : of the joint.
    frictionloss : Coulomb friction F [N.m].
    damping : b [N.m.s/rad].
    armature : inertia of the rotor at the joint [kg.m2]; None if the body does not separate it
        from that of the link.
    sliding : whether the units are those of a prismatic joint.
    inertia : mean inertia at the joint over the logs, with its rotor [kg.m2].
    price : cost of the reduction.
    servo : fitted with the law; None for laws of torques.
    positions : cost in positions; None without a servo.
    """

    name: str
    frictionloss: float
    damping: float
    armature: float | None
    sliding: bool
    inertia: float
    price: Price
    servo: JointServo | None = None
    positions: PositionPrice | None = None


@dataclass(frozen=True, kw_only=True)
class _MovingRows:
    """Rows with motion of one joint in all logs, with measured friction and that of its law.

    `log` (N,) is the name of the log of each row.
    """

    log: NDArray[np.str_]
    dq: Array
    tau_load: Array
    tau: Array
    tau_law: Array


def reduce_model(
    model: FrictionModel,
    training: LogRecords,
    tests: LogRecords | None,
    body: RigidBody | None,
    inertias: Sequence[float],
    weight: Weight = "rows",
) -> list[ReducedJoint]:
    """Return the numbers of each joint from `training`, and their price on `tests`.

    Raises ExportError if a joint does not move, or its law does not oppose its motion.

    Parameters
    ----------
    model : laws of the joints.
    training, tests : measured friction of each joint in each log; without tests, the price is
        that on the training.
    body : body with the inertias of the rotors, if it is known.
    inertias : mean inertia at each joint [kg.m2].
    weight : weight of a row in the projection.
    """
    training_rows = list(_find_moving_rows(model, training))
    test_rows = training_rows
    if tests is not None:
        test_rows = list(_find_moving_rows(model, tests))
    joints = []
    for j, rows in enumerate(training_rows):
        frictionloss, damping = project(rows.dq, rows.tau_law, weight)
        if frictionloss == 0.0 and damping == 0.0:
            raise ExportError(
                f"joint '{model.joints[j]}': its law does not oppose motion in these logs, so that "
                "Coulomb friction and damping cannot replace it."
            )
        joint = ReducedJoint(
            name=model.joints[j],
            frictionloss=frictionloss,
            damping=damping,
            armature=_find_armature(body, model.joints[j]),
            sliding=model.slides[j],
            inertia=inertias[j],
            price=_compute_price(test_rows[j], frictionloss, damping),
        )
        joints.append(joint)
    return joints


def project(dq: Array, tau: Array, weight: Weight) -> tuple[float, float]:
    """Return Coulomb friction [N.m] and damping [N.m.s/rad] nearest to a torque.

    The residual of least squares is orthogonal to the velocity, so that the dissipated energy is
    kept where the damping is positive; weighed by speed, it is always kept. Without damping,
    Coulomb friction alone is that of the same energy.

    Parameters
    ----------
    dq, tau : velocity (N,) [rad/s] of moving rows, and the law's torque (N,) [N.m].
    weight : weight of a row.
    """
    columns = np.stack([np.sign(dq), dq], axis=1)
    scale = np.max(np.abs(columns), axis=0)
    root_weights = np.ones(len(dq))
    if weight == "power":
        root_weights = np.sqrt(np.abs(dq))
    unknowns, _ = nnls(root_weights[:, None] * columns / scale, root_weights * tau)
    frictionloss, damping = unknowns / scale
    if damping == 0.0:
        frictionloss = max(0.0, float(tau @ dq) / float(np.sum(np.abs(dq))))
    return float(frictionloss), float(damping)


def _find_moving_rows(model: FrictionModel, records: LogRecords) -> Iterator[_MovingRows]:
    """Yield the moving rows of all logs, joint by joint."""
    torques = [model.predict(log_records) for log_records in records]
    for j, joint in enumerate(model.joints):
        joint_records = [log_records[j] for log_records in records]
        law_torques = [torque[:, j] for torque in torques]
        yield _select_moving_rows(joint, joint_records, law_torques)


def _select_moving_rows(
    joint: str, joint_records: Sequence[FrictionRecord], law_torques: Sequence[Array]
) -> _MovingRows:
    """Return the moving rows of one joint in all logs, with the torques (N,) of its law."""
    resting_speed = find_resting_speed(joint_records)
    is_moving = [moving(record.dq, resting_speed) for record in joint_records]
    moving_counts = [np.count_nonzero(mask) for mask in is_moving]
    if not any(moving_counts):
        log_names = ", ".join(record.log for record in joint_records)
        raise ExportError(
            f"joint '{joint}': it stands still in {log_names}; add logs in which it moves."
        )
    return _MovingRows(
        log=np.repeat([record.log for record in joint_records], moving_counts),
        dq=_join([record.dq for record in joint_records], is_moving),
        tau_load=_join([record.tau_load for record in joint_records], is_moving),
        tau=_join([record.tau for record in joint_records], is_moving),
        tau_law=_join(law_torques, is_moving),
    )


def _join(columns: Sequence[Array], rows: Sequence[Mask]) -> Array:
    """Return the given rows of all logs as one column."""
    return np.concatenate([column[mask] for column, mask in zip(columns, rows, strict=True)])


def _compute_price(rows: _MovingRows, frictionloss: float, damping: float) -> Price:
    tau_reduced = frictionloss * np.sign(rows.dq) + damping * rows.dq
    law_error = rows.tau_law - rows.tau
    error = tau_reduced - rows.tau
    variance = float(np.var(rows.tau))
    log_rmses = [rmse(error[rows.log == log]) for log in np.unique(rows.log)]
    spread = None
    if len(log_rmses) > 1:
        spread = (min(log_rmses), max(log_rmses))
    return Price(
        law_rmse=rmse(law_error),
        rmse=rmse(error),
        lost_variance=(float(np.var(error)) - float(np.var(law_error))) / variance,
        energy=float(tau_reduced @ rows.dq) / float(rows.tau_law @ rows.dq),
        speeds=(float(np.min(np.abs(rows.dq))), float(np.max(np.abs(rows.dq)))),
        loads=(float(np.min(rows.tau_load)), float(np.max(rows.tau_load))),
        spread=spread,
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
    if is_separate and armature > 0.0:
        return armature
    return None
