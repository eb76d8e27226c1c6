"""Rigid bodies and friction models as JSON: names, structures, numbers and units; never code.

The registry rebuilds a law's expressions from its name and structure, so nothing in a file is ever
parsed as a formula.
"""

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import StrictBool

from hesr_model.equations.over_log import Discretisation
from hesr_model.errors import ArtifactError
from hesr_model.friction.band import Band
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.registry import estimator
from hesr_model.friction.thermal import Thermal
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.inference.covariance import Covariance
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.transmission import Coupling
from hesr_model.support.files import sha256, written_whole
from hesr_model.support.typed_json import from_json, to_json
from hesr_model.support.untrusted_text import parse_json, read_text
from hesr_model.units import unit_of_joint

MODEL_FORMAT = "hesr-friction-model-1"
RIGID_BODY_FORMAT = "hesr-rigid-body-1"
_VERSIONED = ("hesr", "numpy", "scipy", "sympy", "pin")


def provenance(*, files: Sequence[Path], seed: int | None = None, **more: Any) -> dict[str, Any]:
    """Say where a result comes from: hashes of the files, seed, versions, and what is passed."""
    return {
        "files": [{"name": file.name, "sha256": sha256(file)} for file in files],
        "seed": seed,
        "versions": {"python": platform.python_version(), **{p: version(p) for p in _VERSIONED}},
        **more,
    }


def newest(files: Sequence[Path]) -> str:
    """Return the date of the newest of some files, ISO 8601 in UTC: that of what is made of them.

    It is the same whenever they are used, as today's would not be.
    """
    seconds = max(int(file.stat().st_mtime) for file in files)
    return datetime.fromtimestamp(seconds, tz=UTC).isoformat()


def write_json(path: Path, data: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Write JSON whole, with every digit of every number; without indent it takes a quarter."""
    text = json.dumps(data, indent=indent, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path, expected_format: str | None = None) -> Any:
    """Read a JSON file, of the expected format where one is given, and return all but its name.

    Raises
    ------
    ArtifactError
        If the file is missing, not an object in JSON, or of another format.
    """
    try:
        data = parse_json(read_text(path))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file.") from error
    except (OSError, ValueError) as error:
        raise ArtifactError(f"{path}: not a readable JSON file ({error}).") from error
    if expected_format is None:
        if not isinstance(data, dict):
            raise ArtifactError(f"{path}: not a readable JSON file (it holds no keys).")
        return data
    found = data.pop("format", None) if isinstance(data, dict) else None
    if found != expected_format:
        raise ArtifactError(f"{path}: 'format' is {found!r}, needed is '{expected_format}'.")
    return data


def write_rigid_body(path: Path, rigid_body: RigidBody, source: Mapping[str, Any]) -> None:
    """Write an identified rigid body with its provenance."""
    write_json(path, {"format": RIGID_BODY_FORMAT, **to_json(rigid_body), "provenance": source})


def read_rigid_body(path: Path) -> RigidBody:
    """Read a rigid body.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing in it.
    """
    return from_json(RigidBody, read_json(path, RIGID_BODY_FORMAT), path, "a rigid body")


def write_model(path: Path, model: FrictionModel) -> None:
    """Write a friction model."""
    write_json(path, model_to_json(model))


def read_model(path: Path) -> FrictionModel:
    """Read a friction model and rebuild its expressions from the registry.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing or unknown in it.
    """
    return model_from_json(path, read_json(path, MODEL_FORMAT))


@dataclass(frozen=True, kw_only=True)
class _CoefficientEntry:
    value: float
    unit: str
    standard_error: float | None = None


_AS_IN_LAW = ("discretisation", "start", "start_samples", "covariance", "band")
"""Entries of a joint that are those of its law."""


@dataclass(frozen=True, kw_only=True)
class _JointEntry:
    joint: str
    # Said of those that slide only: files of older versions know no others.
    sliding: StrictBool | None = None
    law: str
    structure: Mapping[str, Any]
    coefficients: Mapping[str, _CoefficientEntry]
    discretisation: Discretisation
    start: tuple[float, ...]
    start_samples: int = 0
    covariance: Covariance | None = None
    band: Band | None = None
    trained: TrainedRange | None = None
    training_rmse: float | None = None
    thermal: Thermal | None = None

    def friction_law(self) -> FrictionLaw:
        form = estimator(self.law).form(self.structure)
        given = self.coefficients
        for coefficient in form.coefficients:
            entry = given.get(coefficient.name)
            unit = unit_of_joint(coefficient.unit, slides=bool(self.sliding))
            if entry is not None and entry.unit != unit:
                raise ArtifactError(
                    f"coefficient '{coefficient.name}' has the unit '{entry.unit}', needed is "
                    f"'{unit}'."
                )
        errors = {name: entry.standard_error for name, entry in given.items()}
        return FrictionLaw(
            name=self.law,
            structure=self.structure,
            form=form,
            values={name: entry.value for name, entry in given.items()},
            standard_errors={name: e for name, e in errors.items() if e is not None},
            **{name: getattr(self, name) for name in _AS_IN_LAW},
        )


@dataclass(frozen=True, kw_only=True)
class _ModelFile:
    law: str
    robot: str
    sample_time: float
    joints: tuple[_JointEntry, ...]
    # Said of robots with coupled joints only.
    coupling: Coupling | None = None
    provenance: Mapping[str, Any]


def model_to_json(model: FrictionModel) -> dict[str, Any]:
    """Return a friction model as JSON data."""
    nothing = (None,) * len(model.laws)
    units = [{c.name: c.unit for c in law.form.coefficients} for law in model.laws]
    file = _ModelFile(
        law=model.law,
        robot=model.robot,
        sample_time=model.sample_time,
        joints=tuple(
            _JointEntry(
                joint=joint,
                sliding=slides or None,
                law=law.name,
                structure=law.structure,
                coefficients={
                    name: _CoefficientEntry(
                        value=value, unit=unit[name], standard_error=law.standard_errors.get(name)
                    )
                    for name, value in law.values.items()
                },
                **{name: getattr(law, name) for name in _AS_IN_LAW},
                trained=trained,
                training_rmse=error,
                thermal=thermal,
            )
            for joint, slides, law, unit, trained, error, thermal in zip(
                model.joints, model.slides, model.laws, units,
                model.trained or nothing, model.training_rmse or nothing,
                model.thermal or nothing, strict=True,
            )
        ),
        coupling=model.coupling,
        provenance=model.provenance,
    )  # fmt: skip
    return {"format": MODEL_FORMAT, **to_json(file, sparse=True)}


def model_from_json(path: Path, data: Mapping[str, Any]) -> FrictionModel:
    """Return the friction model of JSON data that stood in a file.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing or unknown in it.
    """
    file = from_json(_ModelFile, data, path, "a friction model")
    joints = file.joints
    try:
        return FrictionModel(
            law=file.law,
            robot=file.robot,
            joints=tuple(j.joint for j in joints),
            laws=tuple(j.friction_law() for j in joints),
            sliding=tuple(bool(j.sliding) for j in joints),
            coupling=file.coupling,
            sample_time=file.sample_time,
            trained=tuple(j.trained for j in joints if j.trained),
            training_rmse=tuple(j.training_rmse for j in joints if j.training_rmse is not None),
            thermal=tuple(j.thermal for j in joints if j.thermal),
            provenance=file.provenance,
        )
    except (TypeError, ValueError, AttributeError, KeyError) as error:
        raise ArtifactError(f"{path}: not a friction model ({error}).") from error
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error
