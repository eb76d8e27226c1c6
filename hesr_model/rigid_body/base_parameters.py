"""Base parameters: independent columns of the regressor."""

from collections.abc import Sequence

import numpy as np
import scipy

from hesr_model.errors import RobotError
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask

_RANK_TOLERANCE = 1e-8
_RANDOM_STATES = 300
# Springs replace no mass: their columns are chosen after those of masses.
_SPRING_LENGTH_FACTOR = 1e3


def base_columns(robot: Robot, known_indices: Sequence[int] = ()) -> tuple[int, ...]:
    """Return indices of a largest set of independent columns, by pivoted QR at random states.

    Columns that are `known_indices` are in none.
    """
    columns = sample_regressor(robot)
    columns[:, list(known_indices)] = 0.0
    lengths = np.linalg.norm(columns, axis=0)
    # Round-off must not be scaled up to a full column.
    columns[:, lengths < _RANK_TOLERANCE * np.max(lengths)] = 0.0
    lengths[lengths == 0.0] = 1.0
    lengths[robot.inertial :] *= _SPRING_LENGTH_FACTOR
    _, r, order = scipy.linalg.qr(columns / lengths, mode="economic", pivoting=True)
    sizes = np.abs(np.diag(r))
    rank = int(np.sum(sizes > _RANK_TOLERANCE * sizes[0]))
    return tuple(sorted(int(k) for k in order[:rank]))


def known_columns(robot: Robot) -> list[int]:
    """Return the indices of the parameters that the robot file lists as known."""
    names = robot.parameter_names[: robot.inertial]
    for name in robot.description.known or ():
        if name not in names:
            raise RobotError(
                f"key 'known' of robot '{robot.name}' contains '{name}'; the parameters are "
                f"{', '.join(names)}."
            )
    return [names.index(name) for name in robot.description.known or ()]


def unknown_columns(robot: Robot, *, rotors: bool = False) -> tuple[int, ...]:
    """Return a largest set of independent unknown columns; `rotors` add those behind gears."""
    known_indices = known_columns(robot)
    rotor_columns = set[int]()
    if rotors:
        rotor_columns = set(range(10 * robot.links, robot.inertial))
    independent = {*base_columns(robot, [*known_indices, *rotor_columns]), *rotor_columns}
    return tuple(sorted(independent - set(known_indices)))


def dependence(robot: Robot, base: tuple[int, ...]) -> Array:
    """Return K (len(base), P), which maps all onto base parameters: Y = Y_b K."""
    columns = sample_regressor(robot)
    return np.asarray(np.linalg.lstsq(columns[:, list(base)], columns, rcond=None)[0], dtype=float)


def find_independent_offsets(robot: Robot, base: tuple[int, ...]) -> Mask:
    """Return whether constant torques are independent of `base`, as with a vertical weight."""
    columns = sample_regressor(robot)[:, list(base)]
    coupling = robot.description.coupling
    unit_torques = np.eye(robot.n)
    if coupling is not None:
        unit_torques = coupling.forward.T
    constant = np.tile(unit_torques, (_RANDOM_STATES, 1)) / np.sqrt(_RANDOM_STATES)
    residual = constant - columns @ np.linalg.lstsq(columns, constant, rcond=None)[0]
    return np.asarray(np.linalg.norm(residual, axis=0) > np.sqrt(_RANK_TOLERANCE))


def sample_regressor(robot: Robot) -> Array:
    """Return the regressor at random states, (samples * n, P)."""
    rng = np.random.default_rng(0)
    lower, upper, speed = robot.reach
    shape = (_RANDOM_STATES, robot.n)
    q = rng.uniform(lower, upper, shape)
    dq = rng.uniform(-speed, speed, shape)
    ddq = rng.uniform(-2 * speed, 2 * speed, shape)
    return robot.regressor(q, dq, ddq).reshape(-1, len(robot.parameter_names))
