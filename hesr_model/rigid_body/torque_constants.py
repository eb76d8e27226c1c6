"""Torque constants of motors, from the masses of the model or a known payload.

With measured currents i, friction, and inertial parameters pi, each joint is solved by
Gauss-Newton:

    i_j = kappa_j Y_j(q, dq, ddq) (pi + carried) + F_j f_j,      kappa_j = 1 / k_j
    pi ~ N(model file, declared error)

The standard errors include the declared error, the autocorrelation of the residuals, and the bias
of a wrong friction law.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr
from scipy.optimize import least_squares

from hesr_model.errors import FitError
from hesr_model.inference.covariance import correlation_length
from hesr_model.logs.signals import Motion
from hesr_model.rigid_body.base_parameters import base_columns
from hesr_model.rigid_body.least_squares import Block
from hesr_model.rigid_body.observations import friction_columns, stack_blocks
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array

_MAX_RELATIVE_ERROR = 0.2  # relative standard error of a determined constant
_WEIGHT_FRICTION_SHARE = 0.2  # friction that a wrong law may add to a weight
_PAYLOAD_FRICTION_SHARE = 0.02  # the same for a payload
_MIN_ARM = 0.05  # smallest distance of a centre of mass [m]
_INERTIA_DEVIATION = 3.0  # standard deviation of inertia tensors over their size
_ROTOR_DEVIATION = 3.0  # standard deviation of rotor inertias [kg.m2]
_SPRING_DEVIATION = 1e4  # standard deviation of springs [N.m, N.m/rad]: they are unknown
_ROUNDS = 3


@dataclass(frozen=True, kw_only=True)
class Constant:
    """A torque constant [N.m/A], meaningless unless `determined`, and its error."""

    joint: str
    value: float
    error: float
    determined: bool

    @property
    def sentence(self) -> str:
        """The constant in a sentence."""
        if self.determined:
            return f"joint '{self.joint}': {self.value:.4g} +- {self.error:.2g} N.m/A."
        return (
            f"joint '{self.joint}': not determined; record a known, heavier payload that loads "
            "this joint."
        )


def torque_constants(
    motions: Sequence[Motion],
    robot: Robot,
    assumed: Sequence[float],
    *,
    mass_error: float,
    loaded: Sequence[Motion] = (),
    payload: Sequence[float] | Array | None = None,
) -> tuple[Constant, ...]:
    """Estimate the torque constants of all joints from currents; raises FitError.

    `motions`, without payload, and `loaded` ones have torques computed with the constants `assumed`
    (n,). `mass_error` is the relative standard deviation of the file's masses. `payload` (10,) is
    in the frame of the last joint.
    """
    if not 0.0 < mass_error < 1.0:
        raise FitError(
            f"the declared error of the masses is {mass_error:g}; expected a share from 0 to 1."
        )
    if bool(loaded) != (payload is not None):
        raise FitError("motions under a payload need its parameters, and vice versa.")
    all_columns = tuple(range(len(robot.parameter_names)))
    columns = friction_columns(robot, base_columns(robot))
    kinds = [(stack_blocks(motions, robot, all_columns, columns), np.zeros(10))]
    if payload is not None:
        kinds.append(
            (stack_blocks(loaded, robot, all_columns, columns), np.array(payload, dtype=float))
        )
    weight = np.zeros(len(all_columns))  # weights and first moments
    for k in range(robot.links):
        weight[10 * k : 10 * k + 4] = 1.0
    deviations = _prior_deviations(robot, mass_error)
    constants = []
    for j, (joint, constant) in enumerate(zip(robot.description.joints, assumed, strict=True)):
        joint_kinds = [(blocks[j], carried) for blocks, carried in kinds]
        kappa, relative = _Problem.from_blocks(joint_kinds, robot, weight, deviations).solve()
        value = float(constant / kappa) if kappa > 0.0 else np.inf
        is_determined = bool(kappa > 0.0 and relative < _MAX_RELATIVE_ERROR)
        error = value * relative
        constants.append(Constant(joint=joint, value=value, error=error, determined=is_determined))
    return tuple(constants)


def point_payload(mass: float, centre: Sequence[float]) -> Array:
    """Return the parameters (10,) of a mass [kg] at a point [m]."""
    c = np.array(centre, dtype=float)
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia
    return np.array([mass, *(mass * c), ixx, ixy, iyy, ixz, iyz, izz])


@dataclass(frozen=True, eq=False)
class _Rows:
    """Compressed rows of a joint: [Y, Y carried, friction, torque]."""

    factor: Array
    count: int
    length: float  # correlation length of the residuals [rows]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """One joint with unknown kappa (over the assumed constant), pi, and friction."""

    kinds: tuple[_Rows, ...]  # logs without payload, and with it
    nominal: Array  # (P,) of the model file
    spread: Array  # (P,) standard deviations
    friction: int  # columns of each kind
    known: float  # trusted torque [N.m] of the payload or the weights

    @classmethod
    def from_blocks(
        cls, kinds: Sequence[tuple[Block, Array]], robot: Robot, weight: Array, spread: Array
    ) -> "_Problem":
        size = len(spread)
        last = slice(10 * (robot.links - 1), 10 * robot.links)
        nominal = robot.nominal_parameters
        rows = []
        for block, carried in kinds:
            rigid = block.matrix[:, :size]
            friction_block = block.matrix[:, size:]
            joint_friction = friction_block[:, np.any(friction_block != 0.0, axis=0)]
            load = rigid[:, last] @ carried
            columns = np.column_stack([rigid @ nominal + load, joint_friction])
            fitted = columns @ np.linalg.lstsq(columns, block.target, rcond=None)[0]
            table = np.column_stack([rigid, load, joint_friction, block.target])
            (factor,) = qr(table, mode="r", check_finite=False)
            length = correlation_length(block.target - fitted)
            rows.append(_Rows(np.asarray(factor[: table.shape[1]]), len(joint_friction), length))
            heavy = rigid @ (weight * nominal)
        trusted_torque = float(np.std(load if len(kinds) > 1 else heavy))
        friction_count = joint_friction.shape[1]
        return cls(
            kinds=tuple(rows),
            nominal=nominal,
            spread=spread,
            friction=friction_count,
            known=trusted_torque,
        )

    def solve(self) -> tuple[float, float]:
        """Return kappa and its relative standard error."""
        size = len(self.nominal)
        x = self._start()
        for _ in range(_ROUNDS):
            residuals = [self._compute_residual(x, k) for k in range(len(self.kinds))]
            scales = [
                float(np.sqrt(rows.count / max(float(residual @ residual), 1e-12) / rows.length))
                for rows, residual in zip(self.kinds, residuals, strict=True)
            ]
            x = least_squares(self._residuals, x, jac=self._slopes, x_scale="jac", args=(scales,)).x
        slopes = self._slopes(x, scales)
        norms = np.maximum(np.linalg.norm(slopes, axis=0), 1e-150)
        _, s, vt = np.linalg.svd(slopes / norms, full_matrices=False)
        error = float(np.linalg.norm(vt[:, 0] / np.maximum(s, 1e-12 * s[0]))) / norms[0]
        rows = self.kinds[0]
        columns = rows.factor[:, size + 1 : -1]
        friction_size = float(np.linalg.norm(columns @ x[self._friction_slice(0)])) / np.sqrt(
            rows.count
        )
        share = _WEIGHT_FRICTION_SHARE if len(self.kinds) == 1 else _PAYLOAD_FRICTION_SHARE
        feigned = share * friction_size / max(abs(x[0]) * self.known, 1e-12)
        return float(x[0]), float(np.hypot(error / max(abs(x[0]), 1e-12), feigned))

    def _start(self) -> Array:
        x = np.concatenate([[0.0], self.nominal, np.zeros(self.friction * len(self.kinds))])
        free = np.r_[0, 1 + len(self.nominal) : len(x)]
        rows = self._slopes(x, [1.0] * len(self.kinds))[: -len(self.nominal)]
        targets = np.concatenate([kind.factor[:, -1] for kind in self.kinds])
        x[free] = np.linalg.lstsq(rows[:, free], targets, rcond=None)[0]
        return x

    def _friction_slice(self, k: int) -> slice:
        first = 1 + len(self.nominal) + k * self.friction
        return slice(first, first + self.friction)

    def _compute_torque(self, x: Array, k: int) -> Array:
        size = len(self.nominal)
        factor = self.kinds[k].factor
        return np.asarray(factor[:, :size] @ x[1 : 1 + size] + factor[:, size])

    def _compute_residual(self, x: Array, k: int) -> Array:
        factor = self.kinds[k].factor
        friction = factor[:, len(self.nominal) + 1 : -1] @ x[self._friction_slice(k)]
        return np.asarray(x[0] * self._compute_torque(x, k) + friction - factor[:, -1])

    def _residuals(self, x: Array, scales: Sequence[float]) -> Array:
        rows = [scale * self._compute_residual(x, k) for k, scale in enumerate(scales)]
        prior = (x[1 : 1 + len(self.nominal)] - self.nominal) / self.spread
        return np.concatenate([*rows, prior])

    def _slopes(self, x: Array, scales: Sequence[float]) -> Array:
        size = len(self.nominal)
        parts = []
        for k, scale in enumerate(scales):
            factor = self.kinds[k].factor
            kind_rows = np.zeros((len(factor), len(x)))
            kind_rows[:, 0] = self._compute_torque(x, k)
            kind_rows[:, 1 : 1 + size] = x[0] * factor[:, :size]
            kind_rows[:, self._friction_slice(k)] = factor[:, size + 1 : -1]
            parts.append(scale * kind_rows)
        prior = np.zeros((size, len(x)))
        prior[:, 1 : 1 + size] = np.diag(1.0 / self.spread)
        return np.vstack([*parts, prior])


def _prior_deviations(robot: Robot, mass_error: float) -> Array:
    """Return the standard deviations (P,) of the model file."""
    nominal = robot.nominal_parameters
    deviations = np.full(len(nominal), _ROTOR_DEVIATION)
    deviations[robot.inertial :] = _SPRING_DEVIATION
    heaviest = max(float(np.max(nominal[: 10 * robot.links : 10])), 1e-3)
    for k in range(robot.links):
        m, *moments = nominal[10 * k : 10 * k + 10]
        mass = max(m, 1e-3 * heaviest)
        arm = max(float(np.linalg.norm(moments[:3])) / mass, _MIN_ARM)
        deviations[10 * k] = mass_error * mass
        deviations[10 * k + 1 : 10 * k + 4] = mass_error * mass * arm
        inertia = max(float(np.max(np.abs(moments[3:]))), mass * arm**2)
        deviations[10 * k + 4 : 10 * k + 10] = _INERTIA_DEVIATION * inertia
    return deviations
