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


def convert_records(path: Path, text: str) -> tuple[tuple[str, ...], bytes]:
    """Return names, and rows as CSV without a header, of JSON text; raises LogError.

    Names of inner objects are joined by dots, numbers of entries of lists by underscores.
    """
    rows: list[Row] = []
    names: dict[str, None] = {}
    for record in _read_records(path, text):
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
    return tuple(names), file.getvalue().encode()


def _read_records(path: Path, text: str) -> Sequence[Mapping[str, Any]]:
    lines = text.rstrip("\0 \t\r\n").split("\n")
    with suppress(ValueError, RecursionError):
        first_record = _parse(lines[0])
        if isinstance(first_record, dict) and len(lines) > 1:
            return list(_read_lines(path, lines, is_complete=text.endswith("\n")))
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
        try:
            record = _parse(line.strip() or "{}")
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


def _find_records(data: Any) -> Sequence[Mapping[str, Any]]:
    """Return the longest list of objects in data, or lists by name as objects; else ValueError."""
    columns = dict(_find_lists("", data))
    row_count = max(map(len, columns.values()), default=0)
    longest = {name: values for name, values in columns.items() if len(values) == row_count > 0}
    for values in longest.values():
        if all(isinstance(value, dict) for value in values):
            return values
    if not longest:
        raise ValueError("no lists")
    rows = zip(*longest.values(), strict=True)
    return [dict(zip(longest, row, strict=True)) for row in rows]


def _find_lists(name: str, data: Any) -> Iterator[tuple[str, list[Any]]]:
    if isinstance(data, list):
        yield name, data
    elif isinstance(data, dict):
        for key, value in data.items():
            yield from _find_lists(join_key(name, key), value)


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
