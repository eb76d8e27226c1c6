"""What a log leaves out: the sign of a torque, the position, or other speeds."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from hesr_model.health.evidence import ModelTorques, SmoothPart
from hesr_model.health.referee import Hypothesis, LeftOutRows, Race
from hesr_model.logs.log_format import LogColumns, column_names
from hesr_model.logs.rest import moves_both_ways
from hesr_model.logs.strokes import find_single_speeds
from hesr_model.robots.robot import RobotDescription
from hesr_model.support.arrays import Array

_MIN_GAIN = 0.02  # sizes of Coulomb friction differ from a constant near reversals only
_KNEE_SHARES = (0.003, 0.01, 0.03, 0.1)  # speeds, over the peak, up to which friction rises
_ROUNDS = 8  # after which the signs of a torque do not change any more
_SIGN_QUANTILES = (0.01, 0.99)
_MIN_GRAVITY_SHARE = 0.01  # of the torque, above which the zero of a position matters


def check_signs(
    part: SmoothPart, torques: ModelTorques | None, description: RobotDescription
) -> Iterator[Hypothesis]:
    """Try the size of a torque for torques that have one sign while the joint moves both ways."""
    split = LeftOutRows.split([part.log.name], [part.t])
    for j in np.flatnonzero(part.is_moving & (np.ptp(part.tau, axis=0) > 0.0)):
        tau = part.tau[:, j]
        resting_speed = part.find_resting_speed(int(j))
        v = part.v[:, j]
        reverses = v.min() < -resting_speed and v.max() > resting_speed
        lowest, highest = np.quantile(tau, _SIGN_QUANTILES)  # noise may pass 0
        if not reverses or lowest < 0.0 < highest:
            continue
        size = np.abs(tau)
        # How fast friction reverses is unknown, and a size shows little else of Coulomb friction.
        candidates = [
            _build_columns(part, torques, int(j), knee_share) for knee_share in _KNEE_SHARES
        ]
        signed_squares = min(
            (split.predict(columns, size) ** 2 for columns in candidates), key=np.sum
        )
        size_squares = min(
            (_predict_size(split, columns, size, v) ** 2 for columns in candidates), key=np.sum
        )
        rivals = {
            "a torque with its sign": signed_squares,
            "a constant": (size - np.mean(size)) ** 2,
        }
        remedy = "HESR needs the sign; log the torque or the current as the drive measures it"
        changes: dict[str, Any] = {}
        if part.log.q_cmd is not None:
            remedy = "friction follows from commands and positions instead"
            changes = _name_current_size(description)
        yield Hypothesis(
            check="torque-unsigned",
            joint=description.joints[j],
            observation="its torque has no sign: it never changes it, though the joint moves both "
            "ways, and its size follows friction and motion",
            remedy=remedy,
            changes=changes,
            trials=tuple(
                Race(
                    rival=rival,
                    rival_squares=rival_squares,
                    squares=size_squares,
                    min_gain=_MIN_GAIN,
                )
                for rival, rival_squares in rivals.items()
            ),
            record="slow motion both ways",
        )


def _name_current_size(description: RobotDescription) -> dict[str, Any]:
    """Return changes by which the columns of the torque are a current without a sign."""
    log_format = description.log
    quantity = "current"
    if log_format.torque_per_ampere is None:
        quantity = "tau"
    names = column_names(getattr(log_format.columns, quantity), description.joints)
    changes: dict[str, Any] = {
        "log.columns.current_size": tuple(names),
        f"log.columns.{quantity}": getattr(LogColumns(), quantity),
    }
    if description.sources.torque_per_ampere == "guessed":
        changes["log.torque_per_ampere"] = None
        changes["sources.torque_per_ampere"] = "not stated"
    return changes


def _build_columns(
    part: SmoothPart, torques: ModelTorques | None, j: int, knee_share: float
) -> Array:
    """Return columns (N, K) that explain the torque of a joint, of its model if there is one."""
    v = part.v[:, j]
    inertial = part.a[:, j]
    gravity = np.zeros(len(v))
    if torques is not None:
        inertial = torques.inertial[:, j]
        gravity = torques.gravity[:, j]
    peak = float(np.max(np.abs(v))) or 1.0
    # Coulomb and viscous friction, each with a coefficient: sizes tell them apart.
    friction = [np.tanh(v / (knee_share * peak)), v / peak]
    columns = np.column_stack([gravity, inertial, *friction, np.ones(len(v))])
    return np.asarray(columns[:, np.any(columns != 0.0, axis=0)])


def _predict_size(split: LeftOutRows, columns: Array, size: Array, v: Array) -> Array:
    """Return errors (N,) of the size of a torque, whose signs are those of its prediction.

    The signs begin as those of friction; each fold then alternates between fit and signs.
    """
    errors = np.array(size)
    for judged, trained in zip(split.judged, split.trained, strict=True):
        if np.count_nonzero(trained) <= columns.shape[1] or not judged.any():
            continue
        signs = np.sign(v[trained])
        for _ in range(_ROUNDS):
            coefficients = np.linalg.lstsq(columns[trained], signs * size[trained], rcond=None)[0]
            new_signs = np.sign(columns[trained] @ coefficients)
            if np.array_equal(new_signs, signs):
                break
            signs = new_signs
        errors[judged] -= np.abs(columns[judged] @ coefficients)
    return errors


def check_integral(
    part: SmoothPart, torques: ModelTorques | None, description: RobotDescription
) -> Iterator[Hypothesis]:
    """Say that positions are integrals, an error where gravity depends on their unknown start."""
    if description.log.columns.q:
        return
    for j in np.flatnonzero(part.is_moving):
        observation = "its position is not logged; it is the integral of its velocity from 0"
        gravity = 0.0
        if torques is not None:
            gravity = float(np.std(torques.gravity[:, j]))
        needs_start = gravity > _MIN_GRAVITY_SHARE * float(np.std(part.tau[:, j]))
        if needs_start:
            yield Hypothesis(
                check="position-integral",
                joint=description.joints[j],
                observation=observation,
                remedy="its gravity torque depends on where it starts; log its position",
            )
        else:
            yield Hypothesis(
                check="position-integral",
                joint=description.joints[j],
                observation=observation,
                remedy="what depends on the angle is not learned",
                severity="warning",
            )


def doubt_one_speed(
    joint: str,
    unit: str,
    times: Sequence[Array],
    velocities: Sequence[Array],
    resting_speed: float,
) -> Iterator[Hypothesis]:
    """Say that one speed shows the sum of Coulomb and viscous friction only.

    A speed for each direction is no more: an offset takes their difference.

    Parameters
    ----------
    joint : its name.
    unit : of its speed.
    times, velocities : of its logs, (N,) each.
    resting_speed : up to which it rests.
    """
    usual_speeds = find_single_speeds(times, velocities, resting_speed)
    if not usual_speeds:
        return
    speed_text = " and ".join(f"{speed:.2g} {unit}" for speed in usual_speeds)
    yield Hypothesis(
        check="one-speed",
        joint=joint,
        observation=f"its friction at {speed_text} is the sum of Coulomb and viscous friction",
        remedy="",
        contradictions=("it moves at one speed in each direction, which cannot separate them",),
        record="motion at several speeds",
    )


def doubt_direction(
    joint: str, positions: Sequence[Array], logs: Sequence[str] = ()
) -> Iterator[Hypothesis]:
    """Say that motion one way does not separate Coulomb friction from an offset.

    Parameters
    ----------
    joint : its name.
    positions : measured positions (N,) [rad, m] of the logs or parts in which it moves.
    logs : their names.
    """
    if not positions or any(moves_both_ways(q) for q in positions):
        return
    yield Hypothesis(
        check="one-way",
        joint=joint,
        observation="its torque is friction",
        remedy="",
        contradictions=("it never reverses: offset and Coulomb friction cannot be separated",),
        record="motion both ways",
        logs=tuple(dict.fromkeys(logs)),
    )
