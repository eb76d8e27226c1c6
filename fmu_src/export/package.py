"""Make an FMU from a component: render, compile, zip, validate."""

import hashlib
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal
from uuid import UUID

from fmu_src.export import description3, record
from fmu_src.export.description import Description, to_xml
from fmu_src.export.interface import NAME, Interface, to_c
from fmu_src.export.toolchain import HOST, Target, build, targets
from fmu_src.run.reference_results import Stimuli, result_files
from fmu_src.run.trust import remember
from hesr_model.errors import ExportError
from hesr_model.support.cache import compute_once
from hesr_model.support.files import PathArg, scratch_folder, to_path, written_whole
from hesr_model.support.progress import Progress, report_progress, silent

Version = Literal[2, 3]

_HERE = Path(__file__).parents[1]
_C = _HERE / "c"
_EQUATIONS = files("hesr_model") / "equations"
_GLUE = ("component*.h", "fmi2*.[ch]", "variable.h")
_OPTIONAL = ("component_plain.h",)  # only for components that include it

_ALL_C = """\
/* The whole FMU as one translation unit: compile this file and no other. */
#ifdef __clang__
#pragma STDC FP_CONTRACT OFF
#endif

"""

_INSIDE = """\
/* The glue of FMI 3.0 calls that of FMI 2.0, which is not exported. */
#define FMI2_EXPORT static __attribute__((unused))

"""

_FOLDERS = {
    "linux64": ("x86_64-linux",),
    "win64": ("x86_64-windows",),
    "darwin64": ("x86_64-darwin", "aarch64-darwin"),
}
"""Folders of FMI 3.0 that differ from FMI 2.0."""


@dataclass(frozen=True, kw_only=True)
class Binary:
    """A shared library next to a binary, loaded by the component if there are no `link` flags."""

    name: str
    content: bytes
    flags: tuple[str, ...] = ()
    link: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Content:
    """Contents of the FMU of a component.

    All .c files of `sources` form one translation unit. `stimuli` are the inputs of reference
    results, unless the members already contain results. `origin` is JSON data on what the component
    was made from, for the record of the FMU, which has none without.
    """

    table: Interface
    about: Description
    sources: Mapping[str, str]
    members: Mapping[str, bytes]
    libraries: Mapping[str, Binary] = field(default_factory=dict)
    stimuli: Stimuli | None = None
    terminals: Sequence[description3.Terminal] = ()
    origin: Mapping[str, Any] = field(default_factory=dict)


def read_c_source(name: str) -> str:
    """Return the text of a C file of the package."""
    path = _C / name
    if path.is_file():
        return path.read_text(encoding="utf-8")
    return (_EQUATIONS / name).read_text(encoding="utf-8")


def add_headers(sources: Mapping[str, str]) -> dict[str, str]:
    """Return C files with the headers of the package that they include, directly or not."""
    complete = dict(sources)
    waiting = list(sources.values())
    while waiting:
        for name in re.findall(r'^#include "([\w.]+)"', waiting.pop(), re.MULTILINE):
            if name not in complete:
                complete[name] = read_c_source(name)
                waiting.append(complete[name])
    return complete


def equation_sources(header: str) -> dict[str, str]:
    """Return the C files of a component made of equations, with the given equations.h."""
    names = ("coupling.h", "equations.c", "law_math.h", "wide.h")
    return {name: read_c_source(name) for name in names} | {"equations.h": header}


def write_fmu(
    content: Content,
    path: PathArg,
    *,
    platforms: str | Iterable[str] = HOST,
    progress: Progress = silent,
    fmi: Version = 2,
) -> Path:
    """Compile a component, write it as an FMU and return its path.

    Platforms are names of `toolchain.TARGETS`, or "all". Raises ExportError if
    a binary cannot be built or the FMU is invalid.
    """
    path = to_path(path, "an FMU")
    names = [platforms] if isinstance(platforms, str) else list(platforms)
    requested_targets = check_request(path, names)
    if content.libraries:
        _require_libraries(content, requested_targets)
    interface = content.table
    about = content.about
    guid, sources = translation_unit(content, fmi)
    write_xml = description3.to_xml3 if fmi == 3 else to_xml
    members: dict[str, bytes] = {
        "modelDescription.xml": write_xml(interface, about, guid),
        **read_licence(),
        **content.members,
    }
    members |= {f"sources/{name}": text.encode() for name, text in sorted(sources.items())}
    if fmi == 3:
        _add_members3(members, content)
    members |= _build_libraries(content, sources, requested_targets, fmi, progress)
    if content.stimuli:
        members |= result_files(members, content.stimuli)
    if content.origin:
        members[record.MEMBER] = record.write_record(members, content.origin)
    write_archive(members, path, about.created)
    remember(path)
    return path


def _require_libraries(content: Content, requested_targets: Iterable[Target]) -> None:
    """Raise ExportError if a component needs a library that it does not have for a target."""
    for target in requested_targets:
        if target.folder not in content.libraries:
            raise ExportError(
                f"platform '{target.folder}': this FMU needs a library, which is given for "
                f"{', '.join(content.libraries)} only."
            )


def _add_members3(members: dict[str, bytes], content: Content) -> None:
    """Add what only FMI 3.0 has: build description, icon and terminals."""
    members["sources/buildDescription.xml"] = description3.build_description(content.about)
    picture = members.pop("model.png", None)
    if picture:
        members[description3.ICON] = picture
    terminals = description3.to_terminals(
        content.table, content.terminals, icon=picture is not None
    )
    if terminals:
        members[description3.TERMINALS] = terminals


def _build_libraries(
    content: Content,
    sources: Mapping[str, str],
    requested_targets: Sequence[Target],
    fmi: Version,
    progress: Progress,
) -> dict[str, bytes]:
    """Return the members of an FMU in binaries/."""
    identifier = content.about.identifier
    folders = _FOLDERS if fmi == 3 else {}
    members = {}
    with scratch_folder() as home:
        for name, text in sources.items():
            (home / name).write_text(text, encoding="utf-8")
        for target in report_progress(
            requested_targets, progress, lambda requested: requested.folder
        ):
            binary = content.libraries.get(target.folder)
            library = _build_library(home / "all.c", identifier, target, binary)
            for folder in folders.get(target.folder, (target.folder,)):
                members[f"binaries/{folder}/{identifier}{target.suffix}"] = library
                if binary:
                    members[f"binaries/{folder}/{binary.name}"] = binary.content
    return members


def read_licence() -> dict[str, bytes]:
    """Return the licence of generated code and documentation as a member of an FMU."""
    text = (_HERE / "pages" / "templates" / "license.txt").read_bytes()
    return {"documentation/licenses/license.txt": text}


def translation_unit(content: Content, fmi: Version = 2) -> tuple[str, dict[str, str]]:
    """Return the GUID of an FMU and its C files by name; all.c includes the others."""
    interface = content.table
    about = content.about
    component_sources = content.sources
    patterns: tuple[str, ...] = _GLUE
    head = _ALL_C
    if fmi == 3:
        patterns = (*_GLUE, "fmi3*.[ch]")
        head = _INSIDE + _ALL_C
    glue: list[str] = []
    for pattern in patterns:
        glue += [file.name for file in sorted(_C.glob(pattern))]
    text = "".join(component_sources.values())
    sources = {n: read_c_source(n) for n in glue if n not in _OPTIONAL or f'"{n}"' in text}
    sources |= component_sources
    includes = "".join(f'#include "{name}"\n' for name in sources if name.endswith(".c"))
    sources["all.c"] = head + includes
    if fmi == 3:
        sources["extents.h"] = description3.to_extents(interface)
    guid = _guid(interface, about, sources)
    return guid, sources | {"interface.h": to_c(interface, guid, about.step)}


def write_archive(members: Mapping[str, bytes], path: Path, created: str) -> None:
    """Write an archive, with all members dated `created`, ISO 8601, if it is a valid FMU."""
    with written_whole(path) as temporary:
        zip_members(temporary, members, created)
        texts = [c for name, c in members.items() if name.endswith(".xml")]
        descriptions = [_VALUES.sub(rb'\1=""', text) for text in texts]
        cache_key: list[str | bytes] = [f"fmpy {version('fmpy')}", *members, *descriptions]
        compute_once("valid", cache_key, lambda: _require_valid(temporary, path))


def check_request(path: Path, platforms: Sequence[str]) -> tuple[Target, ...]:
    """Return the requested targets, checking path and names before any slow work."""
    if path.suffix != ".fmu":
        raise ExportError(f"{path}: the name of an FMU ends in .fmu.")
    return targets(platforms)


def _build_library(source: Path, identifier: str, target: Target, binary: Binary | None) -> bytes:
    if binary is None:
        return build(source, identifier, target)
    flags = binary.flags
    if binary.link:
        file = source.parent / target.folder / Path(binary.name).name
        file.parent.mkdir()
        file.write_bytes(binary.content)
        flags += (str(file), *binary.link)
    return build(source, identifier, target, flags)


def _guid(interface: Interface, about: Description, sources: Mapping[str, str]) -> str:
    """Return a GUID of the content, without the GUID itself."""
    content = hashlib.sha256(to_xml(interface, about, ""))
    content.update(to_c(interface, "", about.step).encode())
    for name, text in sorted(sources.items()):
        content.update(f"\0{name}\0{text}".encode())
    return f"{{{UUID(bytes=content.digest()[:16])}}}"


_HIGH_COMPRESSION_LIMIT = 1 << 20  # [B]


def zip_members(path: Path, members: Mapping[str, bytes], created: str) -> None:
    """Write an archive with members of one date, ISO 8601: the same bytes every time."""
    date = datetime.fromisoformat(created)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            entry = zipfile.ZipInfo(name, date.timetuple()[:6])
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3  # Unix on every host
            permissions = 0o644
            if name.startswith("binaries/"):
                permissions = 0o755
            entry.external_attr = permissions << 16
            level = 9
            if len(content) >= _HIGH_COMPRESSION_LIMIT:
                level = 6  # higher ones take three times as long for 0.4 %
            archive.writestr(entry, content, compresslevel=level)


_VALUES = re.compile(rb'(?<!<Dimension )\b(start|guid|instantiationToken)="[^"]*"')
"""Values without influence on the validity of a description."""


def _require_valid(temporary: Path, path: Path) -> bytes:
    from fmpy import read_model_description  # slow to import
    from fmpy.model_description import ValidationError
    from fmpy.validation import validate_fmu

    with suppress(ValidationError), zipfile.ZipFile(temporary) as archive:
        model_description = read_model_description(str(temporary), validate_model_structure=True)
        # FMPy's grammar takes a millisecond per name.
        has_plain_names = all(
            NAME.fullmatch(variable.name) for variable in model_description.modelVariables
        )
        if has_plain_names and not any("\\" in name for name in archive.namelist()):
            return b"valid"
    problems = validate_fmu(str(temporary))
    if problems:
        raise ExportError(f"{path}: not a valid FMU: {problems[0]}")
    return b"valid"
