"""Mistakes in a robot file that explain the torques better than the file as it is.

Each is a supposition with corrected rows. Weights of the model file's rigid body and friction are
non-negative, so wrong signs and swapped columns fit badly. The best one races against the file as
it is, on left-out rows, and must not move a joint beyond its limits.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from hesr_model.fitting.joint_rows import ROUND_OFF, non_negative_least_squares
from hesr_model.health.evidence import ModelTorques, SmoothPart, friction_shape
from hesr_model.health.positions import MAX_EXCESS_SHARE
from hesr_model.health.referee import CURE_GAIN, Hypothesis, LeftOutRows, Race
from hesr_model.health.torque import find_sign_change
from hesr_model.logs.log_format import OPTIONAL, LogUnits, column_names
from hesr_model.robots.robot import Robot
from hesr_model.robots.transmission import transform_motion
from hesr_model.support.arrays import Array, Mask
from hesr_model.units import REVOLUTE_UNITS

_MAX_UNEXPLAINED_SHARE = 0.8  # largest unexplained share of a torque that shows gravity
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_EARTH_GRAVITY = 9.81
_SNAP_ANGLE = np.radians(12.0)
_BACKWARDS = "its torque counts backwards"
_MIN_TILT = np.radians(20.0)
_MIN_GRAVITY_SHARE = 0.2  # of the declared gravity, below which the torques show none


@dataclass(frozen=True, kw_only=True, eq=False)
class SupposedRows:
    """Rows of several logs under a supposition.

    Attributes
    ----------
    q, v, a : (N, n) positions [rad, m] and their derivatives.
    tau : (N, n) torques [N.m, N] at the side that the log measures, motors over gear ratios.
    gravity : (3,) [m/s^2].
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    gravity: Array


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake that the file may have.

    Attributes
    ----------
    check : name of the finding.
    joint : index of the joint, -1 for all.
    remedy : what is wrong, in words.
    changes : values by key of the robot file that mend it.
    corrected : rows as they are with these changes.
    """

    check: str
    joint: int
    remedy: str
    changes: dict[str, object]
    corrected: SupposedRows


def compute_torques(rows: SupposedRows, robot: Robot) -> ModelTorques:
    """Evaluate the model under the rows' gravity."""
    torques = ModelTorques.from_motion(robot, rows.q, rows.v, rows.a)
    declared_gravity = robot.gravity
    if np.array_equal(declared_gravity, rows.gravity):
        return torques
    torque_change = np.einsum(
        "kij,k->ij", _compute_axis_torques(rows.q, robot), rows.gravity - declared_gravity
    )
    return replace(torques, gravity=torques.gravity + torque_change - torque_change.mean(axis=0))


def _compute_axis_torques(q: Array, robot: Robot) -> Array:
    """Return torques (3, N, n) of unit gravity along each axis."""
    zeros = np.zeros_like(q)
    parameters = robot.nominal_parameters.copy()
    parameters[robot.inertial :] = 0.0
    with robot.under_gravity() as set_gravity:
        axis_torques = []
        for axis in _AXES.values():
            set_gravity(axis)
            axis_torques.append(robot.torque(parameters, q, zeros, zeros))
    return np.array(axis_torques)


def generate_mistakes(rows: SupposedRows, robot: Robot, is_moving: Mask) -> Iterator[Mistake]:
    """Yield possible mistakes, the simplest first."""
    description = robot.description
    joints = [int(j) for j in np.flatnonzero(is_moving)]
    if len(joints) > 1:
        changes = find_sign_change(description, None, position=False)
        corrected = replace(rows, tau=-rows.tau)
        yield Mistake("torque-sign", -1, "all torques count backwards", changes, corrected)
    for j in joints:
        changes = find_sign_change(description, j, position=False)
        position_changes = find_sign_change(description, j, position=True)
        signs = np.diag(np.where(np.arange(robot.n) == j, -1.0, 1.0))
        corrected = _mix_torque_columns(rows, robot, signs)
        yield Mistake("torque-sign", j, _BACKWARDS, changes, corrected)
        remedy = "its position and velocity count backwards"
        corrected = _mix_motion_columns(rows, robot, signs)
        yield Mistake("position-sign", j, remedy, position_changes, corrected)
        remedy = "its position, velocity and torque count backwards"
        corrected = _mix_torque_columns(corrected, robot, signs)
        yield Mistake("position-sign", j, remedy, position_changes | changes, corrected)
    # Of two that explain alike the first is the simpler one: a joint's zero is easily a quarter
    # turn off, but half a turn is rather the gravity of a robot that hangs.
    yield from _suppose_angle_units(rows, robot)
    yield from _swap_torques(rows, robot, joints)
    yield from _swap_joints(rows, robot, joints)
    yield from _move_zeros(rows, robot, joints, quarters=(1, -1))
    yield from _estimate_gravity(rows, robot, joints)
    yield from _move_zeros(rows, robot, joints, quarters=(2,))


def _mix_motion_columns(rows: SupposedRows, robot: Robot, mixing: Array) -> SupposedRows:
    """Return rows whose columns of motion, as the log has them, are mixed.

    Units, gears, coupled motors and zeros belong to places, not to what a column holds.

    Parameters
    ----------
    rows : as read.
    robot : with the description that reads columns.
    mixing : (n, n) of new columns over those of the log.
    """
    description = robot.description
    to_logged = np.eye(robot.n)
    if description.logged is not None:
        to_logged = description.logged.forward
    scales = description.log.units.factors("q", robot.n) / _find_gear_ratios(robot)
    to_columns = to_logged / scales[:, None]
    change = np.linalg.solve(to_columns, mixing @ to_columns).T
    zero = np.array(description.log.zero or 0.0)
    return replace(rows, q=(rows.q - zero) @ change + zero, v=rows.v @ change, a=rows.a @ change)


def _mix_torque_columns(rows: SupposedRows, robot: Robot, mixing: Array) -> SupposedRows:
    """Return rows whose columns of torque or current are mixed; see `_mix_motion_columns`."""
    log_format = robot.description.log
    gains = log_format.torque_per_ampere
    gear_ratios = _find_gear_ratios(robot)
    if gains is None:
        scales = log_format.units.factors("tau", robot.n) * gear_ratios
    else:
        scales = log_format.units.factors("current", robot.n) * gear_ratios * np.array(gains)
    return replace(rows, tau=rows.tau / scales @ mixing.T * scales)


def _find_gear_ratios(robot: Robot) -> Array:
    """Return turns (n,) of what the log measures per turn of logged coordinates."""
    transmission = robot.description.transmission
    if robot.description.logged is None or transmission is None:
        return np.ones(robot.n)
    return transmission.ratios


def _suppose_angle_units(rows: SupposedRows, robot: Robot) -> Iterator[Mistake]:
    """Yield other units of angles, which models without limits cannot contradict."""
    log_format = robot.description.log
    is_rotary = ~np.array(robot.slides)
    quantities = ["q"]
    if log_format.columns.dq:
        quantities.append("dq")
    for quantity in quantities:
        joint_units = np.array(log_format.units.expand_per_joint(quantity, robot.n), dtype=object)
        if np.any(joint_units[is_rotary] != getattr(LogUnits(), quantity)):
            return
    if not np.any(is_rotary):
        return
    zero = np.array(log_format.zero or 0.0)
    for unit in ("deg", "rev"):
        names = {"q": unit, "dq": f"{unit}/s"}
        changes: dict[str, object] = {}
        for quantity in quantities:
            units: str | tuple[str | float, ...] = names[quantity]
            if not is_rotary.all():
                units = log_format.units.replace_units(
                    quantity, is_rotary.tolist(), names[quantity]
                )
            changes[f"log.units.{quantity}"] = units
        sizes = np.where(is_rotary, REVOLUTE_UNITS["q"][unit], 1.0)
        corrected = replace(
            rows, q=(rows.q - zero) * sizes + zero, v=rows.v * sizes, a=rows.a * sizes
        )
        yield Mistake("angle-unit", -1, f"angles are in {unit}", changes, corrected)


def _swap_torques(rows: SupposedRows, robot: Robot, joints: list[int]) -> Iterator[Mistake]:
    description = robot.description
    column_key = "current"
    if description.log.torque_per_ampere is None:
        column_key = "tau"
    columns = column_names(getattr(description.log.columns, column_key), description.joints)
    for a, b in combinations(joints, 2):
        order = _swap_order(robot.n, a, b)
        swapped_columns = tuple(columns[k] for k in order)
        changes: dict[str, object] = {f"log.columns.{column_key}": swapped_columns}
        remedy = f"its torque is swapped with that of joint '{description.joints[b]}'"
        corrected = _mix_torque_columns(rows, robot, np.eye(robot.n)[order])
        yield Mistake("torque-columns", a, remedy, changes, corrected)


def _swap_joints(rows: SupposedRows, robot: Robot, joints: list[int]) -> Iterator[Mistake]:
    description = robot.description
    for a, b in combinations(joints, 2):
        remedy = f"its columns are swapped with those of joint '{description.joints[b]}'"
        yield _reorder_joints(rows, robot, a, remedy, _swap_order(robot.n, a, b))
    if len(joints) == robot.n > 2:
        indices = list(range(robot.n))
        backwards = indices[::-1]
        one_later = [*indices[1:], indices[0]]
        one_earlier = [indices[-1], *indices[:-1]]
        remedy = "the columns are in another order than the joints"
        for order in (backwards, one_later, one_earlier):
            yield _reorder_joints(rows, robot, -1, remedy, order)


def _reorder_joints(
    rows: SupposedRows, robot: Robot, j: int, remedy: str, order: Sequence[int]
) -> Mistake:
    """Return the mistake of a joint (-1: all) whose motion and torque are in other columns.

    `order` has the column of the log that belongs to each joint.
    """
    description = robot.description
    changes: dict[str, object] = {}
    for key, pattern in description.log.columns:
        if key == "t" or not pattern or pattern == OPTIONAL.get(key):
            continue
        columns = column_names(pattern, description.joints)
        changes[f"log.columns.{key}"] = tuple(columns[k] for k in order)
    mixing = np.eye(robot.n)[order]
    corrected = _mix_torque_columns(_mix_motion_columns(rows, robot, mixing), robot, mixing)
    return Mistake("joint-order", j, remedy, changes, corrected)


def _move_zeros(
    rows: SupposedRows, robot: Robot, joints: list[int], quarters: Sequence[int]
) -> Iterator[Mistake]:
    description = robot.description
    for j in joints:
        if robot.slides[j]:
            continue
        for quarter in quarters:
            zero = list(description.log.zero or (0.0,) * robot.n)
            zero[j] += quarter * np.pi / 2.0
            q = rows.q.copy()
            q[:, j] += quarter * np.pi / 2.0
            remedy = f"its zero is {90 * quarter} degrees from the model's"
            yield Mistake("zero", j, remedy, {"log.zero": tuple(zero)}, replace(rows, q=q))


def _estimate_gravity(rows: SupposedRows, robot: Robot, joints: list[int]) -> Iterator[Mistake]:
    """Yield the gravity that explains the torques best, if it points elsewhere than declared."""
    estimate = _fit_gravity(rows, robot, joints)
    if estimate is None:
        return
    declared_gravity = robot.gravity
    gravity_size = float(np.linalg.norm(declared_gravity)) or _EARTH_GRAVITY
    estimated_size = np.linalg.norm(estimate)
    if not estimated_size > _MIN_GRAVITY_SHARE * gravity_size:
        return
    direction = _snap_to_axis(estimate / estimated_size)
    cosine = direction @ declared_gravity / gravity_size
    if cosine > np.cos(_MIN_TILT):
        return
    # Adding 0 turns -0 into 0.
    gravity = tuple(round(float(g), 3) + 0.0 for g in gravity_size * direction)
    if not np.any(declared_gravity):
        mismatch = "as none"
    elif cosine < -np.cos(_MIN_TILT):
        mismatch = "upside down"
    else:
        mismatch = "from another side"
    remedy = f"gravity is declared {mismatch}"
    corrected = replace(rows, gravity=np.array(gravity))
    yield Mistake("gravity", -1, remedy, {"gravity": gravity}, corrected)


def _fit_gravity(rows: SupposedRows, robot: Robot, joints: list[int]) -> Array | None:
    """Return the gravity (3,) [m/s^2] of a fit to the torques of joints that show it, or None.

    tau_j = sum_k tau_jk g_k + a_j inertial_j + b_j friction_j + c_j, with one g for all joints.
    """
    torques_by_axis = _compute_axis_torques(rows.q, robot)
    inertial = compute_torques(rows, robot).inertial
    v = rows.v
    logged_coupling = robot.description.logged
    if logged_coupling is not None:
        torques_by_axis = np.array(
            [logged_coupling.torque(axis_torques) for axis_torques in torques_by_axis]
        )
        inertial = logged_coupling.torque(inertial)
        v = logged_coupling.motion(v)
    row_blocks = []
    targets = []
    for place, j in enumerate(joints):
        joint_columns = [inertial[:, j], friction_shape(v[:, j]), np.ones(len(v))]
        columns = np.column_stack([*torques_by_axis[:, :, j], *joint_columns])
        tau = rows.tau[:, j]
        residual_std = float(np.std(tau - columns @ np.linalg.lstsq(columns, tau, rcond=None)[0]))
        if residual_std > _MAX_UNEXPLAINED_SHARE * np.std(tau):
            continue
        # Gravity is common to all joints; the other coefficients are those of this one.
        block = np.zeros((len(tau), 3 + 3 * len(joints)))
        block[:, :3] = columns[:, :3]
        block[:, 3 + 3 * place : 6 + 3 * place] = columns[:, 3:]
        # An exact fit must not outweigh all others.
        noise = max(residual_std, ROUND_OFF * float(np.std(tau)), 1e-300)
        row_blocks.append(block / noise)
        targets.append(tau / noise)
    if not row_blocks:
        return None
    table = np.concatenate(row_blocks)
    return np.asarray(np.linalg.lstsq(table, np.concatenate(targets), rcond=None)[0][:3])


def _snap_to_axis(direction: Array) -> Array:
    """Return the axis close to a direction (3,), or the direction: mountings are rarely oblique."""
    snapped = direction
    for axis in _AXES.values():
        for sign in (1.0, -1.0):
            if snapped @ np.array(axis) * sign > np.cos(_SNAP_ANGLE):
                snapped = sign * np.array(axis)
    return snapped


def _swap_order(n: int, a: int, b: int) -> list[int]:
    order = list(range(n))
    order[a], order[b] = b, a
    return order


_MAX_ROWS = 450  # total
_MAX_GRAVITY_FACTOR = 10.0  # of the model's gravity; real arms have 0.6 to 1.5
_MIN_GAIN = 2.0  # minimum gain of a corrected joint
_MAX_LOSS = 1.25  # largest loss of other joints
_MIN_R2 = 0.6  # minimum R^2 after the correction
_MIN_GAIN_OVER_SIMPLER = 1.05  # minimum gain over a simpler mistake
_MAX_MISTAKES = 8  # mistakes searched one after another
_MAX_NAMED_RIVALS = 2  # which suffice to doubt a mistake


def pool_rows(parts: Sequence[SmoothPart], gravity: Sequence[float]) -> SupposedRows:
    """Take equally many rows from each log."""
    thinned_parts = _thin_parts(parts)
    return SupposedRows(
        q=np.concatenate([part.q for part in thinned_parts]),
        v=np.concatenate([part.v for part in thinned_parts]),
        a=np.concatenate([part.a for part in thinned_parts]),
        tau=np.concatenate([part.tau for part in thinned_parts]),
        gravity=np.array(gravity, dtype=float),
    )


def _thin_parts(parts: Sequence[SmoothPart]) -> list[SmoothPart]:
    return [part.thin(max(_MAX_ROWS // len(parts), 60)) for part in parts]


def check_causes(parts: Sequence[SmoothPart], robot: Robot) -> list[Hypothesis]:
    """Suppose the mistakes that explain all logs best, the best first."""
    if not parts:
        return []
    is_moving = np.any([part.is_moving for part in parts], axis=0)
    is_moving &= np.any([np.ptp(part.tau, axis=0) > 0.0 for part in parts], axis=0)
    rows = pool_rows(parts, robot.gravity.tolist())
    thinned_parts = _thin_parts(parts)
    left_out = LeftOutRows.split(
        [part.log.name for part in thinned_parts], [part.t for part in thinned_parts]
    )
    logged_coupling = robot.description.logged
    if logged_coupling:
        rows = replace(rows, tau=logged_coupling.torque(rows.tau))
    log_names = tuple(dict.fromkeys(part.log.name for part in parts))
    hypotheses: list[Hypothesis] = []
    share_before = _compute_unexplained_share(rows, robot, is_moving)
    for _ in range(_MAX_MISTAKES):
        mistake, share_after = _find_best_mistake(rows, share_before, robot, is_moving)
        if mistake is None:
            break
        hypothesis = _suppose(mistake, rows, robot, left_out, share_before, share_after)
        hypotheses.append(replace(hypothesis, logs=log_names))
        if hypothesis.outcome != "won":
            break
        rows = mistake.corrected
        share_before = share_after
    joint_beyond = _find_joint_beyond_limits(rows.q, robot)
    if joint_beyond is None:
        return hypotheses
    return _doubt_robot(hypotheses, joint_beyond)


def _suppose(
    mistake: Mistake,
    rows: SupposedRows,
    robot: Robot,
    left_out: LeftOutRows,
    share_before: Array,
    share_after: Array,
) -> Hypothesis:
    """Return the hypothesis of a mistake, which races on the joint that it explains best."""
    best_joint = int(np.argmax(share_before / share_after))
    race = Race(
        rival="the file as it is",
        rival_squares=_predict_squares(rows, robot, left_out, best_joint),
        squares=_predict_squares(mistake.corrected, robot, left_out, best_joint),
        min_gain=CURE_GAIN,
    )
    joint = ""
    if mistake.joint >= 0:
        joint = robot.joints[mistake.joint]
    return Hypothesis(
        check=mistake.check,
        joint=joint,
        observation=f"model and friction leave {100 * share_before[best_joint]:.0f} % of the "
        f"torque of joint '{robot.joints[best_joint]}' unexplained; with the correction "
        f"{100 * share_after[best_joint]:.0f} %",
        remedy=mistake.remedy,
        trials=(race,),
        record="motion of this joint through the whole of its range",
        changes=mistake.changes,
    )


def _predict_squares(rows: SupposedRows, robot: Robot, left_out: LeftOutRows, j: int) -> Array:
    """Return squared errors (N,) of a joint's torque on left-out rows, over its variance."""
    torques, v = _transform(rows, robot)
    tau = rows.tau[:, j]
    columns = _build_columns(tau, torques, v, j)
    errors = left_out.predict(columns, tau, non_negative=3)
    # A correction may change the torque itself.
    return np.asarray(errors**2 / max(float(np.var(tau)), 1e-300))


_GEOMETRIC_CHECKS = ("zero", "gravity", "joint-order", "position-sign")


def _doubt_robot(hypotheses: Sequence[Hypothesis], joint_beyond: str) -> list[Hypothesis]:
    """Return hypotheses of another robot instead of those that a limit contradicts.

    The torques contradict the model as it is, and the limits each correction of its geometry.

    Parameters
    ----------
    hypotheses : of mistakes that were found one after another.
    joint_beyond : joint that lies beyond its limits with the corrections of all that won.
    """
    contradiction = (
        f"joint '{joint_beyond}' would still lie beyond its limits; the log may be of another robot"
    )
    doubted = []
    for hypothesis in hypotheses:
        if hypothesis.check not in _GEOMETRIC_CHECKS:
            doubted.append(hypothesis)
            continue
        other_robot = replace(
            hypothesis,
            check="other-robot",
            observation=f"{hypothesis.observation} ({hypothesis.remedy}), but joint "
            f"'{joint_beyond}' then still lies beyond its limits",
            remedy="the log may be of another robot; state the model of the robot that was logged",
            changes={},
        )
        contradicted = replace(
            hypothesis, contradictions=(*hypothesis.contradictions, contradiction)
        )
        doubted += [other_robot, contradicted]
    return doubted


def _find_joint_beyond_limits(q: Array, robot: Robot) -> str | None:
    """Return the first joint whose positions (N, n) exceed its limits by more than usual."""
    is_beyond = _compute_excess_shares(q, robot) > MAX_EXCESS_SHARE
    if not np.any(is_beyond):
        return None
    return robot.joints[int(np.argmax(is_beyond))]


def _find_best_mistake(
    rows: SupposedRows, share_before: Array, robot: Robot, is_moving: Mask
) -> tuple[Mistake | None, Array]:
    best_mistake = None
    best_share = share_before
    best_gain = 0.0
    rivals: list[Mistake] = []
    largest_excess = _compute_limit_excess(rows.q, robot)
    for mistake in generate_mistakes(rows, robot, is_moving):
        if _compute_limit_excess(mistake.corrected.q, robot) > largest_excess + MAX_EXCESS_SHARE:
            continue
        share_after = _compute_unexplained_share(mistake.corrected, robot, is_moving)
        gain = np.log(share_before / share_after)
        is_explained = (gain > np.log(_MIN_GAIN)) & (1.0 - share_after**2 > _MIN_R2)
        if not np.any(is_explained) or np.min(gain) < -np.log(_MAX_LOSS):
            continue
        if mistake.check == "angle-unit" and _exceeds_gravity(
            mistake.corrected, robot, int(np.argmax(gain))
        ):
            continue
        if float(gain.sum()) > best_gain * _MIN_GAIN_OVER_SIMPLER:
            best_mistake = mistake
            best_share = share_after
            best_gain = float(gain.sum())
            rivals = []
        elif best_mistake and float(gain.sum()) * _MIN_GAIN_OVER_SIMPLER > best_gain:
            rivals.append(mistake)
    if best_mistake is None:
        return None, best_share
    first_mistake, *rivals = _keep_limits([best_mistake, *rivals], robot)
    if first_mistake is not best_mistake:
        best_share = _compute_unexplained_share(first_mistake.corrected, robot, is_moving)
    remedy = _add_rivals(first_mistake, rivals, robot)
    return replace(first_mistake, remedy=remedy), best_share


def _keep_limits(mistakes: Sequence[Mistake], robot: Robot) -> list[Mistake]:
    """Return the mistakes without which positions exceed limits; all if that decides nothing.

    They explain the torques alike: a correction that leaves a joint beyond its limits leaves a
    contradiction that another one removes.
    """
    within_limits = [
        mistake
        for mistake in mistakes
        if _compute_limit_excess(mistake.corrected.q, robot) <= MAX_EXCESS_SHARE
    ]
    return within_limits or list(mistakes)


def _add_rivals(mistake: Mistake, rivals: Sequence[Mistake], robot: Robot) -> str:
    """Return the remedy of a mistake, and those that explain the torques as well."""
    if not rivals:
        return mistake.remedy
    rival_remedies = []
    for rival in rivals[:_MAX_NAMED_RIVALS]:
        is_of_other_joint = rival.joint >= 0 and rival.joint != mistake.joint
        place = f" (joint '{robot.joints[rival.joint]}')" if is_of_other_joint else ""
        rival_remedies.append(f"or {rival.remedy}{place}")
    doubt = ", ".join(rival_remedies)
    return f"{mistake.remedy}, {doubt}; the logs cannot show which"


def _exceeds_gravity(rows: SupposedRows, robot: Robot, j: int) -> bool:
    """Return whether a joint's torque would have many times the gravity of the model.

    Positions in a smaller unit leave so little of it that a free factor explains any torque.
    """
    torques, v = _transform(rows, robot)
    tau = rows.tau[:, j]
    columns = _build_columns(tau, torques, v, j)
    coefficients, _ = non_negative_least_squares(columns, tau, non_negative=3)
    return bool(coefficients[0] > _MAX_GRAVITY_FACTOR)


def _compute_limit_excess(q: Array, robot: Robot) -> float:
    """Return the largest excess of positions (N, n) over the limits, as a share of their width."""
    return float(np.max(_compute_excess_shares(q, robot), initial=0.0))


def _compute_excess_shares(q: Array, robot: Robot) -> Array:
    """Return by how much positions (N, n) exceed limits (n,), as a share of their width."""
    lower, upper, _ = robot.limits
    excess = np.max(np.maximum(lower - q, q - upper), axis=0, initial=0.0)
    width = upper - lower
    return np.where(np.isfinite(width), excess / np.maximum(width, 1e-300), 0.0)


def _compute_unexplained_share(rows: SupposedRows, robot: Robot, is_moving: Mask) -> Array:
    """Return the unexplained share (n,) of the torques' deviation."""
    torques, v = _transform(rows, robot)
    shares = np.ones(rows.q.shape[1])
    for j in np.flatnonzero(is_moving):
        tau = rows.tau[:, j]
        residual_rms = _compute_residual_rms(tau, torques, v, int(j))
        deviation = max(float(np.std(tau)), 1e-300)
        # Exact fits differ by round-off, which is no gain.
        shares[j] = residual_rms / deviation + ROUND_OFF
    return shares


def _transform(rows: SupposedRows, robot: Robot) -> tuple[ModelTorques, Array]:
    """Return the model's torques and the velocities (N, n) at the side that the log measures."""
    torques = compute_torques(rows, robot)
    logged_coupling = robot.description.logged
    if logged_coupling is not None:
        torques = torques.transform(logged_coupling)
    return torques, transform_motion(logged_coupling, rows.v)


def _build_columns(tau: Array, torques: ModelTorques, v: Array, j: int) -> Array:
    """Return gravity, inertial torque and friction of a joint, and an offset (N, 4)."""
    model_columns = np.column_stack([torques.gravity[:, j], torques.inertial[:, j]])
    # A torque of round-off must not be scaled up to explain noise.
    model_columns[:, np.abs(model_columns).max(axis=0) <= ROUND_OFF * np.abs(tau).max()] = 0.0
    return np.column_stack([model_columns, friction_shape(v[:, j]), np.ones(len(tau))])


def _compute_residual_rms(tau: Array, torques: ModelTorques, v: Array, j: int) -> float:
    columns = _build_columns(tau, torques, v, j)
    _, squares = non_negative_least_squares(columns, tau, non_negative=3)
    return float(np.sqrt(max(squares, 0.0) / len(tau)))
