"""Files as data classes: validated TOML, and JSON whose keys are the fields."""

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar, get_args

import numpy as np
import pydantic
from pydantic import BaseModel, PlainSerializer, PlainValidator, TypeAdapter, ValidationError

from hesr_model.errors import ArtifactError, ConfigError, RuleError
from hesr_model.support.arrays import Array
from hesr_model.support.files import written_whole
from hesr_model.support.ledger import (
    Ledger,
    find_close_names,
    format_suggestion,
    join_key,
    list_tables,
)
from hesr_model.support.text import (
    join_with_and,
    parse_json,
    parse_toml,
    quote_names,
    read_text,
    require_printable,
)

_MAX_SHOWN = 200  # characters
_MISSING_KEY = "key.missing"
_UNKNOWN_KEY = "key.unknown"
_SAME_KEY = 0.75  # similarity of a key to the missing one that it was meant to be
_MOST_HOMES = 3  # other places of a missing key that are named; a key of many is common
_CODES = {"missing": _MISSING_KEY, "unexpected_keyword_argument": _UNKNOWN_KEY}
"""Codes of pydantic's errors; the others are called ``value.`` and pydantic's own name."""


class _UnknownKeyError(RuleError):
    """A key is unknown; `close_keys` are allowed and resemble it."""

    def __init__(self, key: str, allowed: Iterable[str]) -> None:
        allowed_keys = ", ".join(sorted(allowed))
        super().__init__(f"allowed here: {allowed_keys}.", code=_UNKNOWN_KEY, key=key)
        self.close_keys = find_close_names(key, allowed)


class Config(BaseModel):
    """Base of every schema: immutable, without unknown keys, infinities and NaN."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _require_known_keys(cls, data: Any) -> Any:
        """Refuse an unknown key before pydantic does, which does not name the known ones."""
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                raise _UnknownKeyError(str(key), cls.model_fields)
        return data

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and validate a TOML file; raises ConfigError."""
        try:
            text = read_text(path)
        except FileNotFoundError as error:
            raise ConfigError(f"{path}: no such file.", code="file.missing", where=path) from error
        except (OSError, ValueError) as error:
            sentence = f"{path}: cannot be read ({error})."
            raise ConfigError(sentence, code="file.unreadable", where=path) from error
        try:
            data = parse_toml(text)
        except ValueError as error:
            sentence = f"{path}: not valid TOML ({error})."
            raise ConfigError(sentence, code="file.toml", where=path) from error
        return cls.from_data(path, data)

    def expand_per_joint(self, key: str, joints: int) -> tuple[Any, ...]:
        """Return the value of each joint, where a file gives one for all or one per joint."""
        value = getattr(self, key)
        if isinstance(value, tuple):
            return value
        return (value,) * joints

    @classmethod
    def from_data(cls, path: Path, data: Any) -> Self:
        """Validate data read from a file; errors as `read`."""
        try:
            return cls.model_validate(data, context={"folder": path.parent})
        except ValidationError as error:
            raise _build_refusal(path, error, cls) from error
        except RecursionError as error:
            sentence = f"{path}: it is nested too deeply."
            raise ConfigError(sentence, code="file.nesting", where=path) from error


def _resolve_beside_toml(path: Path, info: pydantic.ValidationInfo) -> Path:
    folder: Path = (info.context or {}).get("folder", Path())
    # Not `Path.resolve`, which fails on circular links before Python 3.13.
    return Path(os.path.realpath(folder / path))


RelativePath = Annotated[Path, pydantic.AfterValidator(_resolve_beside_toml)]  # to its TOML file
PrintableName = Annotated[str, pydantic.AfterValidator(require_printable)]  # as FMUs need


@dataclass(frozen=True)
class _BrokenRule:
    """One broken rule: `place` is the key that was validated, `key` the offending one."""

    code: str
    place: str
    key: str
    reason: str
    close_keys: tuple[str, ...] = ()


def _describe_problem(details: Any) -> _BrokenRule:
    """Return a problem that pydantic found in terms of HESR."""
    reason = details["msg"].removeprefix("Value error, ")
    place = ".".join(map(str, details["loc"]))
    rule = details.get("ctx", {}).get("error")
    if isinstance(rule, RuleError):
        close_keys = [join_key(place, key) for key in getattr(rule, "close_keys", ())]
        return _BrokenRule(rule.code, place, join_key(place, rule.key), reason, tuple(close_keys))
    code = _CODES.get(details["type"], f"value.{details['type']}")
    return _BrokenRule(code, place, place, reason)


def _build_refusal(path: Path, error: ValidationError, schema: type[Config]) -> ConfigError:
    problems = error.errors()
    # An unknown key is often the misspelt name of one that is missing.
    unknown = [details for details in problems if _describe_problem(details).code == _UNKNOWN_KEY]
    details = unknown[0] if unknown else problems[0]
    problem = _describe_problem(details)
    if unknown:
        name = problem.key.rpartition(".")[2]
        meant = dict.fromkeys([*problem.close_keys, *_find_homes(schema, name)])
        sentence = f"unknown key '{problem.key}'; {format_suggestion([*meant]) or problem.reason}"
    elif problem.code == _MISSING_KEY:
        sentence = _report_missing_keys(problems)
    elif isinstance(details["input"], dict):
        sentence = f"{problem.reason}."
        if problem.place:
            sentence = f"table '{problem.place}': {sentence}"
    else:
        sentence = f"key '{problem.place}' is {_shorten(details['input'])}: {problem.reason}."
    return ConfigError(f"{path}: {sentence}", code=problem.code, where=path, key=problem.key)


def _find_homes(schema: type[Config], name: str, place: str = "") -> Iterator[str]:
    """Yield the places of a key in a schema and its tables."""
    if name in schema.model_fields:
        yield join_key(place, name)
    for key, field in schema.model_fields.items():
        tables = list(_find_schemas(field.annotation))
        # Which of several kinds of tables is meant is not known.
        if len(tables) == 1:
            yield from _find_homes(tables[0], name, join_key(place, key))


def _find_schemas(annotation: Any) -> Iterator[type[Config]]:
    if isinstance(annotation, type) and issubclass(annotation, Config):
        yield annotation
    for inner in get_args(annotation):
        yield from _find_schemas(inner)


def _report_missing_keys(problems: Sequence[Any]) -> str:
    """Name all missing keys, so that one edit adds them."""
    keys = [
        f"'{problem.key}'"
        for problem in map(_describe_problem, problems)
        if problem.code == _MISSING_KEY
    ]
    if len(keys) == 1:
        return f"key {keys[0]} is missing."
    return f"keys {join_with_and(keys)} are missing."


def _shorten(value: object) -> str:
    text = repr(value)
    if len(text) > _MAX_SHOWN:
        text = f"{text[:_MAX_SHOWN]}..."
    return text


Kind = TypeVar("Kind")


def _parse_array(data: Any) -> Array:
    try:
        return np.array(data, dtype=float)
    except TypeError as error:
        raise ValueError(str(error)) from error


def _serialise_gaps(values: Array) -> Any:
    gaps = values.astype(object)
    gaps[~np.isfinite(values)] = None
    return gaps.tolist()


# Written as lists.
Numbers = Annotated[Array, PlainValidator(_parse_array), PlainSerializer(np.ndarray.tolist)]
NumbersWithGaps = Annotated[Array, PlainValidator(_parse_array), PlainSerializer(_serialise_gaps)]
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
        raise ArtifactError(f"{path}: no such file.", code="file.missing", where=path) from error
    except (OSError, ValueError) as error:
        sentence = f"{path}: not a readable JSON file ({error})."
        raise ArtifactError(sentence, code="file.json", where=path) from error
    if expected_format is None:
        if not isinstance(data, dict):
            sentence = f"{path}: not a readable JSON file (it holds no keys)."
            raise ArtifactError(sentence, code="file.no_keys", where=path)
        return data
    found_format = data.pop("format", None) if isinstance(data, dict) else None
    if found_format != expected_format:
        sentence = f"{path}: 'format' is {found_format!r}, expected '{expected_format}'."
        raise ArtifactError(sentence, code="file.format", where=path, key="format")
    return data


@cache
def _get_adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def to_text(value: Any, *, sparse: bool = False) -> str:
    """Return a data class as JSON text; see `to_json`."""
    kind: Any = type(value)
    return json.dumps(_get_adapter(kind).dump_python(value, exclude_none=sparse), allow_nan=False)


def to_json(value: Any, *, sparse: bool = False) -> Any:
    """Return a data class as JSON data, if `sparse` without None; raises ValueError."""
    return json.loads(to_text(value, sparse=sparse))


def from_json(kind: type[Kind], data: Any, path: Path, subject: str) -> Kind:
    """Return the data class `kind` of JSON data; raises ArtifactError.

    `IRRELEVANT_KEYS` of the class are reasons by place, without the numbers of entries in lists.
    """
    schema: Any = kind
    try:
        valid: Kind = _get_adapter(schema).validate_python(data)
    except ValidationError as error:
        raise _build_json_refusal(error, data, path, subject) from error
    except ArtifactError as error:
        raise error.add_place(path) from error
    ledger = Ledger(str(path), "key")
    ledger.compare_data(
        data, _get_adapter(schema).dump_python(valid), getattr(kind, "IRRELEVANT_KEYS", {})
    )
    ledger.require_nothing_meant(ArtifactError)
    return valid


def _find_similar(data: Any, key: str) -> list[str]:
    """Return the keys of a table that resemble a missing one, and its places in other tables."""
    place, _, name = key.rpartition(".")
    tables = list_tables(data)
    siblings = find_close_names(name, tables.get(place, ()), cutoff=_SAME_KEY)
    if siblings:
        return [join_key(place, sibling) for sibling in siblings]
    homes = [join_key(home, name) for home, keys in tables.items() if name in keys]
    return homes if len(homes) <= _MOST_HOMES else []


def _build_json_refusal(
    error: ValidationError, data: Any, path: Path, subject: str
) -> ArtifactError:
    problem = _describe_problem(error.errors()[0])
    if problem.code == _MISSING_KEY:
        similar = _find_similar(data, problem.key)
        sentence = f"key '{problem.key}' is missing."
        if similar:
            sentence = f"key '{problem.key}' is missing; there is {quote_names(similar)}."
    elif problem.code == _UNKNOWN_KEY:
        sentence = f"not {subject} (unknown key '{problem.key}')."
    elif problem.place:
        sentence = f"not {subject} (key '{problem.place}': {problem.reason})."
    else:
        sentence = f"not {subject} ({problem.reason})."
    return ArtifactError(f"{path}: {sentence}", code=problem.code, where=path, key=problem.key)
