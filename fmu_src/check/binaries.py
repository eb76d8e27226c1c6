"""Checks of shared libraries: format, functions (by the headers of FMI) and dependencies."""

import posixpath
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from fmu_src.check.archive import Contents
from fmu_src.check.description import KINDS, InterfaceKind, ParsedDescription
from fmu_src.check.reader_process import ReaderProcess
from fmu_src.check.readers import find_package_folders
from fmu_src.check.rules import Problem
from hesr_model.support.process import DiedError
from hesr_model.support.text import quote, quote_names, sanitise


def _read_functions(version: int) -> list[list[str]]:
    folder = find_package_folders("fmpy")[0]
    header = folder / "c-code" / f"fmi{version}Functions.h"
    sections = re.split(r"^(?:Common )?Functions", header.read_text("utf-8"), flags=re.MULTILINE)
    function_lists = [
        re.findall(rf"FMI{version}_Export\s+\w+\s+(\w+);", section) for section in sections
    ]
    return [names for names in function_lists if names]


_COMMON, _EXCHANGE, _SIMULATION = _read_functions(2)

REQUIRED = {"ModelExchange": _COMMON + _EXCHANGE, "CoSimulation": _COMMON + _SIMULATION}
REQUIRED_3 = list(chain(*_read_functions(3)))
"""The standard requires all of them, even for unsupported features."""

KNOWN_FUNCTIONS = frozenset((*_COMMON, *_EXCHANGE, *_SIMULATION, *REQUIRED_3))

FUNCTIONS_BY_FLAG = {
    "canGetAndSetFMUstate": ("fmi2GetFMUstate", "fmi2SetFMUstate", "fmi2FreeFMUstate"),
    "canSerializeFMUstate": (
        "fmi2SerializedFMUstateSize",
        "fmi2SerializeFMUstate",
        "fmi2DeSerializeFMUstate",
    ),
    "providesDirectionalDerivative": ("fmi2GetDirectionalDerivative",),
    "canInterpolateInputs": ("fmi2SetRealInputDerivatives",),
    "canRunAsynchronuously": ("fmi2CancelStep", "fmi2GetStatus"),
}
"""Functions that hosts call because of a flag."""


READER_TIMEOUT = 30.0
_READER = "fmu_src.check.readers:inspect"


@dataclass(frozen=True)
class Platform:
    """Format, suffix and machines of the libraries in a folder under binaries/."""

    format: str
    suffix: str
    machines: tuple[str, ...]


_TUPLES = {
    "aarch64-linux": Platform("ELF", ".so", ("AARCH64",)),
    "x86_64-linux": Platform("ELF", ".so", ("X86_64",)),
    "aarch64-windows": Platform("PE", ".dll", ("ARM64",)),
    "x86_64-windows": Platform("PE", ".dll", ("AMD64",)),
    "aarch64-darwin": Platform("Mach-O", ".dylib", ("ARM64",)),
    "x86_64-darwin": Platform("Mach-O", ".dylib", ("X86_64",)),
}
PLATFORMS: Mapping[int, Mapping[str, Platform]] = {
    2: {
        "linux32": Platform("ELF", ".so", ("I386",)),
        "linux64": _TUPLES["x86_64-linux"],
        "win32": Platform("PE", ".dll", ("I386",)),
        "win64": _TUPLES["x86_64-windows"],
        "darwin32": Platform("Mach-O", ".dylib", ("X86",)),
        "darwin64": Platform("Mach-O", ".dylib", ("X86_64", "ARM64")),
        **_TUPLES,  # used by importers
    },
    3: {
        "x86-linux": Platform("ELF", ".so", ("I386",)),
        "x86-windows": Platform("PE", ".dll", ("I386",)),
        **_TUPLES,
    },
}
"""Platforms by version of FMI."""

_SYSTEMS = {"ELF": "Linux", "PE": "Windows", "Mach-O": "macOS"}
"""Operating system by format of libraries."""

# Libraries that every installation of an operating system has.
_ELF = re.compile(
    r"(libc|libm|libdl|libpthread|librt|libutil|libresolv|libgcc_s|libstdc\+\+|libc\+\+|"
    r"linux-vdso|ld-linux[a-z0-9_-]*|ld-musl[a-z0-9_-]*)\.so(\.[0-9]+)*"
)
_PE = re.compile(
    r"(kernel32|kernelbase|ntdll|user32|gdi32|advapi32|shell32|shlwapi|ole32|oleaut32|ws2_32|"
    r"msvcrt|ucrtbase|bcrypt|crypt32|rpcrt4|winmm|version|psapi|dbghelp|iphlpapi|comdlg32|"
    r"comctl32|setupapi|secur32|userenv|wsock32|mswsock|powrprof|api-ms-win-[a-z0-9-]+|"
    r"ext-ms-win-[a-z0-9-]+|bcryptprimitives|cfgmgr32|imm32|netapi32|opengl32|pdh|uxtheme|wininet|"
    r"winhttp|normaliz|propsys|sechost|wldap32|activeds|adsldpapi|authz|avicap32|avifil32|avrt|"
    r"cabinet|clusapi|credui|cryptbase|cryptnet|cryptsp|cryptui|d2d1|d3d\d+|dciman32|ddraw|dhcpcsvc|"
    r"dinput8?|dnsapi|dsound|dwmapi|dwrite|dxgi|dxva2|fltlib|gdiplus|glu32|hid|httpapi|icmp|imagehlp|"
    r"loadperf|lz32|mpr|msacm32|mscoree|msi|msimg32|msvfw32|ncrypt|ndfapi|odbc32|oleacc|oledlg|"
    r"profapi|rasapi32|resutils|rstrtmgr|samlib|schannel|security|sensapi|shcore|srvcli|tapi32|tdh|"
    r"traffic|urlmon|usp10|wbemuuid|wer|wevtapi|windowscodecs|wintrust|winusb|wlanapi|wtsapi32|"
    r"xinput[0-9_]+|xmllite)\.dll|winspool\.drv",
    re.IGNORECASE,
)
_REDISTRIBUTABLE = re.compile(
    r"(vcruntime\d+(_\d)?|msvc[pr]\d+(_\w+)?|concrt\d+|vcomp\d+|mfc\d+u?|atl\d+)\.dll",
    re.IGNORECASE,
)
_MACH_O = re.compile(r"/usr/lib/.*|/System/Library/.*", re.DOTALL)
_SYSTEM_LIBRARIES = {"ELF": _ELF, "PE": _PE, "Mach-O": _MACH_O}
_PYTHON_LIBRARY = re.compile(
    r"(lib)?python[0-9._]*[a-z]*(\.so|\.dll|\.dylib).*|Python", re.IGNORECASE
)

_FOLDER = "binaries/"
_PYTHON = re.compile("_?Py[A-Z_][A-Za-z_]+")


def problems(
    model_description: ParsedDescription, contents: Contents, reader: ReaderProcess
) -> Iterator[Problem]:
    """Yield the problems of the binaries."""
    kinds_by_identifier: dict[str, list[InterfaceKind]] = {}
    for kind in model_description.kinds:
        kinds_by_identifier.setdefault(kind.identifier, []).append(kind)
    for platform, names in _group_by_platform(contents).items():
        expected = PLATFORMS[model_description.fmi].get(platform)
        # Subfolders may contain only static libraries.
        if expected is None or all("/" in name for name in names):
            continue
        for identifier, kinds in kinds_by_identifier.items():
            name = f"{_FOLDER}{platform}/{identifier}{expected.suffix}"
            if name in contents.files:
                file = contents.files[name]
                for rule, text in _check_library(
                    file, model_description, kinds, expected, names, reader
                ):
                    yield rule, f"{sanitise(name)}: {text}"
            elif name not in contents.names:
                elements = " and ".join(kind.element for kind in kinds)
                yield (
                    "binary-missing",
                    f"{_FOLDER}{platform}: it lacks {quote(posixpath.basename(name))}, the name "
                    f"that modelIdentifier of {elements} requires.",
                )


def describe_unknown_platforms(
    model_description: ParsedDescription, contents: Contents
) -> list[str]:
    """Return the folders whose binaries are not checked, with the reason."""
    return [
        f"binaries/{sanitise(platform)}: not checked; the platform is unknown."
        for platform in _group_by_platform(contents)
        if platform not in PLATFORMS[model_description.fmi]
    ]


def platforms(contents: Contents) -> tuple[str, ...]:
    """Return the known platforms that have a library."""
    names_by_platform = _group_by_platform(contents)
    known_platforms = {**PLATFORMS[2], **PLATFORMS[3]}
    return tuple(
        platform
        for platform, expected in known_platforms.items()
        if _has_library(names_by_platform.get(platform, ()), expected.suffix)
    )


def _has_library(names: Iterable[str], suffix: str) -> bool:
    return any("/" not in name and posixpath.splitext(name)[1] == suffix for name in names)


def missing_systems(names: Iterable[str]) -> list[str]:
    """Return the operating systems without a binary, for the platforms that have one."""
    known_platforms = {**PLATFORMS[2], **PLATFORMS[3]}
    covered = {_SYSTEMS[known_platforms[name].format] for name in names}
    return [system for system in _SYSTEMS.values() if system not in covered]


def _group_by_platform(contents: Contents) -> dict[str, set[str]]:
    names_by_platform: dict[str, set[str]] = {}
    for name in contents.names:
        first, _, subpath = name.partition("/")
        platform, _, file = subpath.partition("/")
        if first == "binaries" and file:
            names_by_platform.setdefault(platform, set()).add(file)
    return names_by_platform


def _check_library(
    file: Path,
    model_description: ParsedDescription,
    kinds: list[InterfaceKind],
    expected: Platform,
    neighbours: set[str],
    reader: ReaderProcess,
) -> Iterator[Problem]:
    try:
        library = reader.run(_READER, file, READER_TIMEOUT)
    except DiedError as error:
        yield "binary-unreadable", f"its content could not be read: its reader {error}."
        return
    parts = library["parts"]
    machines = [part["machine"] for part in parts]
    matching_parts = [part for part in parts if part["machine"] in expected.machines]
    if library["format"] != expected.format or not matching_parts:
        is_a = "not a readable library"
        if parts:
            is_a = f"{library['format']} for {', '.join(machines)}"
        needed = " or ".join(expected.machines)
        text = f"it is {is_a}; needed in this folder is {expected.format} for {needed}."
        yield "binary-format", text
        return
    part_problems: list[Problem] = []
    for part in matching_parts:
        part_problems += _exports(part, model_description, kinds)
        part_problems += _needs(part, expected, neighbours)
    yield from dict.fromkeys(part_problems)


def _exports(
    part: Mapping[str, Any], model_description: ParsedDescription, kinds: list[InterfaceKind]
) -> Iterator[Problem]:
    if not part["shared"]:
        yield "binary-format", "it is a program or object file; expected a shared library."
    exports = set(part["exports"])
    if model_description.fmi == 2:
        for kind in kinds:
            yield from _missing(kind, exports)
    elif missing := [name for name in REQUIRED_3 if name not in exports]:
        text = f"it does not export {quote_names(missing)}; FMI 3.0 requires all of its "
        yield "binary-functions", text
    # One library may serve several versions of FMI.
    prefix = f"fmi{model_description.fmi}"
    strange = sorted(n for n in exports if n.startswith(prefix) and n not in KNOWN_FUNCTIONS)
    if strange:
        text = (
            f"it exports {quote_names(strange)}, which FMI {model_description.fmi}.0 does not have."
        )
        yield "binary-unknown", text


def _missing(kind: InterfaceKind, exports: set[str]) -> Iterator[Problem]:
    missing = [name for name in REQUIRED[kind.element] if name not in exports]
    prefixed = [name for name in missing if f"{kind.identifier}_{name}" in exports]
    if prefixed:
        yield (
            "binary-functions",
            f"it exports {quote_names([f'{kind.identifier}_{prefixed[0]}'])} and the like; the "
            "prefix is for source code and static libraries only.",
        )
        return
    promised: set[str] = set()
    for capability, names in FUNCTIONS_BY_FLAG.items():
        broken = [name for name in names if name in missing]
        if broken and kind.can(capability):
            promised.update(broken)
            text = f"it does not export {quote_names(broken)}, though {capability} is 'true'."
            yield "binary-functions", text
    remaining = [name for name in missing if name not in promised]
    if remaining:
        yield (
            "binary-functions",
            f"it does not export {quote_names(remaining)}; FMI 2.0 requires all functions of "
            f"{KINDS[kind.element]}.",
        )


def _place(name: str) -> str:
    for start in ("@rpath/", "@loader_path/"):
        if name.startswith(start):
            return name.removeprefix(start)
    return posixpath.basename(name)


def _needs(part: Mapping[str, Any], expected: Platform, neighbours: set[str]) -> Iterator[Problem]:
    python = [name for name in part["imports"] if _PYTHON.fullmatch(name)]
    foreign_libraries = []
    for name in part["libraries"]:
        if _PYTHON_LIBRARY.fullmatch(posixpath.basename(name)):
            python.append(name)
        elif not _SYSTEM_LIBRARIES[expected.format].fullmatch(name):
            foreign_libraries.append(name)
    if python:
        text = f"it needs a Python interpreter in the host ({quote_names(python, 3)} undefined)."
        yield "binary-python", text
    names = {_place(name) for name in foreign_libraries}
    absent = {"binary-library": list[str](), "binary-runtime": list[str]()}
    for name in sorted(names - neighbours):
        rule = "binary-library"
        if _REDISTRIBUTABLE.fullmatch(name):
            rule = "binary-runtime"
        absent[rule].append(name)
    for rule, absent_names in absent.items():
        if absent_names:
            needed = quote_names(absent_names)
            yield rule, f"it needs {needed}, neither part of the system nor in the FMU."
    origin = any("$ORIGIN" in path or "${ORIGIN}" in path for path in part["run_paths"])
    present = sorted(names & neighbours)
    if present and expected.format == "ELF" and not origin:
        yield (
            "binary-path",
            f"it needs {quote_names(present)} in its folder, but its run path lacks $ORIGIN to "
            "find it.",
        )
