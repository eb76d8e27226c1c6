"""Data classes as JSON: fields are the keys, annotations validate the values."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from hesr_model.errors import ArtifactError
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole
from hesr_model.support.untrusted_text import parse_json, read_text

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


def write_json(path: Path, data: Mapping[str, Any], *, indent: int | None = 2) -> None:
    """Write JSON data whole or not at all."""
    text = json.dumps(data, indent=indent, allow_nan=False)
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
