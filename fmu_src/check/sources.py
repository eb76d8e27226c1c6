"""Checks of source code: listed and included files exist."""

import posixpath
import re
from collections.abc import Iterator

from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription
from fmu_src.check.rules import Problem
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
SUFFIXES = (".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".inc")

# Strings may contain comment markers. Unclosed comments end with the file: a search for their end
# would be quadratic.
_COMMENT = re.compile(rb'/\*.*?(?:\*/|\Z)|//[^\n]*|"(?:\\.|[^"\\\n])*"?', re.DOTALL)
_DIRECTIVE = re.compile(
    rb'^[ \t]*#[ \t]*(?:include[ \t]*"([^"\n]{1,500})"|(if|ifdef|endif)\b|ifndef[ \t]+(\w+))',
    re.MULTILINE,
)
_FOLDER = "sources/"


def problems(about: ParsedDescription, contents: Contents) -> Iterator[Problem]:
    """Yield missing source files."""
    names = set(contents.names)
    binaries = any(name.startswith("binaries/") for name in names)
    if not binaries and not any(kind.sources for kind in about.kinds):
        yield "binary-none", "binaries and a list of source files are both missing."
    for kind in about.kinds:
        for source in kind.sources:
            if posixpath.normpath(_FOLDER + source) not in names:  # some begin with "./"
                yield (
                    "source-missing",
                    f"{kind.element} lists the source file {quoted(source)}, which is not in "
                    "sources/.",
                )
    yield from _includes(about, contents)


def _includes(about: ParsedDescription, contents: Contents) -> Iterator[Problem]:
    code = {
        name
        for name in contents.files
        if name.startswith(_FOLDER) and name.lower().endswith(SUFFIXES)
    }
    names = frozenset(contents.names)
    listed = (source for kind in about.kinds for source in kind.sources)
    start = {posixpath.normpath(_FOLDER + source) for source in listed} & code
    # Nothing states the folders of headers for sources that are not listed.
    others = set[str]() if start else {posixpath.basename(name) for name in names}
    waiting = sorted(start or code, reverse=True)
    seen = set(waiting)
    while waiting:
        name = waiting.pop()
        if contents.files[name].stat().st_size > MOST_BYTES:
            continue
        for included, always in _included(contents.read(name)):
            places = [
                posixpath.normpath(posixpath.join(folder, included))
                for folder in (posixpath.dirname(name), _FOLDER)
            ]
            found = next((p for p in places if p in names), None)
            base = posixpath.basename(included)
            supplied = base in _OFFICIAL | others or base.lower().removesuffix(".h") in _SYSTEM
            if found is None and always and not supplied:
                text = f"{plain(name)}: includes {quoted(included)}, which is not in the archive."
                yield "source-include", text
            elif found in code and found not in seen:
                seen.add(found)
                waiting.append(found)


def _included(text: bytes) -> Iterator[tuple[str, bool]]:
    """Yield the included names, and whether they are included on every platform."""
    code = without_comments(text)
    depth = 0
    for match in _DIRECTIVE.finditer(code):
        name, directive, guard = match.groups()
        if name is not None:
            yield name.decode("utf-8", "replace"), depth == 0
        elif directive == b"endif":
            depth = max(depth - 1, 0)
        else:
            # An include guard does not depend on the platform.
            defined = re.match(rb"[^\n]*\s*#[ \t]*define[ \t]+(\w+)", code[match.end() :])
            guards = depth == 0 and guard and defined and defined[1] == guard
            depth += 0 if guards else 1


def without_comments(text: bytes) -> bytes:
    """Return source code of C without its comments."""
    return _COMMENT.sub(lambda match: match[0] if match[0].startswith(b'"') else b" ", text)
