"""Friction models: one frozen law for each joint of a robot."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from hesr_model.errors import ArtifactError, SimulationError
from hesr_model.friction.band import LEVEL
from hesr_model.friction.built_in import model_file
from hesr_model.friction.expressions import CoefficientRow, CoefficientTable, LawExpressions
from hesr_model.friction.law import FrictionLaw, add_low_pass, equations
from hesr_model.friction.log_friction import (
    LogSource,
    mean_determination,
    read_log,
    separate_friction,
)
from hesr_model.friction.model_file import MODEL_FORMAT, JointEntry, ModelFile
from hesr_model.friction.predict import predict_band, predict_joints
from hesr_model.friction.records import predict_record
from hesr_model.friction.servo import FittedServo
from hesr_model.friction.thermal import Thermal
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import transform_records
from hesr_model.robots.robot import RobotLike
from hesr_model.robots.transmission import Coupling
from hesr_model.support import plugins
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.frames import html_table
from hesr_model.support.text import require_printable
from hesr_model.support.typed_files import from_json, read_json, to_json, write_json
from hesr_model.units import unit_of_joints

if TYPE_CHECKING:
    from hesr_model.audit.certificate import Certificate

MIXED = "recommended"  # name of a model with a law of its own on each joint
# Parts of each joint.
_OPTIONAL_PARTS = ("trained", "training_rmse", "left_out_rmse", "thermal", "servos")
_MAX_SHOWN_COEFFICIENTS = 40  # coefficients of a law up to which notebooks show its equations


@dataclass(frozen=True, kw_only=True)
class FrictionModel:
    """One law for each joint of a robot.

    Attributes
    ----------
    law : name of the law, as in the registry or of a published model.
    laws : law of each joint, in the units of prismatic joints if it is one.
    sliding : True for prismatic joints, with positions in m and forces in N;
        empty if none.
    coupling : map from joints to friction coordinates if they differ; laws,
        trained ranges and training errors are then of these coordinates.
    sample_time : sample period of the training data [s].
    trained : ranges of each law's training records; empty if unknown.
    training_rmse : error of each law on those records [N.m]; empty if unknown.
    left_out_rmse : the same on logs left out in turn [N.m]; empty if unknown.
    thermal : thermal model of each joint; empty if unknown.
    servos : servo of each joint, fitted with the law from commands; empty for
        laws of torques.
    provenance : JSON data on the origin of the model (files with hashes, seed,
        versions).
    rigid_body : body by which friction was separated from the logs, for
        predictions of further logs; None if the model was read from a file,
        which does not contain it.

    Raises
    ------
    ArtifactError
        If numbers of entries and joints differ, or the sample time is not
        positive.
    """

    law: str
    robot: str
    joints: tuple[str, ...]
    laws: tuple[FrictionLaw, ...]
    sliding: tuple[bool, ...] = ()
    coupling: Coupling | None = None
    sample_time: float
    trained: tuple[TrainedRange, ...] = ()
    training_rmse: tuple[float, ...] = ()
    left_out_rmse: tuple[float, ...] = ()
    thermal: tuple[Thermal, ...] = ()
    servos: tuple[FittedServo, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    rigid_body: RigidBody | None = field(default=None, repr=False, compare=False)

    @property
    def size(self) -> int:
        """Total number of coefficients, a measure of computing time."""
        return sum(len(law.values) for law in self.laws)

    def __post_init__(self) -> None:
        if not self.joints or len(self.joints) != len(self.laws):
            raise ArtifactError(
                f"friction model '{self.law}': {len(self.laws)} laws for {len(self.joints)} "
                "joints.",
                code="law.joints",
                key="joints",
            )
        self._require_names()
        self._require_entries()
        self._require_coupling()
        if not 0.0 < self.sample_time < inf:
            raise ArtifactError(
                f"friction model '{self.law}': sample time is {self.sample_time} s; expected a "
                "positive number.",
                code="law.sample_time",
                key="sample_time",
            )
        if not any(self.sliding):
            object.__setattr__(self, "sliding", ())
        laws = []
        for law, is_prismatic in zip(self.laws, self.slides, strict=True):
            # Here, so that units always match the joints.
            laws.append(replace(law, form=law.form.sliding) if is_prismatic else law)
        object.__setattr__(self, "laws", tuple(laws))

    def _require_names(self) -> None:
        """Raise ArtifactError for names of joints that cannot be printed."""
        for name in self.joints:
            try:
                require_printable(name)
            except ValueError as error:
                sentence = f"friction model '{self.law}': {error}."
                raise ArtifactError(sentence, code="law.joint_name", key="joints") from error

    def _require_entries(self) -> None:
        """Raise ArtifactError for optional parts of another number of joints."""
        for entries, entry_kind in (
            (self.sliding, "flags of prismatic joints for"),
            (self.trained, "trained ranges for"),
            (self.training_rmse, "training errors for"),
            (self.left_out_rmse, "errors on left-out logs for"),
            (self.thermal, "thermal models for"),
            (self.servos, "servos for"),
        ):
            if entries and len(entries) != len(self.joints):
                raise ArtifactError(
                    f"friction model '{self.law}': {len(entries)} {entry_kind} "
                    f"{len(self.joints)} joints.",
                    code="law.entries",
                    key="joints",
                )

    def _require_coupling(self) -> None:
        """Raise ArtifactError for a coupling of other joints, or of joints with heat."""
        if self.thermal and self.coupling:
            raise ArtifactError(
                f"friction model '{self.law}': a thermal model does not support coupled joints.",
                code="law.thermal_coupling",
                key="coupling",
            )
        if self.coupling and len(self.coupling.matrix) != len(self.joints):
            raise ArtifactError(
                f"friction model '{self.law}': a coupling of {len(self.coupling.matrix)} joints "
                f"for {len(self.joints)} joints.",
                code="law.coupling",
                key="coupling",
            )

    def __repr__(self) -> str:
        return f"FrictionModel('{self.law}' of '{self.robot}', {len(self.joints)} joints)"

    def _repr_html_(self) -> str:
        errors = self.training_rmse or ("",) * len(self.joints)
        rows = []
        for joint, law, error in zip(self.joints, self.laws, errors, strict=True):
            description: str | FrictionLaw = law
            if len(law.values) <= _MAX_SHOWN_COEFFICIENTS:
                description = "; ".join(equations(law))
            rows.append((joint, description, error))
        head = ("joint", "law", f"training RMSE [{unit_of_joints('N.m', self.sliding)}]")
        return html_table(f"Friction of '{self.robot}' by the law '{self.law}'", head, rows)

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a friction model written by `write` or `hesr fit`, or uf850-table1.

        Raises ArtifactError if the file cannot be read, or a key or value is
        missing or invalid.
        """
        path = model_file(str(to_path(path, "a friction model")))
        return cls.from_json(read_json(path, MODEL_FORMAT), path)

    def write(self, path: PathArg) -> None:
        """Write the model as JSON, or raise ArtifactError."""
        write_json(to_path(path, "a friction model"), self.to_json())

    @classmethod
    def from_json(cls, data: Mapping[str, Any], path: Path) -> Self:
        """Return the model of JSON data; raises ArtifactError, which names `path`, if invalid."""
        file = from_json(ModelFile, data, path, "a friction model")
        joints = file.joints
        parts: dict[str, Any] = {name: _collect_part(joints, name) for name in _OPTIONAL_PARTS}
        try:
            return cls(
                law=file.law,
                robot=file.robot,
                joints=tuple(entry.joint for entry in joints),
                laws=tuple(entry.rebuild_law() for entry in joints),
                sliding=tuple(bool(entry.sliding) for entry in joints),
                coupling=file.coupling,
                sample_time=file.sample_time,
                provenance=file.provenance,
                **parts,
            )
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise ArtifactError(
                f"{path}: not a friction model ({error}).",
                code="law.data",
                where=path,
                key="joints",
            ) from error
        except ArtifactError as error:
            raise error.add_place(path) from error

    def to_json(self) -> dict[str, Any]:
        """Return the JSON data of the model's file."""
        entries = []
        for j, law in enumerate(self.laws):
            parts: dict[str, Any] = {}
            for name in _OPTIONAL_PARTS:
                joint_parts = getattr(self, name)
                parts[name] = joint_parts[j] if joint_parts else None
            entry = JointEntry.from_law(
                law, joint=self.joints[j], sliding=self.slides[j] or None, **parts
            )
            entries.append(entry)
        file = ModelFile(
            law=self.law,
            robot=self.robot,
            sample_time=self.sample_time,
            joints=tuple(entries),
            coupling=self.coupling,
            provenance=self.provenance,
        )
        return {"format": MODEL_FORMAT, **to_json(file, sparse=True)}

    def behind_low_pass(self, cutoff: float) -> Self:
        """Return the model with its velocity behind a causal low pass with a `cutoff` [Hz]."""
        return replace(self, laws=tuple(add_low_pass(law, cutoff) for law in self.laws))

    @property
    def slides(self) -> tuple[bool, ...]:
        """True for each prismatic joint."""
        return self.sliding or (False,) * len(self.joints)

    def _repr_latex_(self) -> str:
        shown_laws = [
            (joint, law)
            for joint, law in zip(self.joints, self.laws, strict=True)
            if len(law.values) <= _MAX_SHOWN_COEFFICIENTS
        ]
        lines = [rf"\text{{{joint}: }} & {law.latex()}" for joint, law in shown_laws]
        rows = " \\\\\n".join(lines)
        return f"$\\displaystyle \\begin{{aligned}}\n{rows}\n\\end{{aligned}}$"

    def equation(self) -> str:
        """Return the laws as text, joint by joint, to four digits."""
        lines = []
        for joint, law in zip(self.joints, self.laws, strict=True):
            lines += [f"{joint}:", *(f"  {line}" for line in equations(law))]
        return "\n".join(lines)

    def sympy(self) -> dict[str, LawExpressions]:
        """Return the expressions of each joint, with values and units."""
        return {
            joint: law.to_expressions() for joint, law in zip(self.joints, self.laws, strict=True)
        }

    def latex(self) -> dict[str, str]:
        """Return the equations of each joint in LaTeX, to four digits."""
        return {joint: law.latex() for joint, law in zip(self.joints, self.laws, strict=True)}

    def coefficients(self) -> CoefficientTable:
        """Return the coefficients with units, errors and the bounds that were hit."""
        rows: list[CoefficientRow] = []
        for joint, law in zip(self.joints, self.laws, strict=True):
            rows += law.coefficient_rows(joint)
        return CoefficientTable(law=self.law, rows=tuple(rows), provenance=self.provenance)

    def passivity(self) -> "dict[str, Certificate]":
        """Return for each joint whether its law is passive, or only tested.

        Raises SimulationError if the ranges of the training are unknown.
        """
        from hesr_model.audit.certificate import certify

        if not self.trained:
            raise SimulationError(
                f"friction model '{self.law}' has no trained ranges; fit it to logs."
            )
        return {
            joint: certify(law, trained_range)
            for joint, law, trained_range in zip(self.joints, self.laws, self.trained, strict=True)
        }

    def select(self, joint: str) -> Self:
        """Return the model of one joint; SimulationError if it has none."""
        if joint not in self.joints:
            raise SimulationError(
                f"friction model '{self.law}' has no joint '{joint}'; it has "
                f"{', '.join(self.joints)}."
            )
        if self.coupling is not None:
            raise SimulationError(
                f"friction model '{self.law}' has laws of coupled joints; use all of them."
            )
        j = self.joints.index(joint)
        parts = ("joints", "laws", "sliding", *_OPTIONAL_PARTS)
        changes: dict[str, Any] = {part: getattr(self, part)[j : j + 1] for part in parts}
        return replace(self, **changes)

    def score(
        self,
        logs: LogSource | Iterable[LogSource],
        *,
        rigid_body: RigidBody | PathArg | None = None,
        robot: RobotLike | None = None,
    ) -> float:
        """Return the coefficient of determination R2, averaged over joints.

        Logs are predicted separately; rows in their gaps do not count.

        Parameters
        ----------
        logs : one or several logs, or paths.
        rigid_body, robot : as in `predict`.

        Raises
        ------
        LogError, SimulationError
            If a log cannot be read or has other joints.
        """
        if isinstance(logs, Log | str | PathLike):
            logs = [logs]
        tau = []
        tau_predicted = []
        for log in logs:
            for part in read_log(log, robot).parts():
                log_records = self.records(part, rigid_body=rigid_body, robot=robot)
                tau.append(np.column_stack([record.tau for record in log_records]))
                tau_predicted.append(self.predict(log_records))
        return mean_determination(np.vstack(tau), np.vstack(tau_predicted))

    def records(
        self,
        log: LogSource,
        *,
        rigid_body: RigidBody | PathArg | None = None,
        robot: RobotLike | None = None,
    ) -> list[FrictionRecord]:
        """Return the measured friction of each joint in a log; see `predict`."""
        if rigid_body is None:
            rigid_body = self.rigid_body
        if rigid_body is None:
            raise SimulationError(
                f"friction model '{self.law}': give 'rigid_body', the result of 'hesr identify', "
                "which separates friction from the torque of the log.",
                code="law.rigid_body",
                key="rigid_body",
            )
        log_records = separate_friction(log, rigid_body, robot)
        by_joint = {record.joint: record for record in log_records}
        if self.coupling is None and set(self.joints) <= by_joint.keys():
            log_records = [by_joint[joint] for joint in self.joints]
        self._require_joints(log_records)
        return log_records

    def plot(
        self,
        log: LogSource,
        *,
        rigid_body: RigidBody | PathArg | None = None,
        robot: RobotLike | None = None,
    ) -> Any:
        """Draw measured and predicted friction of a log over time.

        Parameters
        ----------
        log : log, or its path.
        rigid_body, robot : as in `predict`.

        Returns
        -------
        ndarray of matplotlib axes
            One for each joint.
        """
        records = self.records(log, rigid_body=rigid_body, robot=robot)
        return plugins.find("hesr.objects", "plot-friction")(self, records, self.predict(records))

    def to_fmu(self, path: PathArg, **options: Any) -> Path:
        """Write the model as an FMU, with options of `hesr.export`.

        The default platforms are linux64, win64 and that of this machine.
        """
        fmu: Path = plugins.find("hesr.objects", "to-fmu")(self, path, **options)
        return fmu

    @overload
    def predict(
        self,
        records: Sequence[FrictionRecord] | LogSource,
        *,
        measured_start: bool = False,
        rigid_body: RigidBody | PathArg | None = None,
        robot: RobotLike | None = None,
    ) -> Array: ...

    @overload
    def predict(
        self,
        *,
        t: ArrayLike,
        dq: ArrayLike,
        q: ArrayLike | None = None,
        tau_load: ArrayLike | None = None,
    ) -> Array: ...

    def predict(
        self,
        records: Sequence[FrictionRecord] | LogSource | None = None,
        *,
        t: ArrayLike | None = None,
        dq: ArrayLike | None = None,
        q: ArrayLike | None = None,
        tau_load: ArrayLike | None = None,
        measured_start: bool = False,
        rigid_body: RigidBody | PathArg | None = None,
        robot: RobotLike | None = None,
    ) -> Array:
        """Return the friction torque of all joints, (N, n) [N.m].

        A motion that starts at speed has steady initial states. A thermal model
        takes the temperature of the records, or computes it; for arrays it
        takes the reference temperature.

        Parameters
        ----------
        records : a log, its path, or the records of a log from
            `residual.friction_records`.
        t : (N,) time [s], increasing.
        dq : (N, n) joint velocity [rad/s].
        q : (N, n) joint position [rad]; zero by default.
        tau_load : (N, n) rigid-body torque of the motion [N.m]; zero by
            default.
        measured_start : True to estimate initial states from the first torques
            of a log.
        rigid_body : body, or its file, that gives the load of a log; by default
            that of the fit.
        robot : robot of a log; by default that of the log.

        Raises
        ------
        SimulationError
            If a log has no rigid body, records or arrays do not match the
            model's joints, time does not increase, or the discretisation of a
            law is unstable.
        """
        if isinstance(records, Log | str | PathLike):
            records = self.records(records, rigid_body=rigid_body, robot=robot)
        if records is not None:
            return self._predict_records(records, measured_start=measured_start)
        if t is None or dq is None:
            raise TypeError("predict() takes a log, or the arrays 't' and 'dq'")
        return self._predict_arrays(np.asarray(t, dtype=float), dq, q, tau_load)

    def _predict_records(self, records: Sequence[FrictionRecord], *, measured_start: bool) -> Array:
        """Return the torque at joints, (N, n) [N.m], over the records of a log."""
        self._require_joints(records)
        transformed_records = transform_records(
            [replace(record, coupling=self.coupling) for record in records]
        )
        columns = []
        for j, record in enumerate(transformed_records):
            thermal = self.thermal[j] if self.thermal else None
            columns.append(
                predict_record(self.laws[j], record, measured_start=measured_start, thermal=thermal)
            )
        return self._to_joints(np.column_stack(columns))

    def _predict_arrays(
        self, time: Array, dq: ArrayLike, q: ArrayLike | None, tau_load: ArrayLike | None
    ) -> Array:
        """Return the torque at joints, (N, n) [N.m], over arrays; see `predict`."""
        speed = self._to_rows("dq", dq, len(time))
        position = self._to_rows("q", q, len(time))
        load = self._to_rows("tau_load", tau_load, len(time))
        if np.any(np.diff(time) <= 0.0):
            row = int(np.argmax(np.diff(time) <= 0.0)) + 1
            raise SimulationError(
                f"friction model '{self.law}': time must increase, but t[{row}] is {time[row]:g} s "
                f"after {time[row - 1]:g} s."
            )
        if self.coupling:
            speed = self.coupling.motion(speed)
            position = self.coupling.motion(position)
            load = self.coupling.torque(load)
        return self._to_joints(
            predict_joints(self.laws, t=time, dq=speed, q=position, tau_load=load)
        )

    def predict_band(
        self, records: Sequence[FrictionRecord], *, coverage: float = LEVEL
    ) -> tuple[Array, Array]:
        """Return lower and upper end, (N, n) each [N.m], of the band of a log's friction.

        Parameters
        ----------
        records : records of one log, from `residual.friction_records`.
        coverage : share of the rows within the band, from 0.5 to 0.999.

        Raises
        ------
        SimulationError
            If the records do not match the model's joints, or the model has no
            band.
        """
        return compute_band(
            self,
            t=records[0].t,
            dq=np.column_stack([record.dq for record in records]),
            q=np.column_stack([record.q for record in records]),
            tau_load=np.column_stack([record.tau_load for record in records]),
            torque=self.predict(records),
            coverage=coverage,
        )

    @property
    def banded(self) -> bool:
        """True if the model has a band."""
        return all(law.band for law in self.laws)

    def require_band(self) -> None:
        """Raise SimulationError if the model has no band."""
        if not self.banded:
            raise SimulationError(
                f"friction model '{self.law}' has no band; fit the model to logs ('hesr fit')."
            )

    def _to_joints(self, torque: Array) -> Array:
        if self.coupling is None:
            return torque
        return self.coupling.to_joints(torque)

    def _to_rows(self, name: str, values: ArrayLike | None, count: int) -> Array:
        shape = (count, len(self.joints))
        if values is None:
            return np.broadcast_to(0.0, shape)
        rows = np.asarray(values, dtype=float)
        if rows.shape != shape:
            raise SimulationError(
                f"friction model '{self.law}': '{name}' has the shape {rows.shape}; expected "
                f"{shape}, {count} samples of {len(self.joints)} joints."
            )
        return rows

    def _require_joints(self, log_records: Sequence[FrictionRecord]) -> None:
        record_joints = tuple(record.joint for record in log_records)
        if record_joints != self.joints:
            raise SimulationError(
                f"friction model '{self.law}': the records are of the joints "
                f"{', '.join(record_joints) or 'none'}; expected one record each of "
                f"{', '.join(self.joints)}, in this order."
            )


def compute_band(
    model: FrictionModel,
    *,
    t: Array,
    dq: Array,
    q: Array,
    tau_load: Array,
    torque: Array,
    coverage: float = LEVEL,
) -> tuple[Array, Array]:
    """Return both ends (N, n) around predicted torques (N, n); SimulationError without a band."""
    model.require_band()
    coupling = model.coupling
    if coupling:
        dq = coupling.motion(dq)
        q = coupling.motion(q)
        tau_load = coupling.torque(tau_load)
        torque = coupling.torque(torque)
    lower_columns = []
    upper_columns = []
    for j, law in enumerate(model.laws):
        joint_lower, joint_upper = predict_band(
            law,
            t=t,
            dq=dq[:, j],
            q=q[:, j],
            tau_load=tau_load[:, j],
            torque=torque[:, j],
            coverage=coverage,
        )
        lower_columns.append(joint_lower)
        upper_columns.append(joint_upper)
    lower = np.column_stack(lower_columns)
    upper = np.column_stack(upper_columns)
    if coupling is None:
        return lower, upper
    return coupling.ends(torque, lower, upper)


def can_share_fmu(first_model: FrictionModel, second_model: FrictionModel) -> bool:
    """Whether one FMU can have laws of both models: uncoupled joints, the same integration."""
    laws = (*first_model.laws, *second_model.laws)
    discretisations = {law.discretisation for law in laws}
    return first_model.coupling is None and len(discretisations) == 1


def _collect_part(entries: Iterable[JointEntry], name: str) -> tuple[Any, ...]:
    """Return an optional part of the joints that have it."""
    parts = (getattr(entry, name) for entry in entries)
    return tuple(part for part in parts if part is not None)


def mix_models(models: Sequence[FrictionModel]) -> FrictionModel:
    """Return the model that has on joint k the law of `models[k]`, all of the same joints."""

    def collect_part(part: str) -> tuple[Any, ...]:
        rows = [getattr(model, part) for model in models]
        if not all(rows):
            return ()
        return tuple(row[j] for j, row in enumerate(rows))

    changes: dict[str, Any] = {part: collect_part(part) for part in ("laws", *_OPTIONAL_PARTS)}
    return replace(models[0], law=MIXED, **changes)
