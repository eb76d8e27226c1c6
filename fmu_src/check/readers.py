"""Readers of untrusted files, run in the sandbox so that no file can stall a check."""

from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

MOST_SYMBOLS = 10_000
MOST_ERRORS = 10_000

_SCHEMAS = {
    "1.0": "fmi1/fmiModelDescription.xsd",
    "2.0": "fmi2/fmi2ModelDescription.xsd",
    "3": "fmi3/fmi3ModelDescription.xsd",
    "fmiTerminalsAndIcons": "fmi3/fmi3TerminalsAndIcons.xsd",
    "fmiBuildDescription": "fmi3/fmi3BuildDescription.xsd",
}
"""Schemas by version, or by root element if it is the same in all versions."""


def validate(file: str) -> list[str]:
    """Return the problems that FMPy finds."""
    from fmpy.validation import validate_fmu

    return [str(problem) for problem in validate_fmu(file)]


def compare(file: str) -> list[tuple[int, str]]:
    """Return line and message of each schema violation of a file without DTD and entities."""
    import fmpy
    from lxml import etree

    root = etree.parse(file, etree.XMLParser(resolve_entities=False, no_network=True)).getroot()
    version = root.get("fmiVersion", "")
    name = _SCHEMAS.get(root.tag) or _SCHEMAS["3" if version.startswith("3.") else version]
    schema = etree.XMLSchema(file=str(Path(fmpy.__file__).parent / "schema" / name))
    schema.validate(root)
    return [(e.line, str(e.message)[:1000]) for e in islice(schema.error_log, MOST_ERRORS)]


def inspect(file: str) -> dict[str, Any]:
    """Return the format of a library, or None, and its parts, one per architecture."""
    import lief

    lief.logging.disable()
    if lief.is_elf(file):
        return _answer("ELF", [_elf(lief.ELF.parse(file))])
    if lief.is_pe(file):
        return _answer("PE", [_pe(lief.PE.parse(file))])
    if lief.is_macho(file):
        parts = lief.MachO.parse(file)
        return _answer("Mach-O", [_mach_o(part) for part in parts or ()])
    return _answer(None, [])


def _answer(kind: str | None, parts: list[dict[str, Any] | None]) -> dict[str, Any]:
    readable = [part for part in parts if part is not None]
    return {"format": kind if readable else None, "parts": readable}


def _word(value: object) -> str:
    return str(value).rpartition(".")[2].upper()


def _exports(names: Iterable[object]) -> list[str]:
    return list(islice((str(n) for n in names if n and "fmi" in str(n)), MOST_SYMBOLS))


def _imports(names: Iterable[object]) -> list[str]:
    return list(islice((str(n) for n in names if n and "Py" in str(n)), MOST_SYMBOLS))


def _elf(elf: Any) -> dict[str, Any] | None:
    if elf is None:
        return None
    # The imported symbols of lief lack those without a type.
    symbols = [s for s in elf.dynamic_symbols if _word(s.binding) in ("GLOBAL", "WEAK")]
    return {
        "machine": _word(elf.header.machine_type),
        "shared": _word(elf.header.file_type) in ("DYN", "DYNAMIC"),
        "exports": _exports(s.name for s in symbols if s.shndx),
        "imports": _imports(s.name for s in symbols if not s.shndx),
        "libraries": [str(library) for library in elf.libraries],
        "run_paths": [
            str(getattr(entry, name))
            for entry in elf.dynamic_entries
            for name in ("runpath", "rpath")
            if hasattr(entry, name)
        ],
    }


def _pe(pe: Any) -> dict[str, Any] | None:
    if pe is None:
        return None
    exports = pe.get_export()
    imports = list(pe.imports) + list(getattr(pe, "delay_imports", ()))
    return {
        "machine": _word(pe.header.machine),
        "shared": "DLL" in {_word(c) for c in pe.header.characteristics_list},
        "exports": _exports(e.name for e in exports.entries) if exports else [],
        "imports": _imports(e.name for library in imports for e in library.entries),
        "libraries": [str(library.name) for library in imports],
        "run_paths": [],
    }


def _mach_o(part: Any) -> dict[str, Any]:
    return {
        "machine": _word(part.header.cpu_type),
        "shared": _word(part.header.file_type) in ("DYLIB", "BUNDLE"),
        "exports": _exports(str(s.name).removeprefix("_") for s in part.exported_symbols),
        "imports": _imports(str(s.name).removeprefix("_") for s in part.imported_symbols),
        "libraries": [str(x.name) for x in part.libraries if _word(x.command) != "ID_DYLIB"],
        "run_paths": [str(path.path) for path in part.rpaths],
    }
