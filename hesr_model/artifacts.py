"""Rigid bodies and friction models as JSON: names, structures, numbers and units; never code.

The registry rebuilds a law's expressions from its name and structure, so nothing in a file is ever
parsed as a formula.
"""

import json
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hesr_model.errors import ArtifactError
from hesr_model.files import sha256, written_whole
from hesr_model.friction.audit import audit
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.laws import estimator
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained import TrainedRange
from hesr_model.rigid_body import RigidBody
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


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON whole, with every digit of every number."""
    with written_whole(path) as temporary:
        temporary.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path, expected_format: str) -> dict[str, Any]:
    """Read a JSON artifact of the expected format.

    Raises
    ------
    ArtifactError
        If the file is missing, not JSON, or of another format.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ArtifactError(f"{path}: no such file.") from error
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ArtifactError(f"{path}: not a readable JSON file ({error}).") from error
    found = data.get("format") if isinstance(data, dict) else None
    if found != expected_format:
        raise ArtifactError(f"{path}: 'format' is {found!r}, needed is '{expected_format}'.")
    return dict(data)


def write_rigid_body(path: Path, rigid_body: RigidBody, source: Mapping[str, Any]) -> None:
    """Write an identified rigid body with its provenance."""
    write_json(path, {"format": RIGID_BODY_FORMAT, **rigid_body.to_dict(), "provenance": source})


def read_rigid_body(path: Path) -> RigidBody:
    """Read a rigid body.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing in it.
    """
    data = read_json(path, RIGID_BODY_FORMAT)
    with _named(path, "rigid body"):
        return RigidBody.from_dict(data)


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


def model_to_json(model: FrictionModel) -> dict[str, Any]:
    """Return a friction model as JSON data."""
    ranges = model.trained or (None,) * len(model.laws)
    errors = [{"training_rmse": e} for e in model.training_rmse] or [{}] * len(model.laws)
    return {
        "format": MODEL_FORMAT,
        "law": model.law,
        "robot": model.robot,
        "sample_time": model.sample_time,
        "joints": [
            {
                "joint": joint,
                # Said of those that slide only: files of older versions know no others.
                **({"sliding": True} if slides else {}),
                **_law_to_json(law),
                **_trained_to_json(law, trained),
                **error,
            }
            for joint, slides, law, trained, error in zip(
                model.joints, model.slides, model.laws, ranges, errors, strict=True
            )
        ],
        "provenance": dict(model.provenance),
    }


def model_from_json(path: Path, data: Mapping[str, Any]) -> FrictionModel:
    """Return the friction model of JSON data that stood in a file.

    Raises
    ------
    ArtifactError
        Naming the file and what is missing or unknown in it.
    """
    with _named(path, "friction model"):
        return FrictionModel(
            law=str(data["law"]),
            robot=str(data["robot"]),
            joints=tuple(str(j["joint"]) for j in data["joints"]),
            laws=tuple(_law_from_json(j) for j in data["joints"]),
            sliding=tuple(_slides(j) for j in data["joints"]),
            sample_time=float(data["sample_time"]),
            trained=tuple(
                TrainedRange.from_json(j["trained"]) for j in data["joints"] if "trained" in j
            ),
            training_rmse=tuple(
                float(j["training_rmse"]) for j in data["joints"] if "training_rmse" in j
            ),
            provenance=dict(data["provenance"]),
        )


@contextmanager
def _named(path: Path, kind: str) -> Iterator[None]:
    """Turn what goes wrong with an artifact's data into one sentence that names the file."""
    try:
        yield
    except KeyError as error:
        raise ArtifactError(f"{path}: key {error} is missing.") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{path}: not a {kind} ({error}).") from error
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error


def _law_to_json(law: FrictionLaw) -> dict[str, Any]:
    units = {c.name: c.unit for c in law.form.coefficients}
    errors = law.standard_errors
    return {
        "law": law.name,
        "structure": dict(law.structure),
        "coefficients": {
            name: {"value": value, "unit": units[name]}
            | ({"standard_error": errors[name]} if name in errors else {})
            for name, value in law.values.items()
        },
        "discretisation": law.discretisation,
        "start": list(law.start),
        "start_samples": law.start_samples,
    }


def _trained_to_json(law: FrictionLaw, trained: TrainedRange | None) -> dict[str, Any]:
    """Return the trained range and the audit in it, which is for readers: it follows from both."""
    if trained is None:
        return {}
    return {"trained": trained.to_json(), "audit": audit(law, trained).to_json()}


def _slides(data: Mapping[str, Any]) -> bool:
    slides = data.get("sliding", False)
    if not isinstance(slides, bool):
        raise ArtifactError(
            f"'sliding' of joint '{data['joint']}' is {slides!r}; needed is true or false."
        )
    return slides


def _law_from_json(data: Mapping[str, Any]) -> FrictionLaw:
    form = estimator(data["law"]).form(data["structure"])
    if data["discretisation"] not in ("exact", "euler"):
        raise ArtifactError(
            f"'discretisation' is {data['discretisation']!r}; needed is 'exact' or 'euler'."
        )
    for coefficient in form.coefficients:
        entry = data["coefficients"].get(coefficient.name)
        unit = unit_of_joint(coefficient.unit, slides=_slides(data))
        if entry is not None and entry["unit"] != unit:
            raise ArtifactError(
                f"coefficient '{coefficient.name}' has the unit '{entry['unit']}', needed is "
                f"'{unit}'."
            )
    return FrictionLaw(
        name=str(data["law"]),
        structure=data["structure"],
        form=form,
        values={name: float(entry["value"]) for name, entry in data["coefficients"].items()},
        discretisation=data["discretisation"],
        start=tuple(float(x) for x in data["start"]),
        start_samples=int(data.get("start_samples", 0)),
        standard_errors={
            name: float(entry["standard_error"])
            for name, entry in data["coefficients"].items()
            if "standard_error" in entry
        },
    )
