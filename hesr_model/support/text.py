"""Text and data of unknown origin: bounded reading, safe to show; values as TOML."""

import json
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

_MAX_LENGTH = 160  # characters; hostile texts have millions


def sanitise(text: str, max_length: int = _MAX_LENGTH) -> str:
    """Return text on one line, control characters escaped."""
    if len(text) > max_length:
        text = f"{text[:max_length]}..."
    return escape(text)


def escape(text: str) -> str:
    """Return text with unprintable characters escaped."""
    return "".join(map(_escape_character, text))


def _escape_character(character: str) -> str:
    if character.isprintable():
        return character
    return character.encode("unicode_escape", "surrogatepass").decode()


def on_one_line(error: Exception) -> str:
    """Return an error's text on one line, without full stop."""
    return " ".join(str(error).split()).rstrip(".")


def quote(name: str) -> str:
    """Return a name in quotes, safe to print."""
    return f"'{sanitise(name)}'"


def quote_names(names: Iterable[str], max_count: int = 5) -> str:
    """Return quoted names, and the number of further ones."""
    return join_few(map(quote, names), max_count)


def count_noun(count: int, noun: str) -> str:
    """Return a count with its noun: "1 gap", "2 gaps"."""
    return f"1 {noun}" if count == 1 else f"{count} {noun}s"


def join_with_and(words: Sequence[str]) -> str:
    """Return words as a list in a sentence: "a", "a and b", "a, b and c"."""
    return _join_words(words, "and")


def join_with_or(words: Sequence[str]) -> str:
    """Return words as alternatives in a sentence: "a", "a or b", "a, b or c"."""
    return _join_words(words, "or")


def _join_words(words: Sequence[str], conjunction: str) -> str:
    *first, last = words
    if not first:
        return last
    return f"{', '.join(first)} {conjunction} {last}"


def join_few(words: Iterable[str], max_count: int = 5) -> str:
    """Return words, and the number of further ones."""
    words = list(words)
    text = ", ".join(words[:max_count])
    if len(words) > max_count:
        text += f" and {len(words) - max_count} more"
    return text


def format_settings(changes: Mapping[str, Any]) -> str:
    """Return values by key of a TOML file as its lines: "[log.units] q = 'deg' and gravity = 1".

    None is left out: TOML has no word for it.
    """
    lines = []
    for key, value in changes.items():
        if value is None:
            continue
        table, _, name = key.rpartition(".")
        header = f"[{table}] " if table else ""
        # Literal strings of TOML read better within a sentence.
        text = re.sub(r'"([^"\\\']*)"', r"'\1'", to_toml(value))
        lines.append(f"{header}{name} = {text}")
    return join_with_and(lines)


def to_toml(value: Any) -> str:
    """Return a value in TOML, on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {to_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(to_toml, value))}]"
    if isinstance(value, float):
        return repr(float(value))
    # TOML writes text, integers and booleans like JSON.
    return json.dumps(value, ensure_ascii=False)


Data = TypeVar("Data")
MOST_BYTES = 256 * 2**20  # the largest results have a tenth of it
_MAX_DIGITS = 300  # floating-point numbers end at 1.8e308
_MAX_KEY_DOTS = 100  # dots
_MAX_NAME_LENGTH = 1000


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8; raises OSError or ValueError."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError("it is a pipe or a device")  # opening it may block, and it may have no end
    with path.open("rb") as file:
        too_long = os.fstat(file.fileno()).st_size > MOST_BYTES
        content = b"" if too_long else file.read(MOST_BYTES + 1)
    if too_long or len(content) > MOST_BYTES:  # files of the system do not have their length
        raise ValueError(f"it is longer than {MOST_BYTES // 2**20} MB")
    return content.decode("utf-8")


def parse_json(text: str | bytes) -> Any:
    """Return JSON data; raises ValueError, also for deep nesting."""
    return _refuse_deep_nesting(lambda: json.loads(text, parse_int=_parse_integer))


def parse_toml(text: str) -> dict[str, Any]:
    """Return TOML data; raises ValueError, also for deep nesting."""
    for line in text.splitlines():
        # Parsing nested tables takes quadratic time in their depth.
        if line.partition("=")[0].count(".") > _MAX_KEY_DOTS and not line.lstrip().startswith("#"):
            raise ValueError("it is nested too deeply")
    data = _refuse_deep_nesting(lambda: tomllib.loads(text))
    _refuse_deep_nesting(lambda: _require_numbers(data))
    return data


def _refuse_deep_nesting(read: Callable[[], Data]) -> Data:
    try:
        return read()
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def _parse_integer(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise ValueError(f"it holds an integer of {len(digits)} digits")
    return int(digits)


def _require_numbers(data: Any) -> None:
    if isinstance(data, dict):
        data = list(data.values())
    if isinstance(data, list):
        for value in data:
            _require_numbers(value)
    elif isinstance(data, int) and abs(data) > 10**_MAX_DIGITS:
        raise ValueError(f"it holds an integer of more than {_MAX_DIGITS} digits")


def require_printable(name: str) -> str:
    """Return a name that XML and C can contain, or raise ValueError."""
    if not name or len(name) > _MAX_NAME_LENGTH:
        raise ValueError(f"a name has {len(name)} characters; it can have 1 to {_MAX_NAME_LENGTH}")
    unprintable = next((c for c in name if not c.isprintable()), None)
    if unprintable:
        raise ValueError(f"the name {name!a} holds {unprintable!a}, which cannot be printed")
    return name
