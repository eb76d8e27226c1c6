"""Systems of FMUs inside one FMU of FMI 2.0, run by FMPy's container runtime.

The runtime steps all components, then passes values along the connections. Outputs with direct
feedthrough use the newest inputs; states use those at the beginning of the step. Our library in
front of it accepts any step, not only multiples.

FMPy's builder cannot be used: for FMI 2.0 it writes connections of type Real, which the runtime
refuses, and value reference 0, the time, and its archives are not reproducible.
"""

import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib.metadata import distribution
from pathlib import Path
from posixpath import normpath
from typing import Any
from uuid import UUID

from cosim.systems.system import SystemSpec
from fmu_src.export.interface import literal
from fmu_src.export.package import own_source, write_archive
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.run.archive import Archive
from fmu_src.run.master import Element
from fmu_src.run.reference_results import Stimuli, result_files
from fmu_src.run.trust import is_ours, remember
from hesr.extras.ssp.container_description import Exposed, exposed_variables, to_description
from hesr.extras.ssp.contents import SystemContents, read_contents, text_of
from hesr_model.errors import ConfigError, ExportError
from hesr_model.support.compiler import compile_c
from hesr_model.support.files import scratch_folder

_RUNTIMES = {"linux64": ("x86_64-linux", ".so"), "win64": ("x86_64-windows", ".dll")}
"""Folder and suffix of FMPy's runtime; FMI 2.0 has one folder for its two macOS binaries."""

_RUNTIME = "container_fmu"
_LICENSE = "documentation/licenses/fmpy.txt"
_TYPES = {"Real": "Float64", "Integer": "Int32", "Enumeration": "Int32"}


def export_container(spec: SystemSpec, path: Path, output: Path) -> None:
    """Write the system of a file as one FMU."""
    write_container(read_contents(spec, path), output)


def write_container(contents: SystemContents, path: Path) -> Path:
    """Write a system as one FMU and return the path; the bytes are reproducible.

    Raises ConfigError if a component has its own step or the binaries share no platform.
    """
    if path.suffix != ".fmu":
        raise ExportError(f"{path}: the name of an FMU ends in .fmu.")
    for component in contents.spec.components:
        if contents.spec.every(component) > 1:
            raise ConfigError(
                f"{contents.path}: component '{component.name}' has a step of {component.step:g} "
                f"s; it must equal the container's, {contents.spec.step:g} s."
            )
    nested = {
        c.name: _members(c.fmu, contents.descriptions[c.name]) for c in contents.spec.components
    }
    identifier = re.sub(r"\W", "_", contents.spec.name, flags=re.ASCII)
    members = _runtimes(contents, nested, identifier)
    for name, files in nested.items():
        members |= {f"resources/{name}/{file}": content for file, content in files.items()}
        if not any(file.startswith("resources/") for file in files):
            # The runtime passes NULL for a missing folder, and FMUs of other tools then fail.
            members[f"resources/{name}/resources/empty.txt"] = b""
    exposed = list(exposed_variables(contents))
    described = to_description(contents, exposed, identifier, "")
    guid = _guid({**members, "0": described, "1": _configuration(contents, exposed, "")})
    members = {
        "modelDescription.xml": to_description(contents, exposed, identifier, guid),
        "resources/container.json": _configuration(contents, exposed, guid),
        **members,
    }
    ours = [is_ours(component.fmu) for component in contents.spec.components]
    if all(ours):
        members |= result_files(members, Stimuli(step=contents.spec.step))
    write_archive(members, path, contents.created)
    if all(ours):
        remember(path)
    return path


def _members(fmu: Path, description: Any) -> dict[str, bytes]:
    """Return the files of an FMU, with a library built from its sources if it has no binary."""
    with Archive(fmu) as archive:
        found = {name: archive.read(name) for name in archive.names}
        sources = [
            name
            for configuration in description.buildConfigurations
            if configuration.modelIdentifier == description.coSimulation.modelIdentifier
            for of_set in configuration.sourceFileSets
            for name in map(normpath, of_set.sourceFiles)
            if f"sources/{name}" in found
        ]
        if sources and not any(name.startswith("binaries/linux64/") for name in found):
            library = f"{description.coSimulation.modelIdentifier}.so"
            with scratch_folder() as folder:
                archive.unpack(folder, lambda name: name.startswith("sources/"))
                _build(folder / "sources", sources, folder / library)
                found[f"binaries/linux64/{library}"] = (folder / library).read_bytes()
    return found


def _build(folder: Path, sources: Sequence[str], library: Path) -> None:
    first, *others = (folder / name for name in sources)
    headers = distribution("fmpy").locate_file("fmpy/c-code")
    flags = ("-target", *TARGETS["linux64"].triples, "-w", "-O2", "-fPIC", "-shared")
    last = ("-DFMI2_OVERRIDE_FUNCTION_PREFIX", *map(str, others), "-lm")
    compile_c(first, (*flags, f"-I{folder}", f"-isystem{headers}"), library, last)


def _runtimes(
    contents: SystemContents, nested: Mapping[str, Mapping[str, bytes]], identifier: str
) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for platform, (folder, suffix) in _RUNTIMES.items():
        if all(
            f"binaries/{platform}/{contents.descriptions[n].coSimulation.modelIdentifier}{suffix}"
            in files
            for n, files in nested.items()
        ):
            name = _RUNTIME + suffix
            own = _holding(identifier, contents.spec.step, platform, name)
            found[f"binaries/{platform}/{identifier}{suffix}"] = own
            found[f"binaries/{platform}/{name}"] = _runtime(folder, name)
    if not found:
        raise ConfigError(
            f"{contents.path}: no platform of a container ({', '.join(_RUNTIMES)}) has binaries of "
            "all components."
        )
    package = distribution("fmpy")
    terms = [file for file in package.files or () if file.name.upper().startswith("LICENSE")]
    return found | {_LICENSE: terms[0].read_binary()}


def holding_sources(step: float, runtime: str) -> dict[str, str]:
    """Return the C sources of the library that holds outputs between steps [s] of the runtime."""
    texts = {name: own_source(name) for name in ("beside.h", "fmi2.h", "hold.c")}
    texts["hold.h"] = (
        f'#define RUNTIME_FILE "{runtime}"\n#define RUNTIME_STEP {literal(step)} /* [s] */\n'
    )
    return texts


def _holding(identifier: str, step: float, platform: str, runtime: str) -> bytes:
    with scratch_folder() as folder:
        for name, text in holding_sources(step, runtime).items():
            Path(folder, name).write_text(text, encoding="utf-8")
        flags = ("-ldl",) if platform == "linux64" else ()
        return build(Path(folder, "hold.c"), identifier, TARGETS[platform], flags)


def _runtime(folder: str, name: str) -> bytes:
    try:
        from fmpy import container_fmu

        return (Path(container_fmu.__file__).parent / "binaries" / folder / name).read_bytes()
    except (ImportError, OSError) as error:
        raise ExportError(
            f"FMPy {distribution('fmpy').version} has no container runtime; install FMPy 0.3.32 or "
            "newer."
        ) from error


def _configuration(contents: SystemContents, exposed: list[Exposed], guid: str) -> bytes:
    from fmpy.container_fmu import __version__

    spec = contents.spec
    place = {component.name: i for i, component in enumerate(spec.components)}
    data = {
        "containerVersion": __version__,
        "instantiationToken": guid,
        "fixedStepSize": spec.step,
        "parallelDoStep": False,
        "components": [
            {
                "fmiMajorVersion": "2",
                "name": c.name,
                "instantiationToken": contents.descriptions[c.name].instantiationToken,
                "modelIdentifier": contents.descriptions[c.name].coSimulation.modelIdentifier,
                "path": c.name,
            }
            for c in spec.components
        ],
        "variables": [_variable(contents, place, variable) for variable in exposed],
        "connections": list(_connections(contents, place)),
    }
    return (json.dumps(data, indent=1) + "\n").encode()


def _variable(
    contents: SystemContents, place: Mapping[str, int], variable: Exposed
) -> dict[str, Any]:
    name, own = variable.element
    described = contents.variables[name][own]
    data: dict[str, Any] = {
        "variableType": _TYPES.get(described.type, described.type),
        "mappings": [{"component": place[name], "valueReference": described.valueReference}],
    }
    start = contents.wiring.start[name].get(own)
    if start is not None and variable.start is not None:  # connected inputs have none
        data["start"] = [text_of(contents.type_of(variable.element), start)]
    return data


def _connections(contents: SystemContents, place: Mapping[str, int]) -> Iterator[dict[str, Any]]:
    sources, variables = contents.wiring.sources, contents.variables
    waiting = [element for element in contents.wiring.order if element in sources]

    def known(output: Element) -> bool:
        name, variable = output
        return not any((name, into) in waiting for into in variables[name].feedthrough[variable])

    def kind_of(into: Element) -> str:
        kinds = {variables[name][own].type for name, own in (into, sources[into])}
        types = {_TYPES.get(kind, str(kind)) for kind in kinds}
        if len(types) > 1:
            raise ConfigError(
                f"{contents.path}: connection of '{'.'.join(into)}': FMPy's container runtime does "
                f"not connect {' and '.join(sorted(kinds))}."
            )
        return types.pop()

    while waiting:
        source, target = sources[waiting[0]][0], waiting[0][0]
        kind = kind_of(waiting[0])
        ready = [
            into
            for into in waiting
            if (sources[into][0], into[0]) == (source, target)
            and kind_of(into) == kind
            and known(sources[into])
        ]
        waiting = [into for into in waiting if into not in ready]
        outputs = [sources[into][1] for into in ready]
        yield {
            "variableType": kind,
            "srcComponent": place[source],
            "dstComponent": place[target],
            "srcValueReferences": [variables[source][out].valueReference for out in outputs],
            "dstValueReferences": [variables[target][into].valueReference for _, into in ready],
            "size": len(ready),
        }


def _guid(members: Mapping[str, bytes]) -> str:
    content = hashlib.sha256()
    for name, data in members.items():
        content.update(f"\0{name}\0{len(data)}\0".encode() + data)
    return f"{{{UUID(content.hexdigest()[:32])}}}"
