"""Checks of source code, whose files must exist, and of paths of the build machine."""

import posixpath
import re
from collections.abc import Iterator
from functools import cache
from itertools import islice
from pathlib import Path

from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription
from fmu_src.check.readers import find_package_folders
from fmu_src.check.rules import Problem
from hesr_model.support.text import count_noun, quote, quote_names, sanitise

MAX_PATHS = 100  # per file; the first one and the number are reported
_NAME = rb"[A-Za-z0-9_.+@-]{1,100}"
_USER_PATH = re.compile(
    rb"/(?:home|Users|tmp|builds|var/tmp|var/folders)/%(n)s/%(n)s" % {b"n": _NAME}
)
# "root" is a common name of XML elements, so a dot is required in the rest.
_ROOT_PATH = re.compile(rb"/root/[A-Za-z0-9_.+@/-]{0,100}\.[A-Za-z0-9_+-]{1,50}")
_PART = rb"[^\x00-\x1f\\/:*?\"<>|]{1,100}"
_WINDOWS_PATH = re.compile(
    rb"[A-Za-z]:(\\{1,2}|/)(?:Users|Documents and Settings|a|Temp|builds)\1%(p)s\1%(p)s"
    # The full name of the file with debugging symbols.
    rb"|[A-Za-z]:(?:\\%(p)s){2,30}\.pdb" % {b"p": _PART}
)

# Pattern, its offset in the path [B], and pattern of the rest of the path.
_PLACES = (
    *((b"/%s/" % name, 0, _USER_PATH) for name in (b"home", b"Users", b"tmp", b"builds")),
    *((b"/var/%s/" % name, 0, _USER_PATH) for name in (b"tmp", b"folders")),
    (b"/root/", 0, _ROOT_PATH),
    (b":\\", 1, _WINDOWS_PATH),
    (b":/", 1, _WINDOWS_PATH),
)

# A path does not follow a name or another path, except after a compiler option.
_PATH_START = re.compile(rb"(?<![A-Za-z0-9_.~-])(?<!\b[A-Za-z]:)|(?<=-[IL])")


# Hosts never look for the FMU's own binary under a versioned name.
_CARRIED_LIBRARY = re.compile(r"(.+/)?binaries/[^/]+/lib[^/]+\.so(\.[0-9]+)+")

_XML_COMMENT = re.compile(rb"<!--.*?(?:-->|\Z)", re.DOTALL)
_LIBRARIES = (".so", ".dll", ".dylib")


def find_skipped_libraries(contents: Contents) -> list[str]:
    """Return the third-party libraries in an FMU, with the reason."""
    return [
        f"paths in {sanitise(name)}: {reason}"
        for name, file in contents.files.items()
        if (reason := _find_skip_reason(name, file))
    ]


def machine_paths(contents: Contents) -> Iterator[Problem]:
    """Yield the files that contain such a path."""
    for name, file in contents.files.items():
        if _find_skip_reason(name, file):
            continue
        paths = list(dict.fromkeys(islice(_paths(_code(name, file)), MAX_PATHS)))
        if paths:
            path_text = quote(paths[0])
            if len(paths) > 1:
                path_text += f" and {len(paths) - 1} more of its kind"
            yield (
                "machine-path",
                f"{sanitise(name)}: it holds {path_text}, a path of the machine where the FMU was "
                "built.",
            )


def _find_skip_reason(name: str, file: Path) -> str | None:
    if _CARRIED_LIBRARY.fullmatch(name):
        return "a library that the FMU carries, built elsewhere."
    if name.endswith(_LIBRARIES):
        for library in _find_fmpy_libraries().get(file.stat().st_size, ()):
            if file.read_bytes() == library.read_bytes():
                return f"{library.name} of FMPy as it is distributed, built elsewhere."
    return None


@cache
def _find_fmpy_libraries() -> dict[int, list[Path]]:
    """Return the libraries in FMPy, which containers use as their own, by size [B]."""
    libraries: dict[int, list[Path]] = {}
    for folder in find_package_folders("fmpy"):
        for file in sorted(folder.rglob("*")):
            if file.suffix in _LIBRARIES and file.is_file():
                libraries.setdefault(file.stat().st_size, []).append(file)
    return libraries


def _code(name: str, file: Path) -> bytes:
    """Return the content of a file without the comments of C and XML."""
    # Do not map the file: Python's search in a map reads one byte past the end.
    data = file.read_bytes()
    if name.lower().endswith(SUFFIXES):
        return remove_comments(data)
    if name.lower().endswith((".xml", ".html", ".htm", ".svg")):
        return _XML_COMMENT.sub(b"", data)
    return data


def _paths(data: bytes) -> Iterator[str]:
    for literal, before, pattern in _PLACES:
        position = data.find(literal)
        while position >= 0:
            next_position = position + 1
            start = position - before
            if start >= 0 and (match := pattern.match(data, start)):
                next_position = match.end()
                if _PATH_START.match(data, start):
                    yield match[0].decode("utf-8", "replace")
            position = data.find(literal, next_position)


MAX_SOURCE_BYTES = 8 << 20  # of a source file; larger ones are data
_FMI_HEADERS = {
    *("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"),
    *("fmi3Functions.h", "fmi3FunctionTypes.h", "fmi3PlatformTypes.h"),
}
"""Headers that every importer that compiles sources supplies."""

_SYSTEM_NAMES = """
assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign
stdarg stdatomic stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar
wchar wctype direct dlfcn io malloc process pthread unistd windows
"""
_SYSTEM_HEADERS = frozenset(_SYSTEM_NAMES.split())  # system headers that may be included in quotes
SUFFIXES = (".c", ".cc", ".cpp", ".cxx", ".h", ".hh", ".hpp", ".hxx", ".inc")

# Strings may contain comment markers. Unclosed comments end with the file: a search for their end
# would be quadratic.
_COMMENT = re.compile(rb'/\*.*?(?:\*/|\Z)|//[^\n]*|"(?:\\.|[^"\\\n])*"?', re.DOTALL)
_DIRECTIVE = re.compile(
    rb'^[ \t]*#[ \t]*(?:include[ \t]*"([^"\n]{1,500})"|(if|ifdef|endif)\b|ifndef[ \t]+(\w+))',
    re.MULTILINE,
)
_FOLDER = "sources/"


def problems(model_description: ParsedDescription, contents: Contents) -> Iterator[Problem]:
    """Yield missing source files."""
    names = set(contents.names)
    has_binaries = any(name.startswith("binaries/") for name in names)
    sources = _list_sources(model_description)
    if not has_binaries and not sources:
        yield "binary-none", "binaries and a list of source files are both missing."
    missing = [source for source, path in sources.items() if path not in names]
    if missing:
        yield (
            "source-missing",
            f"the description lists {count_noun(len(missing), 'source file')} that sources/ lacks: "
            f"{quote_names(missing)}.",
        )
    yield from _includes(set(sources.values()), contents)


def _list_sources(model_description: ParsedDescription) -> dict[str, str]:
    """Return the listed source files with their names in the archive; some begin with "./"."""
    sources = {}
    for kind in model_description.kinds:
        for source in kind.sources:
            sources[source] = posixpath.normpath(_FOLDER + source)
    return sources


def _includes(sources: set[str], contents: Contents) -> Iterator[Problem]:
    """Yield unconditional includes that are missing, from listed sources or all code."""
    code = {
        name
        for name in contents.files
        if name.startswith(_FOLDER) and name.lower().endswith(SUFFIXES)
    }
    names = frozenset(contents.names)
    start = sources & code
    supplied_headers = set(_FMI_HEADERS)
    if not start:
        # Nothing states the folders of headers for sources that are not listed.
        supplied_headers.update(posixpath.basename(name) for name in names)
    waiting = sorted(start or code, reverse=True)
    visited = set(waiting)
    while waiting:
        name = waiting.pop()
        if contents.files[name].stat().st_size > MAX_SOURCE_BYTES:
            continue
        for included, always in _read_includes(contents.read(name)):
            included_file = _find_included(included, name, names)
            if included_file is None and always and not _is_supplied(included, supplied_headers):
                text = f"{sanitise(name)}: includes {quote(included)}, which is not in the archive."
                yield "source-include", text
            elif included_file in code and included_file not in visited:
                visited.add(included_file)
                waiting.append(included_file)


def _find_included(included: str, name: str, names: frozenset[str]) -> str | None:
    """Return the file that a source file `name` includes, None if it is not in the archive."""
    for folder in (posixpath.dirname(name), _FOLDER):
        path = posixpath.normpath(posixpath.join(folder, included))
        if path in names:
            return path
    return None


def _is_supplied(included: str, supplied_headers: set[str]) -> bool:
    base = posixpath.basename(included)
    return base in supplied_headers or base.lower().removesuffix(".h") in _SYSTEM_HEADERS


def _read_includes(text: bytes) -> Iterator[tuple[str, bool]]:
    """Yield the included names, and whether they are included on every platform."""
    code = remove_comments(text)
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
            is_guard = depth == 0 and guard and defined and defined[1] == guard
            if not is_guard:
                depth += 1


def remove_comments(text: bytes) -> bytes:
    """Return source code of C without its comments."""
    return _COMMENT.sub(lambda match: match[0] if match[0].startswith(b'"') else b" ", text)
