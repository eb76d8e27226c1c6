"""Checks of source code: listed and included files exist."""

import posixpath
import re
from collections.abc import Iterator

from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription
from hesr_model.support.text import plain, quoted

MOST_BYTES = 8 << 20  # of a source file; larger ones are data
_OFFICIAL = {
    *("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    *("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
"""Headers that every importer that compiles sources supplies."""

_SYSTEM_NAMES = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign
stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
wchar wctype direct dlfcn io malloc process pthread unistd windows
"""
_SYSTEM = frozenset(_SYSTEM_NAMES.split())  # system headers that may be included in quotes
_SUFFIXES = (".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".inc")

# Strings may contain comment markers. Unclosed comments end with the file: a search for their end
# would be quadratic.
_COMMENT = re.compile(rb'/\*.*?(?:\*/|\Z)|//[^\n]*|"(?:\\.|[^"\\\n])*"?', re.DOTALL)
_INCLUDE = re.compile(rb'^[ \t]*#[ \t]*include[ \t]*"([^"\n]{1,500})"', re.MULTILINE)
_FOLDER = "sources/"


def problems(about: ParsedDescription, contents: Contents) -> Iterator[str]:
    """Yield missing source files."""
    names = set(contents.names)
    binaries = any(name.startswith("binaries/") for name in names)
    if not binaries and not any(kind.sources for kind in about.kinds):
        yield "binaries and a list of source files are both missing."
    for kind in about.kinds:
        for source in kind.sources:
            if _FOLDER + source not in names:
                yield (
                    f"{kind.element} lists the source file {quoted(source)}, which is not in "
                    "sources/."
                )
    yield from _includes(about, contents)


def _includes(about: ParsedDescription, contents: Contents) -> Iterator[str]:
    code = {
        name
        for name in contents.files
        if name.startswith(_FOLDER) and name.lower().endswith(_SUFFIXES)
    }
    names = frozenset(contents.names)
    start = {_FOLDER + source for kind in about.kinds for source in kind.sources} & code
    waiting = sorted(start or code, reverse=True)
    seen = set(waiting)
    while waiting:
        name = waiting.pop()
        if contents.files[name].stat().st_size > MOST_BYTES:
            continue
        for included in _included(contents.read(name)):
            places = [
                posixpath.normpath(posixpath.join(folder, included))
                for folder in (posixpath.dirname(name), _FOLDER)
            ]
            found = next((p for p in places if p in names), None)
            supplied = included in _OFFICIAL or included.lower().removesuffix(".h") in _SYSTEM
            if found is None and not supplied:
                yield (f"{plain(name)}: includes {quoted(included)}, which is not in the archive.")
            elif found in code and found not in seen:
                seen.add(found)
                waiting.append(found)


def _included(text: bytes) -> list[str]:
    code = _COMMENT.sub(lambda match: match[0] if match[0].startswith(b'"') else b" ", text)
    return [name.decode("utf-8", "replace") for name in _INCLUDE.findall(code)]
