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

_OF_GEAR = ("stiffness", "damping", "offset", "motor_coulomb", "motor_load", "motor_viscous")
_OF_LINK = ("link_coulomb", "link_viscous")
FIXED = len(_OF_GEAR)
# Widths tried, over the largest deflection; those of softer zones are negative.
_WIDTHS = np.concatenate([2.0 ** (-0.5 * np.arange(1, 13)), -(2.0 ** -np.arange(3.0, 7.0))])
_ROUNDS = 3  # of zero, and of the torque in the load
_LEAST = 1e-3  # torque of an element over that of the gear


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


def gear_forms(motions: Sequence[Motion], robot: Robot, used: Sequence[Mask]) -> list[GearForm]:
    """Return the forms of elastic gears, low-passed as the motions; none without link encoders."""
    if not motions or any(motion.q_link is None for motion in motions):
        return []
    names = ("q", "dq", "ddq", "tau", "q_link", "dq_link")
    data = {n: np.concatenate([getattr(motion, n) for motion in motions]) for n in names}
    ends = np.cumsum([0, *(len(motion.t) for motion in motions)]).tolist()
    parts = [slice(*pair) for pair in pairwise(ends)]

    def smooth(values: Array) -> Array:
        cutoff = robot.description.log.filter_cutoff
        pairs = zip(motions, parts, strict=True)
        return np.concatenate(
            [zero_phase(motion.t, values[rows], cutoff)(motion.t) for motion, rows in pairs]
        )

    data |= {"smooth": smooth(data["tau"]), "link": smooth(np.sign(data["dq_link"]))}
    each = [{n: x[:, j] for n, x in data.items()} for j in range(robot.n)]
    return [_form(own, parts, rows, smooth) for own, rows in zip(each, used, strict=True)]


def _form(
    data: dict[str, Array],
    parts: Sequence[slice],
    used: Mask,
    smooth: Callable[[Array], Array],
) -> GearForm:
    twist = data["q"] - data["q_link"]
    rate = data["dq"] - data["dq_link"]
    zero = float(np.mean(twist[used]))
    torque = np.zeros_like(twist)
    widths = np.max(np.abs(twist[used] - zero)) * _WIDTHS
    free = np.full(FIXED + 1, np.inf)
    most = np.concatenate([free, np.where(widths > 0.0, np.inf, 0.0)])
    least = np.concatenate([-free, np.where(widths > 0.0, 0.0, -np.inf)])
    elements = np.arange(FIXED + 1, len(most))
    for _ in range(_ROUNDS):
        d = twist - zero
        sign = np.sign(data["dq"])
        shapes = [_stop(d / w, parts) if w > 0 else np.clip(-d / w, -1, 1) for w in widths]
        bent = smooth(np.column_stack([sign, np.abs(torque) * sign, *shapes]))
        ones = np.ones_like(d)
        dq = data["dq"]
        ddq = data["ddq"]
        columns = np.column_stack([d, rate, ones, bent[:, :2], dq, ddq, bent[:, 2:]])
        rows = np.column_stack([columns, data["smooth"]])[used]
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        r: Array = np.asarray(np.linalg.qr(rows / size, mode="r"))
        bounded = scipy.optimize.lsq_linear(r[:, :-1], r[:, -1], (least, most), method="bvls")
        x = bounded.x / size[:-1] * size[-1]
        elastic = [0, 1, *elements]
        torque = columns[:, elastic] @ x[elastic]
        zero += float(-x[2] / x[0])
    kept = np.abs(x[elements]) > _LEAST * np.std(torque[used])
    return GearForm(
        zero=zero,
        widths=widths[kept],
        columns=columns[:, [*range(FIXED), *elements[kept]]],
        signals=data,
    )


def _stop(x: Array, parts: Sequence[slice]) -> Array:
    steps = [np.diff(x[rows], prepend=x[rows][0]).tolist() for rows in parts]
    found = [accumulate(part, lambda s, dx: min(max(s + dx, -1.0), 1.0)) for part in steps]
    return np.array([state for part in found for state in part])


def with_gears(
    blocks: Sequence[Block],
    forms: Sequence[GearForm],
    base: tuple[int, ...],
    robot: Robot,
    links: Integers,
) -> list[Block]:
    """Return blocks with motor friction; `links` (n, 2) are the columns of each link's friction."""
    first = blocks[0].matrix.shape[1]
    places = first + np.cumsum([0, *(form.columns.shape[1] for form in forms)])
    whole = []
    motors = []
    for j, (block, form) in enumerate(zip(blocks, forms, strict=True)):
        k = block.samples
        at = places[j]
        rotor = 10 * robot.links + j
        tau, smooth, turning = (form.signals[n][k] for n in ("tau", "smooth", "ddq"))
        both, motor = np.zeros((2, len(k), places[-1]))
        both[:, :first] = block.matrix
        both[:, links[j, 0]] = form.signals["link"][k]
        both[:, at + 3 : at + FIXED] = form.columns[k, 3:FIXED]
        motor[:, at : places[j + 1]] = form.columns[k]
        whole.append(Block(matrix=both, target=block.target + smooth - tau, samples=k))
        if rotor in base:
            motor[:, base.index(rotor)] = turning
        else:
            smooth = smooth - robot.nominal_parameters[rotor] * turning
        motors.append(Block(matrix=motor, target=smooth, samples=k))
    return [*whole, *motors]


def gears_of(
    forms: Sequence[GearForm], joints: Sequence[str], x: Array, errors: Array, links: Integers
) -> tuple[ElasticGear, ...]:
    """Return the gears in the last columns of a solution `x` (P,); `links` as in `with_gears`."""
    at = len(x) - sum(form.columns.shape[1] for form in forms)
    found = []
    for joint, form, link in zip(joints, forms, links.tolist(), strict=True):
        places = dict(zip((*_OF_GEAR, *_OF_LINK), [*range(at, at + FIXED), *link], strict=True))
        del places["offset"]
        own = {n: (float(x[k]), float(errors[k])) for n, k in places.items()}
        torques = x[at + FIXED :][: len(form.widths)].tolist()
        elements = tuple(zip(form.widths.tolist(), torques, strict=True))
        found.append(ElasticGear(joint=joint, zero=form.zero, parameters=own, elements=elements))
        at += form.columns.shape[1]
    return tuple(found)
