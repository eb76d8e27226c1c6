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
class TorqueConstant:
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
    assumed_constants: Sequence[float],
    *,
    mass_error: float,
    loaded: Sequence[Motion] = (),
    payload: Sequence[float] | Array | None = None,
) -> tuple[TorqueConstant, ...]:
    """Estimate the torque constants of all joints from currents; raises FitError.

    `motions`, without payload, and `loaded` ones have torques computed with `assumed_constants`
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
    load_cases = [(stack_blocks(motions, robot, all_columns, columns), np.zeros(10))]
    if payload is not None:
        loaded_blocks = stack_blocks(loaded, robot, all_columns, columns)
        load_cases.append((loaded_blocks, np.array(payload, dtype=float)))
    is_weight = np.zeros(len(all_columns))  # weights and first moments
    for k in range(robot.links):
        is_weight[10 * k : 10 * k + 4] = 1.0
    deviations = _prior_deviations(robot, mass_error)
    constants = []
    joint_constants = zip(robot.description.joints, assumed_constants, strict=True)
    for j, (joint, constant) in enumerate(joint_constants):
        joint_cases = [(blocks[j], carried) for blocks, carried in load_cases]
        kappa, relative = _Problem.from_blocks(joint_cases, robot, is_weight, deviations).solve()
        value = float(constant / kappa) if kappa > 0.0 else np.inf
        is_determined = bool(kappa > 0.0 and relative < _MAX_RELATIVE_ERROR)
        error = value * relative
        constants.append(
            TorqueConstant(joint=joint, value=value, error=error, determined=is_determined)
        )
    return tuple(constants)


def point_payload(mass: float, centre: Sequence[float]) -> Array:
    """Return the parameters (10,) of a mass [kg] at a point [m]."""
    c = np.array(centre, dtype=float)
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = inertia
    return np.array([mass, *(mass * c), ixx, ixy, iyy, ixz, iyz, izz])


@dataclass(frozen=True, eq=False)
class _CompressedRows:
    """Compressed rows of a joint: [Y, Y carried, friction, torque]."""

    factor: Array
    count: int
    length: float  # correlation length of the residuals [rows]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """One joint with unknown kappa (over the assumed constant), pi, and friction."""

    load_cases: tuple[_CompressedRows, ...]  # logs without payload, and with it
    nominal: Array  # (P,) of the model file
    deviations: Array  # (P,) standard deviations
    friction_count: int  # columns of each load case
    trusted_torque: float  # of the payload or the weights [N.m]

    @classmethod
    def from_blocks(
        cls,
        load_cases: Sequence[tuple[Block, Array]],
        robot: Robot,
        is_weight: Array,
        deviations: Array,
    ) -> "_Problem":
        parameter_count = len(deviations)
        last_link = slice(10 * (robot.links - 1), 10 * robot.links)
        nominal = robot.nominal_parameters
        rows = []
        for block, carried in load_cases:
            rigid = block.matrix[:, :parameter_count]
            friction_block = block.matrix[:, parameter_count:]
            joint_friction = friction_block[:, np.any(friction_block != 0.0, axis=0)]
            payload_torque = rigid[:, last_link] @ carried
            columns = np.column_stack([rigid @ nominal + payload_torque, joint_friction])
            fitted_torque = columns @ np.linalg.lstsq(columns, block.target, rcond=None)[0]
            table = np.column_stack([rigid, payload_torque, joint_friction, block.target])
            (factor,) = qr(table, mode="r", check_finite=False)
            length = correlation_length(block.target - fitted_torque)
            triangle = np.asarray(factor[: table.shape[1]])
            rows.append(_CompressedRows(triangle, len(joint_friction), length))
            # The last case is that with the payload, if there is one.
            trusted = payload_torque
            if len(load_cases) == 1:
                trusted = rigid @ (is_weight * nominal)
        trusted_torque = float(np.std(trusted))
        friction_count = joint_friction.shape[1]
        return cls(
            load_cases=tuple(rows),
            nominal=nominal,
            deviations=deviations,
            friction_count=friction_count,
            trusted_torque=trusted_torque,
        )

    def solve(self) -> tuple[float, float]:
        """Return kappa and its relative standard error."""
        parameter_count = len(self.nominal)
        x = self._find_start()
        for _ in range(_ROUNDS):
            scales = []
            for k, rows in enumerate(self.load_cases):
                residual = self._compute_residual(x, k)
                precision = rows.count / max(float(residual @ residual), 1e-12)
                # Rows within a correlation length count as one.
                scales.append(float(np.sqrt(precision / rows.length)))
            x = least_squares(self._residuals, x, jac=self._slopes, x_scale="jac", args=(scales,)).x
        slopes = self._slopes(x, scales)
        column_sizes = np.maximum(np.linalg.norm(slopes, axis=0), 1e-150)
        _, s, vt = np.linalg.svd(slopes / column_sizes, full_matrices=False)
        error = float(np.linalg.norm(vt[:, 0] / np.maximum(s, 1e-12 * s[0]))) / column_sizes[0]
        rows = self.load_cases[0]
        columns = rows.factor[:, parameter_count + 1 : -1]
        friction = columns @ x[self._friction_slice(0)]
        friction_size = float(np.linalg.norm(friction)) / np.sqrt(rows.count)
        share = _PAYLOAD_FRICTION_SHARE
        if len(self.load_cases) == 1:
            share = _WEIGHT_FRICTION_SHARE
        friction_error = share * friction_size / max(abs(x[0]) * self.trusted_torque, 1e-12)
        return float(x[0]), float(np.hypot(error / max(abs(x[0]), 1e-12), friction_error))

    def _find_start(self) -> Array:
        x = np.concatenate(
            [[0.0], self.nominal, np.zeros(self.friction_count * len(self.load_cases))]
        )
        free_columns = np.r_[0, 1 + len(self.nominal) : len(x)]
        rows = self._slopes(x, [1.0] * len(self.load_cases))[: -len(self.nominal)]
        targets = np.concatenate([load_case.factor[:, -1] for load_case in self.load_cases])
        x[free_columns] = np.linalg.lstsq(rows[:, free_columns], targets, rcond=None)[0]
        return x

    def _friction_slice(self, k: int) -> slice:
        first = 1 + len(self.nominal) + k * self.friction_count
        return slice(first, first + self.friction_count)

    def _compute_torque(self, x: Array, k: int) -> Array:
        parameter_count = len(self.nominal)
        factor = self.load_cases[k].factor
        body_torque = factor[:, :parameter_count] @ x[1 : 1 + parameter_count]
        return np.asarray(body_torque + factor[:, parameter_count])

    def _compute_residual(self, x: Array, k: int) -> Array:
        factor = self.load_cases[k].factor
        friction = factor[:, len(self.nominal) + 1 : -1] @ x[self._friction_slice(k)]
        return np.asarray(x[0] * self._compute_torque(x, k) + friction - factor[:, -1])

    def _residuals(self, x: Array, scales: Sequence[float]) -> Array:
        rows = [scale * self._compute_residual(x, k) for k, scale in enumerate(scales)]
        prior = (x[1 : 1 + len(self.nominal)] - self.nominal) / self.deviations
        return np.concatenate([*rows, prior])

    def _slopes(self, x: Array, scales: Sequence[float]) -> Array:
        parameter_count = len(self.nominal)
        parts = []
        for k, scale in enumerate(scales):
            factor = self.load_cases[k].factor
            case_rows = np.zeros((len(factor), len(x)))
            case_rows[:, 0] = self._compute_torque(x, k)
            case_rows[:, 1 : 1 + parameter_count] = x[0] * factor[:, :parameter_count]
            case_rows[:, self._friction_slice(k)] = factor[:, parameter_count + 1 : -1]
            parts.append(scale * case_rows)
        prior = np.zeros((parameter_count, len(x)))
        prior[:, 1 : 1 + parameter_count] = np.diag(1.0 / self.deviations)
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
