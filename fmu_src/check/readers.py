"""Readers of untrusted files, run in the sandbox so that no file can stall a check."""

import re
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

MAX_SYMBOLS = 10_000
MAX_ERRORS = 10_000
MAX_NAMES = 1000  # parsed by FMPy in a millisecond each

_SCHEMAS = {
    "1.0": "schema/fmi1/fmiModelDescription.xsd",
    "2.0": "schema/fmi2/fmi2ModelDescription.xsd",
    "3": "schema/fmi3/fmi3ModelDescription.xsd",
    "fmiTerminalsAndIcons": "schema/fmi3/fmi3TerminalsAndIcons.xsd",
    "fmiBuildDescription": "schema/fmi3/fmi3BuildDescription.xsd",
    "SystemStructureDescription": "ssp/schema/SystemStructureDescription.xsd",
    "ParameterSet": "ssp/schema/SystemStructureParameterValues.xsd",
    "ParameterMapping": "ssp/schema/SystemStructureParameterMapping.xsd",
    "SignalDictionary": "ssp/schema/SystemStructureSignalDictionary.xsd",
}
"""Schemas by version, or by root element if it is the same in all versions."""


def validate(file: str) -> tuple[list[str], str]:
    """Return the problems that FMPy finds beyond the schema, or why it cannot read the file."""
    try:
        return _list_messages(file), ""
    except Exception as error:
        reason = str(error) or type(error).__name__
        if _is_unread_type(reason, file):
            return [], reason
        # FMPy raises bare exceptions for violations; others are its own faults.
        if type(error) is Exception:
            return [reason], ""
        problems = getattr(error, "problems", [])
        if problems:
            return problems, ""
        return [], f"{type(error).__name__}: {reason}"


def _list_messages(file: str) -> list[str]:
    from fmpy import read_model_description
    from fmpy.validation import validate_model_description

    model_description = read_model_description(file, validate=False)
    messages = validate_model_description(model_description, validate_model_structure=True)
    exempt = set()
    odd_variables = []
    for variable in model_description.modelVariables:
        if variable.alias or variable.type == "Clock":
            exempt.add(variable.name)
        if not _LEGAL.fullmatch(variable.name):
            odd_variables.append(variable)
    if odd_variables:  # loading the grammar of names is slow
        model_description.modelVariables = odd_variables[:MAX_NAMES]
        model_description.fmiVersion = ""
        messages = (
            validate_model_description(model_description, validate_variable_names=True) + messages
        )
    return [message for message in dict.fromkeys(messages) if not _is_fmi_3_only(message, exempt)]


_UNDEFINED = re.compile(r'Variable .* has declaredType="(.*)" which has not been defined\.')


def _is_unread_type(reason: str, file: str) -> bool:
    """Whether a type that FMPy calls undefined is defined; it skips ClockType."""
    undefined = _UNDEFINED.fullmatch(reason)
    if undefined is None:
        return False
    from lxml import etree

    with zipfile.ZipFile(file) as archive:
        parser = etree.XMLParser(resolve_entities=False, no_network=True)
        root = etree.fromstring(archive.read("modelDescription.xml"), parser)
    return any(clock.get("name") == undefined[1] for clock in root.iterfind(_CLOCK_TYPES))


_CLOCK_TYPES = "TypeDefinitions/ClockType"
_PART = r"[A-Za-z_]\w*(\[\d+(,\d+)*\])?"
_LEGAL = re.compile(rf"{_PART}(\.{_PART})*|der\({_PART}(\.{_PART})*(,\d+)?\)", re.ASCII)
_INITIAL = re.compile(r"ModelStructure/InitialUnknowns .*Expected \{(.*)\} but was \{(.*)\}\.")


def _is_fmi_3_only(problem: str, exempt: set[str]) -> bool:
    """Whether FMPy only misses aliases and clocks of FMI 3, which are no initial unknowns."""
    sets = _INITIAL.fullmatch(problem)
    if not sets:
        return False
    expected, actual = (set(names.split(", ")) - {""} for names in sets.groups())
    return expected - exempt == actual - exempt


def compare(file: str) -> list[tuple[int, str, str]]:
    """Return line, kind and message of each schema violation; no DTD, no entities."""
    from lxml import etree

    root = etree.parse(file, etree.XMLParser(resolve_entities=False, no_network=True)).getroot()
    schema_path = find_schema(root.tag, root.attrib)
    if schema_path is None:
        return []
    schema = etree.XMLSchema(file=str(schema_path))
    schema.validate(root)
    version = 2
    if root.get("fmiVersion", "").startswith("3."):
        version = 3
    violations = []
    for error in islice(schema.error_log, MAX_ERRORS):
        kind = error.type_name.removeprefix("SCHEMAV_").lower()
        message = _add_suggestion(str(error.message)[:1000], version)
        violations.append((error.line, kind, message))
    return violations


_NOT_ALLOWED = re.compile(r"Element '(\w+)', attribute '(\w+)': The attribute .* is not allowed\.")
_NOT_EXPECTED = re.compile(
    r"Element '(\w+)': This element is not expected\. Expected is (?:one of )?\( (.*) \)\."
)


def _add_suggestion(message: str, version: int) -> str:
    """Return a message of the schema with the names of FMI that may have been meant."""
    from fmu_src.run.vocabulary import suggest_names
    from hesr_model.support.ledger import find_close_names, format_suggestion

    suggestion = ""
    if match := _NOT_ALLOWED.fullmatch(message):
        suggestion = suggest_names(version, match[1], match[2])
    elif match := _NOT_EXPECTED.fullmatch(message):
        suggestion = format_suggestion(find_close_names(match[1], match[2].split(", ")))
    if not suggestion:
        return message
    return f"{message} D{suggestion[1:]}"


def find_schema(tag: str, attributes: Mapping[str, str]) -> Path | None:
    """Return the schema for a root element, None if it is not installed."""
    version = attributes.get("fmiVersion", "")
    if version.startswith("3."):
        version = "3"
    name = _SCHEMAS.get(tag.rpartition("}")[2]) or _SCHEMAS[version]
    package = "fmpy"
    if name.startswith("ssp/") and attributes.get("version", "").startswith("2."):
        package = "pyssp_standard"
        name = f"resources/ssp2/{Path(name).name}"
    return next((place / name for place in find_package_folders(package)), None)


def find_package_folders(package: str) -> list[Path]:
    """Return the folders of an installed package without importing it, which may be slow."""
    spec = find_spec(package)
    if spec is None:
        return []
    return [Path(location) for location in spec.submodule_search_locations or ()]


def inspect(file: str) -> dict[str, Any]:
    """Return the format of a library, or None, and its parts, one per architecture."""
    import lief

    lief.logging.disable()
    if lief.is_elf(file):
        return _answer("ELF", [lief.ELF.parse(file)], _elf)
    if lief.is_pe(file):
        return _answer("PE", [lief.PE.parse(file)], _pe)
    if lief.is_macho(file):
        return _answer("Mach-O", lief.MachO.parse(file), _mach_o)
    return _answer("", (), _mach_o)


def _answer(kind: str, parts: Any, read: Callable[[Any], dict[str, Any]]) -> dict[str, Any]:
    # `parts` stays alive here: LIEF's parts do not keep their file alive.
    part_records = [read(part) for part in parts or () if part is not None]
    if not part_records:
        return {"format": None, "parts": []}
    return {"format": kind, "parts": part_records}


def _word(value: object) -> str:
    return str(value).rpartition(".")[2].upper()


def _exports(names: Iterable[object]) -> list[str]:
    return list(islice((str(n) for n in names if n and "fmi" in str(n)), MAX_SYMBOLS))


def _imports(names: Iterable[object]) -> list[str]:
    return list(islice((str(n) for n in names if n and "Py" in str(n)), MAX_SYMBOLS))


def _elf(elf: Any) -> dict[str, Any]:
    # The imported symbols of lief lack those without a type.
    symbols = [s for s in elf.dynamic_symbols if _word(s.binding) in ("GLOBAL", "WEAK")]
    run_paths = []
    for entry in elf.dynamic_entries:
        names = [name for name in ("runpath", "rpath") if hasattr(entry, name)]
        run_paths += [str(getattr(entry, name)) for name in names]
    return {
        "machine": _word(elf.header.machine_type),
        "shared": _word(elf.header.file_type) in ("DYN", "DYNAMIC"),
        "exports": _exports(s.name for s in symbols if s.shndx),
        "imports": _imports(s.name for s in symbols if not s.shndx),
        "libraries": [str(library) for library in elf.libraries],
        "run_paths": run_paths,
    }


def _pe(pe: Any) -> dict[str, Any]:
    exports = pe.get_export()
    exported_names: list[Any] = []
    if exports:
        exported_names += [entry.name for entry in exports.entries]
    libraries = [*pe.imports, *getattr(pe, "delay_imports", ())]
    imported_names: list[Any] = []
    for library in libraries:
        imported_names += [entry.name for entry in library.entries]
    return {
        "machine": _word(pe.header.machine),
        "shared": "DLL" in {_word(c) for c in pe.header.characteristics_list},
        "exports": _exports(exported_names),
        "imports": _imports(imported_names),
        "libraries": [str(library.name) for library in libraries],
        "run_paths": [],
    }


def list_exports(part: Any) -> Iterator[Any]:
    """Yield the symbols of the export trie, and defined external ones of the symbol table."""
    yield from part.exported_symbols
    yield from (s for s in part.symbols if _word(s.category) == "EXTERNAL")


def _mach_o(part: Any) -> dict[str, Any]:
    return {
        "machine": _word(part.header.cpu_type),
        "shared": _word(part.header.file_type) in ("DYLIB", "BUNDLE"),
        "exports": _exports(str(s.name).removeprefix("_") for s in list_exports(part)),
        "imports": _imports(str(s.name).removeprefix("_") for s in part.imported_symbols),
        "libraries": [str(x.name) for x in part.libraries if _word(x.command) != "ID_DYLIB"],
        "run_paths": [str(path.path) for path in part.rpaths],
    }
