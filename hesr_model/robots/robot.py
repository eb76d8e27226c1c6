"""Robots: a TOML description and the rigid-body model (URDF or MJCF)."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.findings import Finding
from hesr_model.robots import model_file
from hesr_model.robots.description import RobotDescription as RobotDescription
from hesr_model.robots.mjcf_forces import SPRINGS
from hesr_model.robots.transmission import LINEAR
from hesr_model.robots.urdf import chain_limits, find_chain_doubts
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.files import PathArg, models_folder, to_path

LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Mass, first moments, and inertia about the origin of the link's joint frame."""
_ROWS_AT_ONCE = 4096


class Robot:
    """A robot: its joints, the format of its logs, and its rigid-body dynamics (eq. 5).

    tau = Y(q, dq, ddq) pi, with ten parameters per link (`LINK_PARAMETERS`)
    and, if described, a rotor inertia per joint, whose column is ddq of the
    joint or of its coupled motor, and springs.

    Parameters
    ----------
    source : path
        Robot file (TOML), URDF or MJCF (``.xml``); a description; or the name
        of a robot that ships: uf850, ur10, fretting, cylinder.

    Raises
    ------
    ConfigError
        If a robot file cannot be used, or `source` is neither a robot nor a
        path.
    RobotError
        If the model file, one of its joints, or the kind of a log unit cannot
        be used.
    """

    def __init__(self, source: "RobotLike") -> None:
        description = to_description(source)
        description.require_one_per_joint()
        self.description = description
        self._pinocchio: Any = model_file.dynamics_engine()
        self._model_file = model_file.load(description.model)
        self._pin_model: Any = self._model_file.reduce_model(description)
        self._pin_data: Any = self._pin_model.createData()
        slopes = self.follow[0] if self.follow else np.eye(self.n)
        self.rotor_nominal: Array = np.array(self._pin_model.armature) @ slopes**2
        """Rotor inertias (n,) [kg.m2] of the model file (`armature` of an MJCF)."""
        # In the dynamics they are columns of the regressor.
        self._pin_model.armature = np.zeros(self._pin_model.nv)
        self._pin_model.gravity.linear = np.array(self.gravity)
        self.springs = tuple(description.spring_terms(self.slides))
        """Terms of springs and balancers."""
        description.log.units.require_fitting(description.joints, self.slides)
        if description.transmission:
            description.transmission.require_turning(description.joints, self.slides)

    def __repr__(self) -> str:
        return f"Robot('{self.name}', {self.n} joints, {self.description.model.name})"

    @property
    def _joint_numbers(self) -> list[int]:
        """Numbers of the joints in the model."""
        return [self._pin_model.getJointId(name) for name in self.joints]

    @property
    def name(self) -> str:
        """Name of the robot."""
        return self.description.name

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, from base to tip."""
        return self.description.joints

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.description.joints)

    @property
    def links(self) -> int:
        """Number of moving links; those of joints that follow others count."""
        return int(self._pin_model.nv)

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Doubtful numbers of the model file, without placeholders; errors first."""
        file_findings = self._model_file.find_doubts(self.joints)
        if self.description.known is not None:
            # Torques of the file follow from placeholders; its names do not.
            return tuple(
                finding
                for finding in file_findings
                if finding.check == "odd-limits"
                or (finding.check == "left-over" and not finding.joints)
            )
        lower, upper, _ = self.reach
        q = np.random.default_rng(0).uniform(lower, upper, (8, self.n))
        masses, _ = self.dynamics(self.nominal_parameters, q, np.zeros_like(q))
        terms = {*self.description.springs, *self.description.balancers}
        spring_torques = self._model_file.forces.get(SPRINGS, {})
        missing_springs = {
            name: spring_torques.get(name, 0.0)
            for name in self.joints
            if name in self._model_file.springs and name not in terms
        }
        findings = find_chain_doubts(
            self._model_file.path, self.joints, masses, self._limits[3], missing_springs
        )
        rounded_joints = {
            finding.joints for finding in file_findings if finding.check == "rounded-inertia"
        }
        remaining_findings = (
            f for f in findings if f.check != "no-inertia" or f.joints not in rounded_joints
        )
        return (*remaining_findings, *file_findings)

    @cached_property
    def gravity(self) -> Array:
        """Gravity (3,) [m/s2] in the frame of the base."""
        stated_gravity = self.description.gravity
        gravity = np.array(self._model_file.gravity if stated_gravity is None else stated_gravity)
        mount = self.description.mount
        if mount is None:
            return gravity
        return np.asarray(self._pinocchio.rpy.rpyToMatrix(*mount).T @ gravity)

    @cached_property
    def follow(self) -> tuple[Array, Array] | None:
        """G (links, n) and b (links,) of q_all = G q + b; None if no joint follows another."""
        names = list(self._pin_model.names)[1:]
        return self._model_file.follow(names, self.joints) if len(names) > self.n else None

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        return tuple(joint.prismatic for joint in self.tree if joint.name in self.joints)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the regressor's columns: link by link, then the rotors, then the springs."""
        moving_names = list(self._pin_model.names)[1:]
        links = tuple(f"{joint}.{name}" for joint in moving_names for name in LINK_PARAMETERS)
        rotors = tuple(f"{joint}.Ir" for joint in self.joints) * self.description.rotor_inertia
        return (
            links
            + rotors
            + tuple(f"{self.joints[term.joint]}.{term.name}" for term in self.springs)
        )

    @property
    def inertial(self) -> int:
        """Number of parameters before those of springs."""
        return 10 * self.links + self.n * self.description.rotor_inertia

    @cached_property
    def nominal_parameters(self) -> Array:
        """Parameters (P,) of the model file, 0 for springs that it lacks."""
        links = [
            np.asarray(body.toDynamicParameters()) for body in list(self._pin_model.inertias)[1:]
        ]
        rotors = [self.rotor_nominal] if self.description.rotor_inertia else []
        springs_by_joint = [
            dict(zip(LINEAR, self._model_file.springs.get(joint, ()), strict=False))
            for joint in self.joints
        ]
        springs = [springs_by_joint[term.joint].get(term.name, 0.0) for term in self.springs]
        return np.concatenate([*links, *rotors, springs])

    @cached_property
    def _limits(self) -> tuple[Array, Array, Array, Mask]:
        return chain_limits(self._pin_model, self._joint_numbers, self.follow)

    @cached_property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lowest and highest position [rad or m] and highest speed (n,); infinite if absent."""
        return self._limits[:3]

    @cached_property
    def reach(self) -> tuple[Array, Array, Array]:
        """The `limits`, for random states; one turn (or m) either way and 2 rad/s if absent."""
        lower, upper, speed = self.limits
        is_bounded = np.isfinite(upper - lower)
        reach_lower = np.where(is_bounded, lower, -np.pi)
        reach_upper = np.where(is_bounded, upper, np.pi)
        return reach_lower, reach_upper, np.where(np.isfinite(speed), speed, 2.0)

    @property
    def torque_limits(self) -> Array:
        """Largest torques (n,) [N.m or N] of the model file; 0 if unknown."""
        dofs = [self._pin_model.joints[number].idx_v for number in self._joint_numbers]
        return np.array(self._pin_model.effortLimit)[dofs]

    @cached_property
    def tree(self) -> tuple[model_file.JointFrame, ...]:
        """Frames of the joints and of those that follow them, from base to tip."""
        return tuple(
            model_file.joint_frames(self._pin_model, self._pinocchio.neutral(self._pin_model))
        )

    @property
    def bodies(self) -> list[tuple[float, Array, Array]]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg.m2] of each link."""
        return [
            (link_inertia.mass, link_inertia.lever, link_inertia.inertia)
            for link_inertia in list(self._pin_model.inertias)[1:]
        ]

    @property
    def kinematics(self) -> tuple[Any, Any, Any, Callable[[Array], Array]]:
        """Pinocchio, its model and data, and the map of positions (N, n) to configurations."""
        return self._pinocchio, self._pin_model, self._pin_data, self._configurations

    @cached_property
    def geometry(self) -> Any:
        """Pinocchio's collision geometry of the model file; None if it cannot be read."""
        return self._model_file.geometry(self.description)

    def places(self, q: Array) -> list[tuple[Array, Array]]:
        """Return rotation (3, 3) and origin (3,) [m] of each joint's frame at a position (n,)."""
        self._pinocchio.forwardKinematics(
            self._pin_model, self._pin_data, self._configurations(q[None])[0]
        )
        return [
            (placement.rotation.copy(), placement.translation.copy())
            for placement in list(self._pin_data.oMi)[1:]
        ]

    def regressor(self, q: Array, dq: Array, ddq: Array, rotors: Array | None = None) -> Array:
        """Return the regressor Y (N, n, P) of eq. 5, P = len(parameter_names).

        Parameters
        ----------
        q, dq, ddq : (N, n) [rad, rad/s, rad/s2; m, m/s, m/s2 for prismatic
            joints].
        rotors : (N, n) accelerations of the rotors, by default `ddq`.
        """
        states = self._configurations(q)
        regressor = np.zeros((len(q), self.n, len(self.parameter_names)))
        links = 10 * self.links
        slopes = self.follow[0] if self.follow else None
        velocity, acceleration = (dq, ddq) if slopes is None else (dq @ slopes.T, ddq @ slopes.T)
        for k, state in enumerate(states):
            rows = self._pinocchio.computeJointTorqueRegressor(
                self._pin_model, self._pin_data, state, velocity[k], acceleration[k]
            )
            regressor[k, :, :links] = rows if slopes is None else slopes.T @ rows
        if self.description.rotor_inertia:
            motor_coupling = self.description.motors
            rotor_matrix = np.eye(self.n) if motor_coupling is None else motor_coupling.forward
            rotor_acceleration = (ddq if rotors is None else rotors) @ rotor_matrix.T
            regressor[:, :, links : self.inertial] = rotor_acceleration[:, None, :] * rotor_matrix.T
        for column, term in enumerate(self.springs, start=self.inertial):
            regressor[:, term.joint, column] = term.compute_torque(q[:, term.joint])
        return regressor

    def torque(
        self, parameters: Array, q: Array, dq: Array, ddq: Array, rotors: Array | None = None
    ) -> Array:
        """Return the rigid-body torque Y pi (N, n) [N.m; N], also with zero masses.

        Parameters
        ----------
        parameters : (P,), or (N, P) with parameters for each row.
        q, dq, ddq, rotors : (N, n) as in `regressor`; dq = ddq = 0 gives the
            gravity torque.
        """
        parts = [np.empty((0, self.n))]
        for start in range(0, len(q), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            regressor = self.regressor(
                *(values[rows] for values in (q, dq, ddq, rotors) if values is not None)
            )
            row_parameters = parameters if parameters.ndim == 1 else parameters[rows, :, None]
            parts.append((regressor @ row_parameters).reshape(-1, self.n))
        return np.concatenate(parts)

    def dynamics(self, parameters: Array, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return mass matrix (N, n, n) and torque without acceleration (N, n); Y is linear in ddq.

        Parameters
        ----------
        parameters : (P,) or (N, P).
        q, dq : (N, n) as in `regressor`.
        """
        rows, n = q.shape
        unit_accelerations = np.vstack([np.zeros((1, n)), np.eye(n)])
        torques = self.torque(
            parameters if parameters.ndim == 1 else np.repeat(parameters, n + 1, axis=0),
            np.repeat(q, n + 1, axis=0),
            np.repeat(dq, n + 1, axis=0),
            np.tile(unit_accelerations, (rows, 1)),
        ).reshape(rows, n + 1, n)
        bias = torques[:, 0]
        return np.swapaxes(torques[:, 1:] - bias[:, None], 1, 2), bias

    @contextmanager
    def under_gravity(self) -> Iterator[Callable[[Sequence[float]], None]]:
        """Yield a function that sets the gravity [m/s2], restored at the end."""

        def set_gravity(gravity: Sequence[float]) -> None:
            self._pin_model.gravity.linear = np.array(gravity, dtype=float)

        try:
            yield set_gravity
        finally:
            set_gravity(self.gravity.tolist())

    def _configurations(self, q: Array) -> Array:
        """Return Pinocchio's configurations, two coordinates for an unlimited joint."""
        states = np.zeros((len(q), self._pin_model.nq))
        if self.follow:
            q = q @ self.follow[0].T + self.follow[1]
        for k, joint in enumerate(list(self._pin_model.joints)[1:]):
            model_file.set_joint(joint, states.T, q[:, k])
        return states


RobotLike = RobotDescription | Robot | str | PathLike[str]
"""A robot, its description, the path of a robot file (TOML), URDF or MJCF, or a shipped robot."""


def to_description(robot: RobotLike) -> RobotDescription:
    """Return the description of a robot, or of a whole URDF or MJCF."""
    if isinstance(robot, Robot):
        return robot.description
    if isinstance(robot, RobotDescription):
        return robot
    path = find_robot_file(robot)
    is_robot_file = path.suffix.lower() == ".toml"
    return RobotDescription.read(path) if is_robot_file else describe_model(path)


def find_robot_file(robot: PathArg) -> Path:
    """Return the file of a robot that ships with HESR, such as uf850, or else the path itself."""
    path = to_path(robot, "a robot")
    if path.suffix or path.exists():
        return path
    shipped_file = models_folder() / path / "robot.toml"
    return shipped_file if shipped_file.is_file() else path


def describe_model(path: Path, joints: Sequence[str] = ()) -> RobotDescription:
    """Return the description of a URDF or MJCF whose other joints, by default fingers, rest."""
    joint_names = tuple(joint.name for joint in model_file.find_driven_joints(path, joints))
    rest_positions = model_file.find_rest_positions(model_file.read_joints(path), joint_names)
    sprung_joints = tuple(name for name in joint_names if name in model_file.load(path).springs)
    return RobotDescription(
        name=path.stem,
        model=path.resolve(),
        joints=joint_names,
        locked=rest_positions,
        springs=sprung_joints,
    )


def to_robot(robot: RobotLike) -> Robot:
    """Return the dynamics of a robot."""
    return robot if isinstance(robot, Robot) else Robot(robot)
