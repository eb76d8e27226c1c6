"""JSON records as the rows of a table: an object a line, a list of objects, or lists by name."""

import csv
import io
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from hesr_model.errors import LogError
from hesr_model.logs.log_table import compute_max_bytes, require_columns
from hesr_model.support.ledger import join_key

_log = logging.getLogger(__name__)
_CONSTANTS = {None: "", True: "true", False: "false"}
Row = dict[str, str]


def is_json(start: bytes) -> bool:
    """Return whether a file that begins with `start` holds JSON objects."""
    beginning = start.removeprefix(b"\xef\xbb\xbf").split(b"{")[0]
    return b"{" in start and not beginning.strip(b" \t\r\n[")


def convert_records(path: Path, text: str) -> tuple[tuple[str, ...], bytes, tuple[str, ...]]:
    """Return names, rows as CSV without a header, and other names in JSON text; raises LogError.

    Names of inner objects are joined by dots, numbers of entries of lists by underscores.
    """
    rows: list[Row] = []
    names: dict[str, None] = {}
    records, other_names = _read_records(path, text)
    for record in records:
        row = dict(_flatten("", record))
        names |= dict.fromkeys(row)
        require_columns(path, len(names))
        rows.append(row)
    if len(names) * len(rows) > compute_max_bytes(path):
        raise LogError(
            f"{path}: its {len(rows)} records have {len(names)} names, more than fits into "
            "memory; write a table.",
            code="log.too_large",
            where=path,
        )
    file = io.StringIO()
    csv.DictWriter(file, list(names), restval="").writerows(rows)
    return tuple(names), file.getvalue().encode(), tuple(other_names)


Records = tuple[Sequence[Mapping[str, Any]], list[str]]  # records, and other names in the file


def _read_records(path: Path, text: str) -> Records:
    lines = text.rstrip("\0 \t\r\n").split("\n")
    with suppress(ValueError, RecursionError):
        first_record = _parse(lines[0])
        if isinstance(first_record, dict) and len(lines) > 1:
            return list(_read_lines(path, lines, is_complete=text.endswith("\n"))), []
    try:
        return _find_records(_parse("\n".join(lines)))
    except (ValueError, RecursionError) as error:
        raise LogError(
            f"{path}: holds JSON that is no list of records, and no record a line; write one "
            "object of numbers a line.",
            code="log.json",
            where=path,
        ) from error


def _read_lines(
    path: Path, lines: Sequence[str], *, is_complete: bool
) -> Iterator[Mapping[str, Any]]:
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            record = _parse(line)
        except (ValueError, RecursionError):
            record = None
        if isinstance(record, dict):
            yield record
        elif number == len(lines) and not is_complete:
            _log.warning("%s: its last row, %d, is cut off and was left out.", path.name, number)
        else:
            raise LogError(
                f"{path}: row {number} is no JSON object: {line[:40]!r}.",
                code="log.json",
                where=path,
                key=f"row {number}",
            )


def _parse(text: str) -> Any:
    """Return JSON data with numbers as they are written; raises ValueError or RecursionError."""
    return json.loads(text, parse_float=str, parse_int=str, parse_constant=str)


def _find_records(data: Any) -> Records:
    """Return the longest list of objects in data, or lists by name as objects; else ValueError."""
    values_by_name = dict(_find_values("", data))
    columns = {name: values for name, values in values_by_name.items() if isinstance(values, list)}
    row_count = max(map(len, columns.values()), default=0)
    longest = {name: values for name, values in columns.items() if len(values) == row_count > 0}
    if not longest:
        raise ValueError("no lists")
    records, used_names = _choose_records(longest)
    other_names = []
    for name in values_by_name:
        if name in used_names:
            continue
        size = f" ({len(columns[name])} entries)" if name in columns else ""
        other_names.append(f"{name}{size}")
    return records, other_names


def _choose_records(
    lists: Mapping[str, list[Any]],
) -> tuple[Sequence[Mapping[str, Any]], set[str]]:
    """Return the first list of objects, else the lists as columns, and the names of what is used.

    All lists are equally long.
    """
    for name, values in lists.items():
        if all(isinstance(value, dict) for value in values):
            return values, {name}
    rows = zip(*lists.values(), strict=True)
    return [dict(zip(lists, row, strict=True)) for row in rows], set(lists)


def _find_values(name: str, data: Any) -> Iterator[tuple[str, Any]]:
    """Yield lists and single values by their dotted names."""
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _find_values(join_key(name, key), value)
    else:
        yield name, data


def _flatten(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Yield the names and texts of the values in a record."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flatten(join_key(name, key), inner)
    elif isinstance(value, list):
        for number, inner in enumerate(value, start=1):
            yield from _flatten(f"{name}_{number}", inner)
    elif isinstance(value, str):
        yield name, " ".join(value.split())  # a row is a line
    else:
        yield name, _CONSTANTS[value]
