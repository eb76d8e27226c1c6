"""Names and messages that come from files of unknown origin, as they can be shown."""

from collections.abc import Iterable

_LONGEST = 160  # characters of one name or message: a hostile one has millions


def plain(text: str, longest: int = _LONGEST) -> str:
    """Return text on one line that is safe to print, since it comes from a file of unknown origin.

    Control characters and those that change the direction of text are written as escapes.
    """
    return escaped(text if len(text) <= longest else f"{text[:longest]}...")


def escaped(text: str) -> str:
    """Return text with escapes in place of what cannot be printed."""
    return "".join(
        c if c.isprintable() else c.encode("unicode_escape", "surrogatepass").decode() for c in text
    )


def quoted(name: str) -> str:
    """Return a name in quotes, safe to print."""
    return f"'{plain(name)}'"


def listed(names: Iterable[str], most: int = 5) -> str:
    """Return names in quotes with commas, the last of many as their number."""
    names = list(names)
    text = ", ".join(map(quoted, names[:most]))
    return f"{text} and {len(names) - most} more" if len(names) > most else text
