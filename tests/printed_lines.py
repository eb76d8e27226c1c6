"""Lines of robot files as messages print them, executed on a copy of the file."""

import ast
import re
import tomllib
from collections.abc import Iterator
from typing import Any

_SETTING = re.compile(
    r"(?:\[([\w.]+)\] )?\b([a-z_]\w*) = "
    r"(\[[^\]]*\]|'[^']*'|\"[^\"]*\"|-?[\d.]*\d(?:e[-+]?\d+)?|true|false)"
)


def read_settings(sentence: str) -> Iterator[tuple[str, str, Any]]:
    """Yield table, key and value of each line after the word 'set'."""
    _, _, lines = sentence.rpartition("; set ")
    for table, key, value in _SETTING.findall(lines):
        yield table, key, tomllib.loads(f"value = {value}")["value"]


def execute(robot_text: str, sentence: str) -> str:
    """Return the text of a robot file with the lines that a sentence says to set."""
    for table, key, value in read_settings(sentence):
        robot_text = write_line(robot_text, table, key, repr(value))
    return robot_text


def write_line(robot_text: str, table: str, key: str, value: str) -> str:
    """Write a line as a user does: in its table, instead of a line with its key."""
    assert value in ("true", "false") or ast.literal_eval(value) is not None
    lines = robot_text.splitlines()
    header = f"[{table}]"
    first = lines.index(header) + 1 if table and header in lines else 0
    if table and not first:
        return "\n".join([*lines, "", header, f"{key} = {value}"]) + "\n"
    ends = [k for k in range(first, len(lines)) if lines[k].startswith("[")]
    last = ends[0] if ends else len(lines)
    kept = [line for line in lines[first:last] if not line.startswith(f"{key} =")]
    return "\n".join([*lines[:first], f"{key} = {value}", *kept, *lines[last:]]) + "\n"


def remove_marks(robot_text: str) -> str:
    """Return the text of a robot file whose commented lines are its own."""
    return re.sub(r"(?m)^# (\w+ = )", r"\1", robot_text)
