"""Elastic gears between the encoders of motor and link, identified with the rigid body.

    tau   = I_r ddq + friction of the motor side + tau_g
    tau_g = body(q_link) + friction of the link side
          = k d + D d' + sum F_i x_i(d),    d = q - q_link - zero

An x_i is a Prandtl stop of hysteresis with F_i > 0 (Taghirad and Bélanger 1998) or, with F_i < 0,
clip(d / w_i, -1, 1): the gear is softer around zero, or has play.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
import scipy

from hesr_model.logs.signals import Motion, zero_phase
from hesr_model.rigid_body.least_squares import Block
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers, Mask

_GEAR_PARAMETERS = (
    "stiffness",
    "damping",
    "offset",
    "motor_coulomb",
    "motor_load",
    "motor_viscous",
)
_LINK_PARAMETERS = ("link_coulomb", "link_viscous")
FIXED = len(_GEAR_PARAMETERS)
# Widths tried, over the largest deflection; those of softer zones are negative.
_RELATIVE_WIDTHS = np.concatenate(
    [2.0 ** (-0.5 * np.arange(1, 13)), -(2.0 ** -np.arange(3.0, 7.0))]
)
_ROUNDS = 3  # of zero, and of the torque in the load
_MIN_TORQUE_SHARE = 1e-3  # torque of an element over that of the gear


@dataclass(frozen=True, kw_only=True)
class ElasticGear:
    """Elastic gear of a joint, and friction on both sides.

    `parameters` has value and standard error of `stiffness` [N.m/rad], `damping` [N.m.s/rad] and
    friction [N.m; 1; N.m.s/rad], (motor_coulomb + motor_load |tau_g|) sgn(dq) + motor_viscous dq of
    the motor and link_coulomb sgn(dq_link) + link_viscous dq_link of the link. `zero` [rad] is the
    difference of the encoders without torque. `elements` have width [rad], negative in softer
    zones, and torque [N.m].
    """

    joint: str
    zero: float
    parameters: dict[str, tuple[float, float]]
    elements: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class GearForm:
    """Columns (N, `FIXED` + elements) of a gear, before its fit; signals (N,) by name."""

    zero: float
    widths: Array
    columns: Array
    signals: dict[str, Array]


def gear_forms(
    motions: Sequence[Motion], robot: Robot, fast_rows: Sequence[Mask]
) -> list[GearForm]:
    """Return the forms of elastic gears, low-passed as the motions; none without link encoders."""
    if not motions or any(motion.q_link is None for motion in motions):
        return []
    signals = {}
    for name in ("q", "dq", "ddq", "tau", "q_link", "dq_link"):
        signals[name] = np.concatenate([getattr(motion, name) for motion in motions])
    ends = np.cumsum([0, *(len(motion.t) for motion in motions)]).tolist()
    parts = [slice(first, end) for first, end in pairwise(ends)]

    def smooth(values: Array) -> Array:
        cutoff = robot.description.log.filter_cutoff
        smooth_parts = []
        for motion, rows in zip(motions, parts, strict=True):
            smooth_parts.append(zero_phase(motion.t, values[rows], cutoff)(motion.t))
        return np.concatenate(smooth_parts)

    signals["smooth"] = smooth(signals["tau"])
    signals["link"] = smooth(np.sign(signals["dq_link"]))
    forms = []
    for j, is_fast in enumerate(fast_rows):
        joint_signals = {name: values[:, j] for name, values in signals.items()}
        forms.append(_fit_form(joint_signals, parts, is_fast, smooth))
    return forms


def _fit_form(
    signals: dict[str, Array],
    part_slices: Sequence[slice],
    is_fast: Mask,
    smooth: Callable[[Array], Array],
) -> GearForm:
    twist = signals["q"] - signals["q_link"]
    twist_rate = signals["dq"] - signals["dq_link"]
    zero = float(np.mean(twist[is_fast]))
    torque = np.zeros_like(twist)
    widths = np.max(np.abs(twist[is_fast] - zero)) * _RELATIVE_WIDTHS
    unbounded = np.full(FIXED + 1, np.inf)
    upper_bounds = np.concatenate([unbounded, np.where(widths > 0.0, np.inf, 0.0)])
    lower_bounds = np.concatenate([-unbounded, np.where(widths > 0.0, 0.0, -np.inf)])
    elements = np.arange(FIXED + 1, len(upper_bounds))
    for _ in range(_ROUNDS):
        deflection = twist - zero
        sign = np.sign(signals["dq"])
        shapes = [_evaluate_element(deflection, width, part_slices) for width in widths]
        smoothed = smooth(np.column_stack([sign, np.abs(torque) * sign, *shapes]))
        ones = np.ones_like(deflection)
        dq = signals["dq"]
        ddq = signals["ddq"]
        columns = np.column_stack(
            [deflection, twist_rate, ones, smoothed[:, :2], dq, ddq, smoothed[:, 2:]]
        )
        rows = np.column_stack([columns, signals["smooth"]])[is_fast]
        sizes = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        triangle: Array = np.asarray(np.linalg.qr(rows / sizes, mode="r"))
        solution = scipy.optimize.lsq_linear(
            triangle[:, :-1], triangle[:, -1], (lower_bounds, upper_bounds), method="bvls"
        )
        coefficients = solution.x / sizes[:-1] * sizes[-1]
        elastic_columns = [0, 1, *elements]
        torque = columns[:, elastic_columns] @ coefficients[elastic_columns]
        zero += float(-coefficients[2] / coefficients[0])
    is_significant = np.abs(coefficients[elements]) > _MIN_TORQUE_SHARE * np.std(torque[is_fast])
    return GearForm(
        zero=zero,
        widths=widths[is_significant],
        columns=columns[:, [*range(FIXED), *elements[is_significant]]],
        signals=signals,
    )


def _evaluate_element(deflection: Array, width: float, part_slices: Sequence[slice]) -> Array:
    """Return the shape (N,) of an element: a stop, or a clipped line for a negative width."""
    if width > 0:
        return _run_stop(deflection / width, part_slices)
    return np.clip(-deflection / width, -1, 1)


def _run_stop(relative_deflection: Array, part_slices: Sequence[slice]) -> Array:
    """Return the states (N,) of a stop with a width of 1, which begin at 0 in each part."""

    def move(state: float, step: float) -> float:
        return min(max(state + step, -1.0), 1.0)

    states: list[float] = []
    for rows in part_slices:
        part = relative_deflection[rows]
        states += accumulate(np.diff(part, prepend=part[0]).tolist(), move)
    return np.array(states)


def add_gears(
    blocks: Sequence[Block],
    forms: Sequence[GearForm],
    base: tuple[int, ...],
    robot: Robot,
    link_columns: Integers,
) -> list[Block]:
    """Return blocks with motor friction; `link_columns` (n, 2) are those of link friction."""
    body_count = blocks[0].matrix.shape[1]
    first_columns = body_count + np.cumsum([0, *(form.columns.shape[1] for form in forms)])
    body_blocks = []
    motor_blocks = []
    for j, (block, form) in enumerate(zip(blocks, forms, strict=True)):
        samples = block.samples
        first_column = first_columns[j]
        rotor_column = 10 * robot.links + j
        tau = form.signals["tau"][samples]
        smooth_tau = form.signals["smooth"][samples]
        ddq = form.signals["ddq"][samples]
        body_matrix, motor_matrix = np.zeros((2, len(samples), first_columns[-1]))
        body_matrix[:, :body_count] = block.matrix
        body_matrix[:, link_columns[j, 0]] = form.signals["link"][samples]
        body_matrix[:, first_column + 3 : first_column + FIXED] = form.columns[samples, 3:FIXED]
        motor_matrix[:, first_column : first_columns[j + 1]] = form.columns[samples]
        body_blocks.append(
            Block(matrix=body_matrix, target=block.target + smooth_tau - tau, samples=samples)
        )
        if rotor_column in base:
            motor_matrix[:, base.index(rotor_column)] = ddq
        else:
            smooth_tau = smooth_tau - robot.nominal_parameters[rotor_column] * ddq
        motor_blocks.append(Block(matrix=motor_matrix, target=smooth_tau, samples=samples))
    return [*body_blocks, *motor_blocks]


def build_gears(
    forms: Sequence[GearForm],
    joints: Sequence[str],
    x: Array,
    std_errors: Array,
    link_columns: Integers,
) -> tuple[ElasticGear, ...]:
    """Return the gears in the last columns of a solution; `link_columns` as in `add_gears`."""
    first_column = len(x) - sum(form.columns.shape[1] for form in forms)
    gears = []
    for joint, form, joint_columns in zip(joints, forms, link_columns.tolist(), strict=True):
        names = (*_GEAR_PARAMETERS, *_LINK_PARAMETERS)
        columns = (*range(first_column, first_column + FIXED), *joint_columns)
        columns_by_name = dict(zip(names, columns, strict=True))
        del columns_by_name["offset"]
        parameters = {
            name: (float(x[k]), float(std_errors[k])) for name, k in columns_by_name.items()
        }
        torques = x[first_column + FIXED :][: len(form.widths)].tolist()
        elements = tuple(zip(form.widths.tolist(), torques, strict=True))
        gears.append(
            ElasticGear(joint=joint, zero=form.zero, parameters=parameters, elements=elements)
        )
        first_column += form.columns.shape[1]
    return tuple(gears)
