"""Configuration from validated TOML."""

import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, ValidationInfo

from hesr_model.errors import ConfigError
from hesr_model.support.untrusted_text import parse_toml, read_text, require_printable

_MOST_SHOWN = 200  # characters


class Config(BaseModel):
    """Base of every schema: immutable, without unknown keys, infinities and NaN."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

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

    @classmethod
    def validated(cls, path: Path, data: Any) -> Self:
        """Validate data read from a file; errors as `read`."""
        try:
            return cls.model_validate(data, context={"folder": path.parent})
        except ValidationError as error:
            raise ConfigError(_sentence(path, cls, error)) from error
        except RecursionError as error:
            raise ConfigError(f"{path}: it is nested too deeply.") from error


def _beside_the_toml(path: Path, info: ValidationInfo) -> Path:
    folder: Path = (info.context or {}).get("folder", Path())
    # Not `Path.resolve`, which fails on circular links before Python 3.13.
    return Path(os.path.realpath(folder / path))


RelativePath = Annotated[Path, AfterValidator(_beside_the_toml)]  # to its TOML file

PrintableName = Annotated[str, AfterValidator(require_printable)]
"""A name without control characters, which an FMU's description cannot contain."""


def _sentence(path: Path, schema: type[BaseModel], error: ValidationError) -> str:
    problems = error.errors()
    first = next((p for p in problems if p["type"] == "extra_forbidden"), problems[0])
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        holder = _holder(schema, first["loc"])
        known = ", ".join(sorted(holder.model_fields)) if holder else "none"
        return f"{path}: unknown key '{key}'; allowed here: {known}."
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


def _holder(schema: type[BaseModel], location: tuple[Any, ...]) -> type[BaseModel] | None:
    holders = [schema]
    for part in location[:-1]:
        if fields := [h.model_fields[part] for h in holders if part in h.model_fields]:
            holders = [inner for field in fields for inner in _schemas_in(field.annotation)]
        else:  # an index, a user's name, or a kind of schema
            holders = [h for h in holders if _is_of_kind(h, part)] or holders
    return holders[0] if holders else None


def _schemas_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [schema for inner in get_args(annotation) for schema in _schemas_in(inner)]


def _is_of_kind(schema: type[BaseModel], kind: Any) -> bool:
    annotations = [field.annotation for field in schema.model_fields.values()]
    return any(get_origin(a) is Literal and kind in get_args(a) for a in annotations)
