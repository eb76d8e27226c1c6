"""Data classes as JSON and back: their fields are the keys, their annotations say what is valid.

What differs from that, as a table of names, a class says itself with pydantic's validators and
serialisers.
"""

import json
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from hesr_model.errors import ArtifactError
from hesr_model.support.arrays import Array

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


Numbers = Annotated[Array, PlainValidator(_array), PlainSerializer(np.ndarray.tolist)]
"""An array of any shape, as lists."""
NumbersWithGaps = Annotated[Array, PlainValidator(_array), PlainSerializer(_with_gaps)]
"""The same, null where a number is not finite; it comes back as NaN."""


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def to_text(value: Any, *, sparse: bool = False) -> str:
    """Return a data class as text of JSON; arguments and errors are those of `to_json`."""
    kind: Any = type(value)
    return json.dumps(_adapter(kind).dump_python(value, exclude_none=sparse), allow_nan=False)


def to_json(value: Any, *, sparse: bool = False) -> Any:
    """Return a data class as JSON data, numbers with every digit.

    Parameters
    ----------
    value : the data class.
    sparse : leave out fields that are None.

    Raises
    ------
    ValueError
        If a number is not finite, which JSON does not know.
    """
    return json.loads(to_text(value, sparse=sparse))


def from_json(kind: type[Kind], data: Any, path: Path, what: str) -> Kind:
    """Return the data class of JSON data that stood in a file.

    Parameters
    ----------
    kind : the data class.
    data : the JSON data.
    path : the file, for messages.
    what : what should stand in it, for messages.

    Raises
    ------
    ArtifactError
        Naming the file and the key, and what is wrong there.
    """
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
