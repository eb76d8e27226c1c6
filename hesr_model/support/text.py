"""Text from files of unknown origin, made safe to show; values as TOML."""

import json
from collections.abc import Iterable
from typing import Any

_LONGEST = 160  # characters; hostile texts have millions


def plain(text: str, longest: int = _LONGEST) -> str:
    """Return text on one line, control characters escaped."""
    return escaped(text if len(text) <= longest else f"{text[:longest]}...")


def escaped(text: str) -> str:
    """Return text with unprintable characters escaped."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def quoted(name: str) -> str:
    """Return a name in quotes, safe to print."""
    return f"'{plain(name)}'"


def listed(names: Iterable[str], most: int = 5) -> str:
    """Return quoted names, and the number of further ones."""
    return few(map(quoted, names), most)


def few(words: Iterable[str], most: int = 5) -> str:
    """Return words, and the number of further ones."""
    words = list(words)
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return f"{', '.join(words[:most])}{more}"


def toml(value: Any) -> str:
    """Return a value in TOML, on one line."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(toml, value))}]"
    # TOML writes text, integers and booleans like JSON.
    return repr(float(value)) if isinstance(value, float) else json.dumps(value, ensure_ascii=False)
