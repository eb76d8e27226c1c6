"""Files as data classes: validated TOML, and JSON whose keys are the fields."""

import json
import os
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

import numpy as np
import pydantic
from pydantic import BaseModel, PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole
from hesr_model.support.text import parse_json, parse_toml, read_text, require_printable

_MOST_SHOWN = 200  # characters


class _UnknownKeyError(ValueError):
    def __init__(self, key: str, known: Iterable[str]) -> None:
        super().__init__("it is unknown")
        self.key, self.known = key, ", ".join(sorted(known))


class Config(BaseModel):
    """Base of every schema: immutable, without unknown keys, infinities and NaN."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _require_known_keys(cls, data: Any) -> Any:
        """Refuse an unknown key before pydantic does, which does not name the known ones."""
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                raise _UnknownKeyError(key, cls.model_fields)
        return data

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and validate a TOML file; raises ConfigError."""
        try:
            text = read_text(path)
        except FileNotFoundError as error:
            raise ConfigError(f"{path}: no such file.") from error
        except (OSError, ValueError) as error:
            raise ConfigError(f"{path}: cannot be read ({error}).") from error
        try:
            data = parse_toml(text)
        except ValueError as error:
            raise ConfigError(f"{path}: not valid TOML ({error}).") from error
        return cls.validated(path, data)

    def each(self, key: str, joints: int) -> tuple[Any, ...]:
        """Return the value of each joint, where a file gives one for all or one per joint."""
        value = getattr(self, key)
        return value if isinstance(value, tuple) else (value,) * joints

    @classmethod
    def validated(cls, path: Path, data: Any) -> Self:
        """Validate data read from a file; errors as `read`."""
        try:
            return cls.model_validate(data, context={"folder": path.parent})
        except ValidationError as error:
            raise ConfigError(_refusal(path, error)) from error
        except RecursionError as error:
            raise ConfigError(f"{path}: it is nested too deeply.") from error


def _beside_the_toml(path: Path, info: pydantic.ValidationInfo) -> Path:
    folder: Path = (info.context or {}).get("folder", Path())
    # Not `Path.resolve`, which fails on circular links before Python 3.13.
    return Path(os.path.realpath(folder / path))


RelativePath = Annotated[Path, pydantic.AfterValidator(_beside_the_toml)]  # to its TOML file
PrintableName = Annotated[str, pydantic.AfterValidator(require_printable)]  # as FMUs need


def _refusal(path: Path, error: ValidationError) -> str:
    problems = error.errors()
    for problem in problems:
        if isinstance(unknown := problem.get("ctx", {}).get("error"), _UnknownKeyError):
            key = ".".join(map(str, (*problem["loc"], unknown.key)))
            return f"{path}: unknown key '{key}'; allowed here: {unknown.known}."
    first = problems[0]
    key = ".".join(map(str, first["loc"]))
    if first["type"] == "missing":
        return f"{path}: key '{key}' is missing."
    reason = first["msg"].removeprefix("Value error, ")
    if isinstance(first["input"], dict):
        where = f"table '{key}': " if key else ""
        return f"{path}: {where}{reason}."
    return f"{path}: key '{key}' is {_shown(first['input'])}: {reason}."


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= _MOST_SHOWN else f"{text[:_MOST_SHOWN]}..."


Kind = TypeVar("Kind")


def _array(data: Any) -> Array:
    try:
        return np.array(data, dtype=float)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _with_gaps(values: Array) -> Any:
    gaps = values.astype(object)
    gaps[~np.isfinite(values)] = None
    return gaps.tolist()


Numbers = Annotated[Array, PlainValidator(_array), PlainSerializer(np.ndarray.tolist)]  # as lists
NumbersWithGaps = Annotated[Array, PlainValidator(_array), PlainSerializer(_with_gaps)]
"""As `Numbers`, with null for NaN and infinity, read as NaN."""


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Write JSON data whole or not at all."""
    text = json.dumps(data, indent=2, allow_nan=False)
    with written_whole(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: Path, expected_format: str | None = None) -> Any:
    """Read a JSON object of the expected format; raises ArtifactError."""
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
        raise ArtifactError(f"{path}: 'format' is {found!r}, expected '{expected_format}'.")
    return data


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def to_text(value: Any, *, sparse: bool = False) -> str:
    """Return a data class as JSON text; see `to_json`."""
    kind: Any = type(value)
    return json.dumps(_adapter(kind).dump_python(value, exclude_none=sparse), allow_nan=False)


def to_json(value: Any, *, sparse: bool = False) -> Any:
    """Return a data class as JSON data, if `sparse` without None; raises ValueError."""
    return json.loads(to_text(value, sparse=sparse))


def from_json(kind: type[Kind], data: Any, path: Path, what: str) -> Kind:
    """Return the data class `kind` of JSON data; raises ArtifactError."""
    schema: Any = kind
    try:
        valid: Kind = _adapter(schema).validate_python(data)
    except ValidationError as error:
        raise ArtifactError(f"{path}: {_sentence(error, what)}") from error
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error
    return valid


def _sentence(error: ValidationError, what: str) -> str:
    first = error.errors()[0]
    key = repr(".".join(map(str, first["loc"])))
    if first["type"] == "missing":
        return f"key {key} is missing."
    if first["type"] == "unexpected_keyword_argument":
        return f"not {what} (unknown key {key})."
    where = f"key {key}: " if first["loc"] else ""
    return f"not {what} ({where}{first['msg'].removeprefix('Value error, ')})."
