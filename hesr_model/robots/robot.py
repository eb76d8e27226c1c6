"""Robots: a TOML description and the rigid-body model (URDF or MJCF)."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from hesr_model.errors import RobotError
from hesr_model.findings import Finding
from hesr_model.logs.log_format import LogFormat
from hesr_model.robots.model_file import (
    JointFrame,
    driven_joints,
    joint_frames,
    joints_of,
    load,
    locked,
    position_limits,
    set_joint,
)
from hesr_model.robots.owner import Owner
from hesr_model.robots.sources import Sources, sourced
from hesr_model.robots.springs import spring_terms
from hesr_model.robots.transmission import Coupling, Transmission
from hesr_model.robots.urdf import UNLIMITED
from hesr_model.support.arrays import Array
from hesr_model.support.config import Config, PrintableName, RelativePath
from hesr_model.support.files import PathArg, path_of

LINK_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Mass, first moments, and inertia about the origin of the link's joint frame."""

_ROWS_AT_ONCE = 4096


class RobotDescription(Config):
    """A robot: its model file, its joints, and the format of its logs.

    Joints run from base to tip, below the body `root` if it is given. `locked` gives positions [rad
    or m] of fixed joints; other unlisted joints rest as in the model file, or follow others.
    `gravity` [m/s2] is in the base frame, by default that of the model file; `mount` (roll, pitch,
    yaw) [rad] turns the base. `known` lists exact parameters, such as ``j1.Izz``, and makes others
    placeholders; by default all are approximate. `rotor_inertia` adds a rotor inertia per joint,
    reflected through its gear. `springs` (linear) and `balancers` (constant and two harmonics of
    the angle) list joints with further torques. `gear_ratio` (turns of the motor per turn of the
    joint) is needed by laws with motor ripple; `transmission` if motors turn several joints or were
    logged, it then sets the gear ratios. `sources` states how constants are known.
    """

    name: PrintableName
    model: RelativePath
    joints: tuple[PrintableName, ...] = Field(min_length=1)
    locked: dict[str, float] = Field(default_factory=dict)
    root: PrintableName | None = None
    gravity: tuple[float, float, float] | None = None
    mount: tuple[float, float, float] | None = None
    known: tuple[str, ...] | None = None
    rotor_inertia: bool = True
    springs: tuple[PrintableName, ...] = ()
    balancers: tuple[PrintableName, ...] = ()
    gear_ratio: tuple[Annotated[float, Field(gt=0)], ...] | None = None
    transmission: Transmission | None = None
    log: LogFormat = LogFormat()
    sources: Sources = Sources()
    owner: Owner = Owner()

    @model_validator(mode="before")
    @classmethod
    def _one_for_all(cls, data: Any) -> Any:
        """Repeat a single torque constant for every joint."""
        log = data.get("log") if isinstance(data, Mapping) else None
        if not isinstance(log, Mapping):
            return data
        gain = log.get("torque_per_ampere")
        if isinstance(gain, bool) or not isinstance(gain, int | float):
            return data
        joints = data.get("joints")
        count = len(joints) if isinstance(joints, list | tuple) else 1
        return {**data, "log": {**log, "torque_per_ampere": (gain,) * count}}

    @model_validator(mode="after")
    def _one_gear_per_joint(self) -> Self:
        if self.transmission is None:
            return self
        ratios = tuple(float(ratio) for ratio in np.abs(self.transmission.ratios))
        if self.gear_ratio not in (None, ratios):
            raise ValueError(
                "'gear_ratio' contradicts the diagonal of 'transmission.matrix'; leave it out"
            )
        object.__setattr__(self, "gear_ratio", ratios)
        return self

    @property
    def coupling(self) -> Coupling | None:
        """Friction coordinates over joints, if coupled."""
        return Coupling.of(self.transmission.coordinates) if self.transmission else None

    @property
    def motors(self) -> Coupling | None:
        """Motors over joints, divided by their gear ratios; None if nothing is coupled."""
        return Coupling.of(self.transmission.motors) if self.transmission else None

    @property
    def logged(self) -> Coupling | None:
        """Logged coordinates over joints, if motors were logged."""
        of_motors = self.transmission and self.transmission.logs == "motor"
        return self.motors if of_motors else None

    @property
    def constants(self) -> dict[str, Any]:
        """Entry of a provenance for the constants that turn logs into torques."""
        gains, sources = self.log.torque_per_ampere, self.sources
        if gains is None:
            return {}
        known = sources.each("torque_per_ampere", len(gains))
        return sourced("torque constant", "N.m/A", self.joints, gains, known)

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a robot file; raises ConfigError, or RobotError for a list of wrong length."""
        path = path_of(path, "a robot")
        description = super().read(path)
        try:
            description.require_one_per_joint()
        except RobotError as error:
            raise RobotError(f"{path}: {error}") from error
        return description

    def require_one_per_joint(self) -> None:
        """Raise RobotError if a list has not one entry per joint."""
        for key, entries in self.lists.items():
            if isinstance(entries, tuple) and len(entries) != len(self.joints):
                raise RobotError(
                    f"key '{key}' of robot '{self.name}' has {len(entries)} entries; "
                    f"its {len(self.joints)} joints need one each."
                )

    @property
    def lists(self) -> dict[str, Any]:
        """Return values by key, which may be lists with an entry per joint."""
        columns = {f"log.columns.{k}": v for k, v in self.log.columns if k != "names"}
        return {
            "transmission.matrix": self.transmission and self.transmission.matrix,
            "gear_ratio": self.gear_ratio,
            "log.torque_per_ampere": self.log.torque_per_ampere,
            "log.zero": self.log.zero,
            "sources.torque_per_ampere": self.sources.torque_per_ampere,
            "log.bag.joints": self.log.bag.joints,
            **columns,
            **{f"log.units.{key}": entries for key, entries in self.log.units},
        }


class Robot:
    """A robot: its joints, the format of its logs, and its rigid-body dynamics (eq. 5).

    tau = Y(q, dq, ddq) pi, with ten parameters per link (`LINK_PARAMETERS`) and, if described, a
    rotor inertia per joint, whose column is ddq of the joint or of its coupled motor, and springs.

    Parameters
    ----------
    source : path of a robot file (TOML), of a URDF or of an MJCF (``.xml``), or a description.

    Raises
    ------
    ConfigError
        If a robot file cannot be used, or `source` is neither a robot nor a path.
    RobotError
        If the model file, one of its joints, or the kind of a log unit cannot be used.
    """

    def __init__(self, source: "RobotLike") -> None:
        import pinocchio  # slow to import

        description = description_of(source)
        description.require_one_per_joint()
        self.description = description
        self._pin: Any = pinocchio
        self._file = load(description.model)
        self._model: Any = self._file.reduced(
            description.joints, description.locked, description.root
        )
        self._data: Any = self._model.createData()
        slopes = self.follow[0] if self.follow else np.eye(self.n)
        self.rotor_nominal: Array = np.array(self._model.armature) @ slopes**2
        """Rotor inertias (n,) [kg.m2] of the model file (`armature` of an MJCF)."""
        # In the dynamics they are columns of the regressor.
        self._model.armature = np.zeros(self._model.nv)
        self._model.gravity.linear = np.array(self.gravity)
        sprung = self.slides, description.springs, description.balancers
        self.springs = tuple(spring_terms(self.name, self.joints, *sprung))
        """Terms of springs and balancers."""
        description.log.units.require_fitting(description.joints, self.slides)
        if description.transmission:
            description.transmission.require_turning(description.joints, self.slides)

    def __repr__(self) -> str:
        return f"Robot('{self.name}', {self.n} joints, {self.description.model.name})"

    @property
    def _own(self) -> list[Any]:
        """Models of the joints, which cannot be pickled."""
        return [self._model.joints[self._model.getJointId(name)] for name in self.joints]

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
        return int(self._model.nv)

    @cached_property
    def doubts(self) -> tuple[Finding, ...]:
        """Doubtful numbers of the model file, without placeholders; errors first."""
        if self.description.known is not None:
            return tuple(doubt for doubt in self._file.doubts if doubt.check == "odd-limits")
        return (*self._own_doubts(), *self._file.doubts)

    def _own_doubts(self) -> Iterator[Finding]:
        low, high, _ = self.reach
        bare = self._narrowed[0] >= self._narrowed[1]
        q = np.random.default_rng(0).uniform(low, high, (8, self.n))
        masses, _ = self.dynamics(self.nominal_parameters, q, np.zeros_like(q))
        least = np.diagonal(masses, axis1=1, axis2=2).min(axis=0)
        for j in np.flatnonzero(least <= 1e-12 * np.abs(masses).max()):
            yield self._doubt(
                int(j),
                check="no-inertia",
                found=f"moves an inertia of {least[j]:.3g} kg.m2 (kg if it slides), which makes "
                "its torques meaningless",
                remedy="correct the <inertial> of the links after it",
            )
        for j in np.flatnonzero(bare):
            yield self._doubt(
                int(j),
                check="odd-limits",
                severity="warning",
                found="joints that follow it leave it no range, and their limits count as none",
                remedy="correct their limits or their <mimic> or equality",
            )

    def _doubt(self, j: int, **content: Any) -> Finding:
        return Finding(where=str(self._file.path), joints=(self.joints[j],), **content)

    @cached_property
    def gravity(self) -> Array:
        """Gravity (3,) [m/s2] in the frame of the base."""
        stated = self.description.gravity
        gravity = np.array(self._file.gravity if stated is None else stated)
        if (mount := self.description.mount) is None:
            return gravity
        return np.asarray(self._pin.rpy.rpyToMatrix(*mount).T @ gravity)

    @cached_property
    def follow(self) -> tuple[Array, Array] | None:
        """G (links, n) and b (links,) of q_all = G q + b; None if no joint follows another."""
        names = list(self._model.names)[1:]
        return self._file.follow(names, self.joints) if len(names) > self.n else None

    @cached_property
    def slides(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        return tuple(joint.prismatic for joint in self.tree if joint.name in self.joints)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the regressor's columns: link by link, then the rotors, then the springs."""
        carrying = list(self._model.names)[1:]
        links = tuple(f"{joint}.{name}" for joint in carrying for name in LINK_PARAMETERS)
        rotors = tuple(f"{joint}.Ir" for joint in self.joints) * self.description.rotor_inertia
        return links + rotors + tuple(f"{self.joints[t.joint]}.{t.name}" for t in self.springs)

    @property
    def inertial(self) -> int:
        """Number of parameters before those of springs."""
        return 10 * self.links + self.n * self.description.rotor_inertia

    @cached_property
    def nominal_parameters(self) -> Array:
        """Parameters (P,) of the model file, 0 for springs."""
        links = [np.asarray(body.toDynamicParameters()) for body in list(self._model.inertias)[1:]]
        rotors = [self.rotor_nominal] if self.description.rotor_inertia else []
        return np.concatenate([*links, *rotors, np.zeros(len(self.springs))])

    @cached_property
    def limits(self) -> tuple[Array, Array, Array]:
        """Lowest and highest position [rad or m] and highest speed, (n,) each.

        An absent limit is infinite; joints that follow a leader also limit it, unless they leave
        it no range.
        """
        lower, upper, speed = self._narrowed
        own = np.array([position_limits(self._model, joint) for joint in self._own])
        bare = lower >= upper
        return np.where(bare, own[:, 0], lower), np.where(bare, own[:, 1], upper), speed

    @cached_property
    def _narrowed(self) -> tuple[Array, Array, Array]:
        joints = list(self._model.joints)[1:]
        ranges = np.array([position_limits(self._model, joint) for joint in joints])
        speeds = np.array([float(self._model.velocityLimit[joint.idx_v]) for joint in joints])
        speeds = np.where((speeds > 0.0) & (speeds < UNLIMITED), speeds, np.inf)
        slopes, offsets = self.follow or (np.eye(self.n), np.zeros(self.n))
        own = slopes != 0.0
        scale = np.where(own, slopes, 1.0)
        ends = np.sort((ranges.T - offsets)[:, :, None] / scale, axis=0)
        lower = np.where(own, ends[0], -np.inf).max(axis=0)
        upper = np.where(own, ends[1], np.inf).min(axis=0)
        return lower, upper, np.where(own, speeds[:, None] / np.abs(scale), np.inf).min(axis=0)

    @cached_property
    def reach(self) -> tuple[Array, Array, Array]:
        """The `limits`, for random states; one turn (or m) either way and 2 rad/s if absent."""
        lower, upper, speed = self.limits
        bounded = np.isfinite(upper - lower)
        low, high = np.where(bounded, lower, -np.pi), np.where(bounded, upper, np.pi)
        return low, high, np.where(np.isfinite(speed), speed, 2.0)

    @property
    def torque_limits(self) -> Array:
        """Largest torques (n,) [N.m or N] of the model file; 0 if unknown."""
        return np.array([float(self._model.effortLimit[joint.idx_v]) for joint in self._own])

    @cached_property
    def tree(self) -> tuple[JointFrame, ...]:
        """Frames of the joints and of those that follow them, from base to tip."""
        return tuple(joint_frames(self._model, self._pin.neutral(self._model)))

    @property
    def bodies(self) -> list[tuple[float, Array, Array]]:
        """Mass [kg], centre of mass (3,) [m] and inertia about it (3, 3) [kg.m2] of each link."""
        return [(one.mass, one.lever, one.inertia) for one in list(self._model.inertias)[1:]]

    def places(self, q: Array) -> list[tuple[Array, Array]]:
        """Return rotation (3, 3) and origin (3,) [m] of each joint's frame at a position (n,)."""
        self._pin.forwardKinematics(self._model, self._data, self._configurations(q[None])[0])
        return [(one.rotation.copy(), one.translation.copy()) for one in list(self._data.oMi)[1:]]

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the regressor Y of eq. 5 at every sample.

        Parameters
        ----------
        q, dq, ddq : (N, n) [rad, rad/s, rad/s2; m, m/s, m/s2 for prismatic joints].

        Returns
        -------
        ndarray
            (N, n, P), P = len(parameter_names).
        """
        states = self._configurations(q)
        out = np.zeros((len(q), self.n, len(self.parameter_names)))
        links = 10 * self.links
        slopes = self.follow[0] if self.follow else None
        velocity, acceleration = (dq, ddq) if slopes is None else (dq @ slopes.T, ddq @ slopes.T)
        for k, state in enumerate(states):
            rows = self._pin.computeJointTorqueRegressor(
                self._model, self._data, state, velocity[k], acceleration[k]
            )
            out[k, :, :links] = rows if slopes is None else slopes.T @ rows
        if self.description.rotor_inertia:
            motors = self.description.motors
            own = np.eye(self.n) if motors is None else motors.forward
            out[:, :, links : self.inertial] = (ddq @ own.T)[:, None, :] * own.T
        for column, term in enumerate(self.springs, start=self.inertial):
            out[:, term.joint, column] = term.over(q[:, term.joint])
        return out

    def torque(self, parameters: Array, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the rigid-body torque Y pi for any parameters, also with zero masses.

        Parameters
        ----------
        parameters : (P,), or (N, P) with parameters for each row.
        q, dq, ddq : (N, n) as in `regressor`; dq = ddq = 0 gives the gravity torque.

        Returns
        -------
        ndarray
            (N, n) [N.m; N for prismatic joints].
        """
        parts = [np.empty((0, self.n))]
        for start in range(0, len(q), _ROWS_AT_ONCE):
            rows = slice(start, start + _ROWS_AT_ONCE)
            regressor = self.regressor(q[rows], dq[rows], ddq[rows])
            own = parameters if parameters.ndim == 1 else parameters[rows, :, None]
            parts.append((regressor @ own).reshape(-1, self.n))
        return np.concatenate(parts)

    def dynamics(self, parameters: Array, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return the mass matrix and the torque without acceleration; Y is linear in ddq.

        Parameters
        ----------
        parameters : (P,) or (N, P).
        q, dq : (N, n) as in `regressor`.

        Returns
        -------
        tuple
            (N, n, n) [kg.m2; kg] and (N, n) [N.m; N].
        """
        rows, n = q.shape
        units = np.vstack([np.zeros((1, n)), np.eye(n)])
        each = self.torque(
            parameters if parameters.ndim == 1 else np.repeat(parameters, n + 1, axis=0),
            np.repeat(q, n + 1, axis=0),
            np.repeat(dq, n + 1, axis=0),
            np.tile(units, (rows, 1)),
        ).reshape(rows, n + 1, n)
        bias = each[:, 0]
        return np.swapaxes(each[:, 1:] - bias[:, None], 1, 2), bias

    @contextmanager
    def under_gravity(self) -> Iterator[Callable[[Sequence[float]], None]]:
        """Yield a function that sets the gravity [m/s2], restored at the end."""

        def set_gravity(gravity: Sequence[float]) -> None:
            self._model.gravity.linear = np.array(gravity, dtype=float)

        try:
            yield set_gravity
        finally:
            set_gravity(self.gravity.tolist())

    def _configurations(self, q: Array) -> Array:
        """Return Pinocchio's configurations, two coordinates for an unlimited joint."""
        states = np.zeros((len(q), self._model.nq))
        if self.follow:
            q = q @ self.follow[0].T + self.follow[1]
        for k, joint in enumerate(list(self._model.joints)[1:]):
            set_joint(joint, states.T, q[:, k])
        return states


RobotLike = RobotDescription | Robot | str | PathLike[str]
"""A robot, its description, or the path of a robot file (TOML), URDF or MJCF."""


def description_of(robot: RobotLike) -> RobotDescription:
    """Return the description of a robot, or of a whole URDF or MJCF."""
    if isinstance(robot, Robot):
        return robot.description
    if isinstance(robot, RobotDescription):
        return robot
    path = path_of(robot, "a robot")
    is_robot_file = path.suffix.lower() == ".toml"
    return RobotDescription.read(path) if is_robot_file else description_of_model(path)


def description_of_model(path: Path, joints: Sequence[str] = ()) -> RobotDescription:
    """Return the description of a URDF or MJCF whose other joints, by default fingers, rest."""
    used = tuple(joint.name for joint in driven_joints(path, joints))
    rest = locked(joints_of(path), used)
    return RobotDescription(name=path.stem, model=path.resolve(), joints=used, locked=rest)


def model_of(robot: RobotLike) -> Robot:
    """Return the dynamics of a robot."""
    return robot if isinstance(robot, Robot) else Robot(robot)
