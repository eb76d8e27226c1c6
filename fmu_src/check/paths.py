"""Paths of the build machine in an FMU, left by a compiler or a tool."""

import re
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from itertools import islice
from pathlib import Path

from fmu_src.check.archive import Contents
from fmu_src.check.rules import Problem
from fmu_src.check.sources import SUFFIXES, without_comments
from hesr_model.support.text import plain, quoted

MOST_PATHS = 100  # per file; the first one and the number are reported
_NAME = rb"[A-Za-z0-9_.+@-]{1,100}"
_OF_USERS = re.compile(
    rb"/(?:home|Users|tmp|builds|var/tmp|var/folders)/%(n)s/%(n)s" % {b"n": _NAME}
)
# "root" is a common name of XML elements, so a dot is required in the rest.
_OF_ROOT = re.compile(rb"/root/[A-Za-z0-9_.+@/-]{0,100}\.[A-Za-z0-9_+-]{1,50}")
_PART = rb"[^\x00-\x1f\\/:*?\"<>|]{1,100}"
_OF_WINDOWS = re.compile(
    rb"[A-Za-z]:(\\{1,2}|/)(?:Users|Documents and Settings|a|Temp|builds)\1%(p)s\1%(p)s"
    # The full name of the file with debugging symbols.
    rb"|[A-Za-z]:(?:\\%(p)s){2,30}\.pdb" % {b"p": _PART}
)

# Pattern, its offset in the path [B], and pattern of the rest of the path.
_PLACES = (
    *((b"/%s/" % name, 0, _OF_USERS) for name in (b"home", b"Users", b"tmp", b"builds")),
    *((b"/var/%s/" % name, 0, _OF_USERS) for name in (b"tmp", b"folders")),
    (b"/root/", 0, _OF_ROOT),
    (b":\\", 1, _OF_WINDOWS),
    (b":/", 1, _OF_WINDOWS),
)

# A path does not follow a name or another path, except after a compiler option.
_ALONE = re.compile(rb"(?<![A-Za-z0-9_.~-])(?<!\b[A-Za-z]:)|(?<=-[IL])")


# Hosts never look for the FMU's own binary under a versioned name.
_CARRIED = re.compile(r"(.+/)?binaries/[^/]+/lib[^/]+\.so(\.[0-9]+)+")

_XML_COMMENT = re.compile(rb"<!--.*?(?:-->|\Z)", re.DOTALL)
_LIBRARIES = (".so", ".dll", ".dylib")


def skipped(contents: Contents) -> list[str]:
    """Return the third-party libraries in an FMU, with the reason."""
    return [
        f"paths in {plain(name)}: {reason}"
        for name, file in contents.files.items()
        if (reason := _built_elsewhere(name, file))
    ]


def problems(contents: Contents) -> Iterator[Problem]:
    """Yield the files that contain such a path."""
    for name, file in contents.files.items():
        if _built_elsewhere(name, file):
            continue
        if found := list(dict.fromkeys(islice(_paths(_code(name, file)), MOST_PATHS))):
            more = f" and {len(found) - 1} more of its kind" if len(found) > 1 else ""
            yield (
                "machine-path",
                f"{plain(name)}: it holds {quoted(found[0])}{more}, a path of the machine where "
                "the FMU was built.",
            )


def _built_elsewhere(name: str, file: Path) -> str | None:
    if _CARRIED.fullmatch(name):
        return "a library that the FMU carries, built elsewhere."
    if name.endswith(_LIBRARIES):
        for own in _of_fmpy().get(file.stat().st_size, ()):
            if file.read_bytes() == own.read_bytes():
                return f"{own.name} of FMPy as it is distributed, built elsewhere."
    return None


@cache
def _of_fmpy() -> dict[int, list[Path]]:
    """Return the libraries in FMPy, which containers use as their own, by size [B]."""
    found: dict[int, list[Path]] = {}
    spec = find_spec("fmpy")
    for folder in (spec.submodule_search_locations if spec else None) or ():
        for file in sorted(Path(folder).rglob("*")):
            if file.suffix in _LIBRARIES and file.is_file():
                found.setdefault(file.stat().st_size, []).append(file)
    return found


def _code(name: str, file: Path) -> bytes:
    """Return the content of a file without the comments of C and XML."""
    # Do not map the file: Python's search in a map reads one byte past the end.
    data = file.read_bytes()
    if name.lower().endswith(SUFFIXES):
        return without_comments(data)
    if name.lower().endswith((".xml", ".html", ".htm", ".svg")):
        return _XML_COMMENT.sub(b"", data)
    return data


def _paths(data: bytes) -> Iterator[str]:
    for literal, before, pattern in _PLACES:
        place = data.find(literal)
        while place >= 0:
            start = place - before
            match = pattern.match(data, start) if start >= 0 else None
            if match and _ALONE.match(data, start):
                yield match[0].decode("utf-8", "replace")
            place = data.find(literal, match.end() if match else place + 1)
