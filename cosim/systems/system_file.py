"""A system of FMUs written as the TOML file from which it can be read again."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosim.systems.system import SystemSpec
from hesr_model.support.files import written_whole


def write_system(spec: SystemSpec, path: Path) -> Path:
    """Write a system as TOML; its FMUs are named relative to the file.

    Parameters
    ----------
    spec : the system.
    path : the file to write, in TOML.

    Returns
    -------
    `path`.

    Raises
    ------
    ArtifactError
        If it cannot be written.
    """
    with written_whole(path) as temporary:
        text = "\n".join(_lines(spec, path.parent.resolve()))
        temporary.write_text(f"{text}\n", encoding="utf-8")
    return path


def _lines(spec: SystemSpec, folder: Path) -> Iterator[str]:
    for key in ("name", "step", "stop", "order", "observe"):
        yield f"{key} = {_value(getattr(spec, key))}"
    for component in spec.components:
        yield from ("", "[[components]]", f"name = {_value(component.name)}")
        fmu = Path(os.path.relpath(component.fmu.resolve(), folder)).as_posix()
        yield f"fmu = {_value(fmu)}"
        if component.step is not None:
            yield f"step = {_value(component.step)}"
        if component.start:
            yield from ("", "[components.start]", *_pairs(component.start))
    for table in ("connections", "limits"):
        if pairs := getattr(spec, table):
            yield from ("", f"[{table}]", *_pairs(pairs))


def _pairs(table: Any) -> Iterator[str]:
    for key, value in table.items():
        yield f"{_value(key)} = {_value(value)}"


def _value(value: Any) -> str:
    """Return a value as TOML, every digit of a number kept."""
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, float):
        return repr(float(value))
    # Text, integers and truth values are written in TOML as in JSON.
    return json.dumps(value, ensure_ascii=False)
