"""Rigid-body parameters from logs."""

import logging
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Self

import numpy as np
import pydantic
from threadpoolctl import threadpool_limits

from hesr_model.errors import FitError, RobotError, RuleError
from hesr_model.inference.covariance import Covariance
from hesr_model.logs.robot_log import Log, require_moving
from hesr_model.logs.signals import Motion, smooth, smooth_logs
from hesr_model.rigid_body import observations
from hesr_model.rigid_body import physical as consistent
from hesr_model.rigid_body.base_parameters import known_columns, sample_regressor, unknown_columns
from hesr_model.rigid_body.elasticity import (
    FIXED,
    ElasticGear,
    GearForm,
    add_gears,
    build_gears,
    gear_forms,
)
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.least_squares import Block, Solution, estimate_covariance, solve
from hesr_model.robots.robot import Robot, RobotLike, to_robot
from hesr_model.support import plugins
from hesr_model.support.arrays import Array, Integers, Mask
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.frames import html_table
from hesr_model.support.typed_files import Numbers, from_json, read_json, to_json, write_json
from hesr_model.units import unit_of_joint

RIGID_BODY_FORMAT = "hesr-rigid-body-1"
Method = Literal["stacked", "paper"]
Weighting = Literal["wls", "ols"]
Kind = Literal["nominal", "physical", "free"]
"""Masses of the model file, physically possible ones, or those of plain least squares."""
MIN_PEAK_SPEED = 0.02  # peak speed that determines an inertia [rad/s, m/s]
_MIN_ERROR_SHARE = 1e-2  # share of the largest torque error to propagate
_STATE_COUNT = 60  # random positions at which an inertia is checked
ROWS_AT_ONCE = 4096  # samples per evaluation of the regressor
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidBody:
    """Identified rigid-body parameters of a robot.

    Attributes
    ----------
    robot, joints : names.
    names, parameters : standard parameters and rotor inertias (P,), zero
        outside `base` except in physically consistent bodies, bodies with a
        payload, and known parameters.
    base : indices of the base parameters, to which all others reduce linearly
        (eq. 6).
    standard_errors : of the base parameters (len(base),), the contribution of
        the others included.
    condition : condition number of the weighted observation matrix, columns
        divided by their size over random states.
    ridge : pull towards zero on that scale over the largest singular value, if
        needed.
    friction : (n, 3) Coulomb [N.m], viscous [N.m.s/rad] and offset [N.m] of the
        stacked fit at friction coordinates (`robots.transmission`); not the
        friction model.
    rmse : (n,) [N.m] residual at friction coordinates, over the rows used.
    rows : number of samples offered to the fit.
    logs : names of the logs.
    kind : whether masses are those of the model file, physically possible, or
        free.
    left_out_rmse : (n,) [N.m] residual at friction coordinates over rows that
        were left out in turn (`rigid_body.choice`); empty if unknown.
    held : parameters that the motion does not determine, which have the model
        file's values.
    sentence : how the kind was chosen, in words.
    covariance : covariance of the base parameters; None in results of earlier
        versions.
    gears : elastic gears, of robots with link encoders.
    provenance : JSON data: input files with hashes, seed and versions.
    """

    robot: str
    joints: tuple[str, ...]
    names: tuple[str, ...]
    parameters: Numbers
    base: tuple[int, ...]
    standard_errors: Numbers
    condition: float
    ridge: float
    friction: Numbers
    rmse: Numbers
    rows: int
    logs: tuple[str, ...]
    method: Method
    weighting: Weighting
    kind: Kind = "free"
    left_out_rmse: Numbers = field(default_factory=lambda: np.zeros(0))
    held: tuple[str, ...] = ()
    sentence: str = ""
    covariance: Covariance | None = None
    gears: tuple[ElasticGear, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def physical(self) -> bool:
        """Whether the bodies were identified with positive mass density."""
        return self.kind == "physical"

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a rigid body that `write` or `hesr identify` has written.

        Raises ArtifactError if the file cannot be read, or a key or value is
        missing or invalid.
        """
        path = to_path(path, "a rigid body")
        data = read_json(path, RIGID_BODY_FORMAT)
        # Version 1 has this key instead of `kind`.
        if data.pop("physical", False) is True:
            data["kind"] = "physical"
        return from_json(cls, data, path, "a rigid body")

    def write(self, path: PathArg) -> None:
        """Write the rigid body as JSON, all digits; ArtifactError if the file cannot be written."""
        write_json(to_path(path, "a rigid body"), {"format": RIGID_BODY_FORMAT, **to_json(self)})

    def __repr__(self) -> str:
        return (
            f"RigidBody('{self.robot}', {len(self.joints)} joints, {len(self.base)} base "
            f"parameters, condition number {self.condition:.3g})"
        )

    def _repr_html_(self) -> str:
        rows = []
        for k, error in zip(self.base, self.standard_errors, strict=True):
            rows.append((self.names[k], float(self.parameters[k]), float(error)))
        head = ("base parameter [SI]", "value", "standard error")
        return html_table(f"Rigid body of '{self.robot}', {self.method}", head, rows)

    def plot(self, log: Log, robot: RobotLike | None = None) -> Any:
        """Draw measured torque and that of the bodies over time; return matplotlib axes (n,).

        Parameters
        ----------
        log : motion of the robot.
        robot : by default that of the log.

        Raises
        ------
        RobotError
            If the robot is unknown or another one.
        """
        if robot is None:
            robot = log.robot
        if robot is None:
            raise RobotError(f"{log.where}: the log does not name its robot; give 'robot'.")
        model = to_robot(robot)
        motion = smooth(log, model.description.log.filter_cutoff)
        tau_body = self.torque(model, motion)
        draw = plugins.find("hesr.objects", "plot-body")
        return draw(self.joints, model.slides, motion.t, motion.tau, tau_body)

    def separate_friction(self, log: Log, robot: RobotLike | None = None) -> list[FrictionRecord]:
        """Return the friction of each joint in a log: torque less that of the bodies.

        Parameters
        ----------
        log : motion of the robot.
        robot : by default that of the log.

        Returns
        -------
        list of FrictionRecord
            For each joint arrays (N,): `t` [s], `q` [rad], `dq` [rad/s],
            load `tau_load` and friction `tau` [N.m], not smoothed.

        Raises
        ------
        LogError, RobotError
            If the robot is unknown or another one.
        """
        separate_friction = plugins.find("hesr.objects", "separate-friction")
        records: list[FrictionRecord] = separate_friction(log, self, robot)
        return records

    def torque(self, model: Robot, motion: Motion) -> Array:
        """Return the torque Y_b pi_b (eq. 6), (N, n) [N.m]; RobotError for another robot."""
        return model.torque(self.parameters_for(model), *motion.states)

    def parameters_for(self, model: Robot) -> Array:
        """Return the parameters (P,), or raise RobotError for another robot."""
        if self.names != model.parameter_names:
            raise RobotError(
                f"the rigid body of '{self.robot}' with {len(self.names)} parameters does not fit "
                f"robot '{model.description.name}', which has {len(model.parameter_names)}: "
                "identify it with the same robot file."
            )
        return self.parameters

    def torque_spread(self, model: Robot, motion: Motion) -> Array | None:
        """Return torque errors over a motion, (N, n, r) [N.m]; None if the covariance is unknown.

        They are for one standard deviation of each of the r independent
        parameter errors that matter.
        """
        if self.covariance is None:
            return None
        values, vectors = np.linalg.eigh(self.covariance.matrix)
        spread = vectors * np.sqrt(np.maximum(values, 0.0))
        columns = list(self.base)
        _, s, vt = np.linalg.svd(sample_regressor(model)[:, columns] @ spread, full_matrices=False)
        spread = spread @ vt[s > _MIN_ERROR_SHARE * s[0]].T
        parts = []
        for first in range(0, len(motion.t), ROWS_AT_ONCE):
            rows = slice(first, first + ROWS_AT_ONCE)
            states = [state[rows] for state in motion.states]
            parts.append(model.regressor(*states)[:, :, columns] @ spread)
        return np.concatenate(parts)

    @pydantic.model_serializer(mode="wrap")
    def _by_name(self, serialise: pydantic.SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = serialise(self)
        names = data.pop("names")
        for name in ("covariance", "gears", "left_out_rmse", "held", "sentence"):  # as in version 1
            if not data[name]:
                del data[name]
        data["parameters"] = dict(zip(names, data["parameters"], strict=True))
        return data | {"base": [names[k] for k in self.base]}

    @pydantic.model_validator(mode="before")
    @classmethod
    def _from_names(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        parameters = data.get("parameters", {})
        if not isinstance(parameters, dict):
            raise RuleError(
                "its parameters have no names", code="body.parameters", key="parameters"
            )
        values: dict[str, Any] = {"names": list(parameters)}
        if parameters:
            values["parameters"] = list(parameters.values())
        if "kind" not in data and "physical" in data:  # of earlier versions
            values["kind"] = "physical" if data["physical"] is True else "free"
            data = {key: value for key, value in data.items() if key != "physical"}
        return data | values

    @pydantic.field_validator("base", mode="before")
    @classmethod
    def _indices(cls, base: Any, info: pydantic.ValidationInfo) -> list[int]:
        names = info.data.get("names", ())
        if not isinstance(base, list) or any(name not in names for name in base):
            raise RuleError("expected names of parameters", code="body.base")
        return [names.index(name) for name in base]


def identify(
    logs: Sequence[Log],
    robot: Robot,
    *,
    method: Method = "stacked",
    weighting: Weighting | None = None,
    reversed_logs: Sequence[Log] = (),
    physical: bool = False,
) -> RigidBody:
    """Identify rigid-body parameters from logs; errors as `identify_motions`, LogError."""
    require_moving([*logs, *reversed_logs], robot.description.joints)
    return identify_motions(
        smooth_logs(logs, robot),
        robot,
        method=method,
        weighting=weighting,
        reversed_motions=smooth_logs(reversed_logs, robot),
        physical=physical,
    )


def identify_motions(
    motions: Sequence[Motion],
    robot: Robot,
    *,
    method: Method = "stacked",
    weighting: Weighting | None = None,
    reversed_motions: Sequence[Motion] = (),
    physical: bool = False,
    warns: bool = True,
    holds: bool = True,
) -> RigidBody:
    """Identify the rigid-body parameters from smooth motions; raises FitError.

    Method ``"stacked"`` solves one least-squares problem over all motions, forward and reversed,
    with Coulomb, viscous and offset coefficients of every joint. ``"paper"`` averages torque and
    regressor of each motion and of its `reversed_motions` counterpart at the same position, where
    odd friction cancels (eq. 7). Either drops slow rows (`observations.SLOW`).

    Weighting ``"wls"`` (default of the stacked method) weighs each joint by its residual's standard
    deviation, ``"ols"`` (default of the paper's) does not.

    With `physical` (`rigid_body.physical`), all standard parameters are weakly pulled towards the
    model file's. If `holds`, inertias of a bench that would be negative have the model file's
    values. Unless `warns`, a poorly determined problem is not logged.
    """
    body = _identify(
        motions,
        robot,
        method=method,
        weighting=weighting,
        reversed_motions=reversed_motions,
        physical=physical,
        warns=warns,
    )
    if not holds:
        return body
    held_names = _find_impossible_inertias(body, robot)
    if not held_names:
        return body
    known_names = (*(robot.description.known or ()), *held_names)
    held_body = _identify(
        motions,
        fix_parameters(robot, known_names),
        method=method,
        weighting=weighting,
        reversed_motions=reversed_motions,
        physical=False,
        warns=warns,
    )
    return replace(held_body, held=held_names)


def fix_parameters(robot: Robot, names: Sequence[str]) -> Robot:
    """Return a robot whose named inertial parameters are known to be the model file's."""
    fixed_robot = copy(robot)
    fixed_robot.description = robot.description.model_copy(update={"known": tuple(names)})
    return fixed_robot


def _find_impossible_inertias(body: RigidBody, robot: Robot) -> tuple[str, ...]:
    """Return the identified masses and inertias of a bench's axes whose inertia is not positive.

    Motion that hardly needs torque for acceleration does not determine them: what friction does
    at each reversal then looks like a mass, of either sign. Robots with masses in their model file
    have physically possible ones instead.
    """
    if robot.description.known is None or body.physical:
        return ()
    lower, upper, _ = robot.reach
    q = np.random.default_rng(0).uniform(lower, upper, (_STATE_COUNT, robot.n))
    masses, _ = robot.dynamics(body.parameters, q, np.zeros_like(q))
    lowest_inertias = np.diagonal(masses, axis1=1, axis2=2).min(axis=0)
    impossible_joints = {
        joint for joint, inertia in zip(robot.joints, lowest_inertias, strict=True) if inertia <= 0
    }
    identified_names = [robot.parameter_names[k] for k in body.base if k < robot.inertial]
    return tuple(
        name
        for name in identified_names
        if name.rpartition(".")[0] in impossible_joints and not _is_first_moment(name)
    )


def _is_first_moment(name: str) -> bool:
    """Return whether a parameter is that of gravity on a turning axis, which needs no speed."""
    return name.endswith((".mx", ".my", ".mz"))


def _identify(
    motions: Sequence[Motion],
    robot: Robot,
    *,
    method: Method,
    weighting: Weighting | None,
    reversed_motions: Sequence[Motion],
    physical: bool,
    warns: bool,
) -> RigidBody:
    if physical and robot.description.known:
        raise FitError(
            f"robot '{robot.name}': 'physical' excludes 'known' of the robot file; remove one."
        )
    forms = _find_gear_forms([*motions, *reversed_motions], robot)
    if forms and (physical or method == "paper"):
        raise FitError(
            f"robot '{robot.name}': link encoders ('log.columns.q_link') exclude 'physical' and "
            "'method' paper; leave them out."
        )
    problem = _Problem(
        motions=observations.remove_known_torque(motions, robot),
        reversed_motions=observations.remove_known_torque(reversed_motions, robot),
        robot=robot,
        method=method,
        forms=forms,
    )
    problem.require_data()
    weighting = weighting or ("ols" if method == "paper" else "wls")
    blocks = problem.build_blocks(problem.base)
    solution = solve(
        blocks,
        scale=problem.build_scale(),
        weighted=weighting == "wls",
        is_loose=problem.mark_loose_columns(),
    )
    if warns and not physical:
        warn_of_ridge(problem.where, solution)
    covariance = estimate_covariance(blocks, solution, problem.labels)
    body = build_body(
        solution,
        covariance,
        robot,
        problem.base,
        problem.friction,
        rows=problem.row_count,
        logs=problem.logs,
        method=method,
        weighting=weighting,
    )
    if forms:
        std_errors = covariance.standard_errors
        gears = build_gears(forms, robot.joints, solution.x, std_errors, problem.link_columns)
        return replace(body, gears=gears)
    if not physical:
        return body
    all_columns = tuple(range(len(body.names)))
    return _make_consistent(
        body, problem.build_blocks(all_columns), robot, problem.friction, problem.labels
    )


def _find_gear_forms(motions: Sequence[Motion], robot: Robot) -> list[GearForm]:
    """Return the forms of elastic gears, from rows of fast motion."""
    fast_rows = []
    if motions:
        fast_rows = observations.find_fast_rows(motions, robot)
    return gear_forms(motions, robot, fast_rows)


class _Problem:
    """Columns and rows of one least-squares problem, motions without known torque.

    Attributes
    ----------
    base : indices of the unknown base parameters, whose columns come first.
    friction : (n, 3) whether Coulomb, viscous and offset friction have a column.
    peaks : (n,) peak speeds of friction coordinates.
    link_columns : (n, 2) Coulomb and viscous columns of the link side of gears.
    """

    def __init__(
        self,
        *,
        motions: Sequence[Motion],
        reversed_motions: Sequence[Motion],
        robot: Robot,
        method: Method,
        forms: Sequence[GearForm],
    ) -> None:
        self._motions = motions
        self._reversed_motions = reversed_motions
        self._all_motions = [*motions, *reversed_motions]
        self._robot = robot
        self._method = method
        self._forms = forms
        self.base = unknown_columns(robot, rotors=bool(forms))
        self.friction = observations.friction_columns(robot, self.base) & (method == "stacked")
        is_determined = observations.find_determined_friction(self._all_motions, robot)
        if forms:
            is_determined[:, :2] = True  # columns of links, which `add_gears` fills
        self.friction &= is_determined
        places = len(self.base) + np.cumsum(self.friction).reshape(self.friction.shape) - 1
        self.link_columns = places[:, :2]
        self.where = "log " + ", ".join(motion.name for motion in self._all_motions)
        self.logs = tuple(dict.fromkeys(motion.name for motion in self._all_motions))
        self.row_count = sum(len(motion.t) for motion in self._all_motions)

    def require_data(self) -> None:
        """Raise FitError if samples or speeds do not suffice."""
        unknown_count = len(self.base) + int(np.sum(self.friction))
        require_samples(self.where, self.row_count, unknown_count)
        min_speeds = np.zeros(self._robot.n)
        if any(k < self._robot.inertial for k in self.base):
            # A resting joint rests up to `MIN_PEAK_SPEED`, a slow one only up to a part of its
            # peak.
            min_speeds = observations.find_min_speeds(self._all_motions, self._robot)
        require_speed(self.where, self.peaks, self._robot, min_speeds)

    @cached_property
    def peaks(self) -> Array:
        """See the class."""
        return observations.peak_speeds(self._all_motions, self._robot)

    @property
    def labels(self) -> Integers:
        """Log number (samples,) of each sample; the paper's are those of forward motions."""
        if self._method == "paper":
            return observations.label_samples(self._motions)
        return observations.label_samples(self._all_motions)

    def build_blocks(self, columns: tuple[int, ...]) -> list[Block]:
        """Return the rows of each friction coordinate, with columns of inertial parameters."""
        if self._method == "paper":
            return observations.average_blocks(
                self._motions, self._reversed_motions, self._robot, columns
            )
        blocks = observations.stack_blocks(self._all_motions, self._robot, columns, self.friction)
        if not self._forms:
            return blocks
        return add_gears(blocks, self._forms, columns, self._robot, self.link_columns)

    def build_scale(self) -> Array:
        """Return the size of each column [N.m], those of gears last."""
        body_scale = compute_scale(self._robot, self.base, self.friction, self.peaks)
        gear_sizes = [np.sqrt(np.mean(form.columns**2, axis=0)) for form in self._forms]
        return np.concatenate([body_scale, *gear_sizes])

    def mark_loose_columns(self) -> Mask:
        """Return whether each column is that of a spring, or of an element of a gear."""
        is_spring = find_loose_columns(self._robot, self.base, self.friction)
        is_element = [np.arange(form.columns.shape[1]) >= FIXED for form in self._forms]
        return np.concatenate([is_spring, *is_element])


def _make_consistent(
    body: RigidBody, blocks: Sequence[Block], robot: Robot, friction: Mask, labels: Integers
) -> RigidBody:
    with threadpool_limits(1):
        physical_fit = consistent.fit(
            blocks, robot, body.base, labels, rmse=body.rmse, weighted=body.weighting == "wls"
        )
    return replace(
        body,
        parameters=physical_fit.parameters,
        standard_errors=physical_fit.covariance.standard_errors,
        covariance=physical_fit.covariance,
        ridge=0.0,
        friction=observations.arrange_by_joint(physical_fit.friction, friction),
        rmse=physical_fit.rmse,
        kind="physical",
    )


def compute_scale(robot: Robot, base: tuple[int, ...], friction: Mask, peak_speeds: Array) -> Array:
    """Return the size of each column [N.m]; that of friction columns is 1.

    The column of viscous friction has the size of the peak speed (n,) [rad/s] if a joint is slow.
    Otherwise its friction would count as undetermined, only because of the unit of speed.
    """
    body_scale = np.sqrt(np.mean(sample_regressor(robot)[:, list(base)] ** 2, axis=0))
    sizes = np.ones(friction.shape)
    sizes[:, 1] = np.where(peak_speeds > 0.0, np.minimum(peak_speeds, 1.0), 1.0)
    return np.concatenate([body_scale, sizes[friction]])


def find_loose_columns(robot: Robot, base: tuple[int, ...], friction: Mask) -> Mask:
    """Return whether each column is that of a spring."""
    columns = np.array([*base, *[-1] * int(np.sum(friction))], dtype=int)
    return columns >= robot.inertial


def build_body(
    solution: Solution,
    covariance: Covariance,
    robot: Robot,
    base: tuple[int, ...],
    friction: Mask,
    *,
    rows: int,
    logs: tuple[str, ...],
    method: Method,
    weighting: Weighting,
) -> RigidBody:
    """Return the rigid body of a solution."""
    names = [robot.parameter_names[k] for k in base]
    covariance = covariance.transform(names, np.eye(len(base), len(solution.x)))
    parameters = np.zeros(len(robot.parameter_names))
    parameters[list(base)] = solution.x[: len(base)]
    known_indices = known_columns(robot)
    parameters[known_indices] = robot.nominal_parameters[known_indices]
    friction_coefficients = solution.x[len(base) :][: np.sum(friction)]
    return RigidBody(
        robot=robot.description.name,
        joints=robot.description.joints,
        names=robot.parameter_names,
        parameters=parameters,
        base=base,
        standard_errors=covariance.standard_errors,
        condition=solution.condition,
        ridge=solution.ridge,
        friction=observations.arrange_by_joint(friction_coefficients, friction),
        rmse=solution.rmse[: robot.n],
        rows=rows,
        logs=logs,
        method=method,
        weighting=weighting,
        covariance=covariance if base else None,
    )


def warn_of_ridge(where: str, solution: Solution) -> None:
    """Warn if a ridge was needed."""
    if solution.ridge:
        _log.warning(
            "%s: the motion does not determine all parameters (condition number %.2g); "
            "a ridge of %.2g of the largest singular value was used",
            where,
            solution.condition,
            solution.ridge,
        )


def require_samples(where: str, row_count: int, unknown_count: int) -> None:
    """Raise FitError if there are fewer samples than unknowns."""
    if row_count < unknown_count:
        raise FitError(
            f"{where}: {row_count} samples cannot determine {unknown_count} parameters; "
            "longer logs are needed."
        )


def require_speed(where: str, peaks: Array, robot: Robot, min_peaks: Array) -> None:
    """Raise FitError if a joint's peak speed is not above `min_peaks` (n,) [rad/s, m/s]."""
    joints = robot.description.joints
    for j, (peak, min_peak) in enumerate(zip(peaks, min_peaks, strict=True)):
        if not peak > min_peak:
            unit = unit_of_joint("rad/s", is_prismatic=robot.slides[j])
            raise FitError(
                f"{where}: joint '{joints[j]}' is never faster than {peak:.2g} {unit}; at least "
                f"one log must exceed {min_peak:g} {unit}."
            )
