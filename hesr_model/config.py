"""Configuration from TOML, validated, with unknown keys refused."""

import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError, ValidationInfo

from hesr_model.errors import ConfigError


class Config(BaseModel):
    """Base of every schema: immutable, unknown keys refused, infinities and NaN refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _beside_the_toml(path: Path, info: ValidationInfo) -> Path:
    folder: Path = (info.context or {}).get("folder", Path())
    return (folder / path).resolve()


RelativePath = Annotated[Path, AfterValidator(_beside_the_toml)]
"""A path that is relative to the TOML file in which it stands."""

Schema = TypeVar("Schema", bound=Config)


def read_toml(path: Path, schema: type[Schema]) -> Schema:
    """Read and validate a TOML file.

    Raises
    ------
    ConfigError
        Naming the file, the key, what was found and what is allowed there.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"{path}: no such file.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}).") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML ({error}).") from error
    try:
        return schema.model_validate(data, context={"folder": path.parent})
    except ValidationError as error:
        raise ConfigError(_sentence(path, schema, error)) from error


def _sentence(path: Path, schema: type[BaseModel], error: ValidationError) -> str:
    """Say the first problem in one sentence; the others usually follow from it."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        holder = _holder(schema, first["loc"])
        known = ", ".join(sorted(holder.model_fields)) if holder else "none"
        return f"{path}: unknown key '{key}'; allowed here: {known}."
    if first["type"] == "missing":
        return f"{path}: key '{key}' is missing."
    reason = first["msg"].removeprefix("Value error, ")
    return f"{path}: key '{key}' is {first['input']!r}: {reason}."


def _holder(schema: type[BaseModel], location: tuple[Any, ...]) -> type[BaseModel] | None:
    """Return the schema of the table in which the last part of `location` stands."""
    holder: type[BaseModel] | None = schema
    for part in location[:-1]:
        field = holder.model_fields.get(str(part)) if holder else None
        kinds = [field.annotation, *getattr(field.annotation, "__args__", ())] if field else []
        inner = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
        holder = inner[0] if inner else holder if isinstance(part, int) else None
    return holder
