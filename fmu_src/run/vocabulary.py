"""Parts of model descriptions that FMI does not have, by the schemas of FMI 2.0 and 3.0.

Importers ignore them, so that a mistyped `start` leaves the default.
"""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from xml.etree import ElementTree as ET

from hesr_model.findings import Finding, caution
from hesr_model.support.ledger import (
    Ledger,
    LeftOver,
    find_close_names,
    format_suggestion,
    list_left_over,
)
from hesr_model.support.text import quote

Vocabulary = Mapping[str, frozenset[str]]  # attributes and child elements by element

_XS = "{http://www.w3.org/2001/XMLSchema}"
_ANYTHING = "*"  # child elements of any name
_MAX_FINDINGS = 3  # of one file


@cache
def read_vocabulary(version: int) -> Vocabulary:
    """Return the names that FMI 2 or 3 has in each element but those of any content.

    Elements of one name in several places have the names of all.
    """
    schemas = [ET.parse(file).getroot() for file in _list_schemas(version)]
    declared = {(node.tag, node.get("name", "")): node for node in chain.from_iterable(schemas)}
    vocabulary: dict[str, set[str]] = {}
    for schema in schemas:
        for element in schema.iter(f"{_XS}element"):
            if "name" in element.attrib:
                names = vocabulary.setdefault(element.attrib["name"], set())
                names.update(_list_names(element, declared))
                names.update(_list_declared(f"{_XS}complexType", element.get("type"), declared))
    return {
        element: frozenset(names) for element, names in vocabulary.items() if _ANYTHING not in names
    }


def _list_schemas(version: int) -> list[Path]:
    """Return the schemas in FMPy, which is not imported for this."""
    spec = find_spec("fmpy")
    folders = spec.submodule_search_locations if spec else None
    files = [Path(folder, "schema", f"fmi{version}").glob("*.xsd") for folder in folders or ()]
    return sorted(chain.from_iterable(files))


_Declared = Mapping[tuple[str, str], ET.Element]  # types and groups by kind and name


def _list_names(node: ET.Element, declared: _Declared) -> Iterator[str]:
    """Yield attributes and child elements within a node of a schema."""
    for child in node:
        kind = child.tag.removeprefix(_XS)
        if kind in ("any", "anyAttribute"):
            yield _ANYTHING
        elif kind in ("attribute", "element"):
            yield child.get("name", child.get("ref", ""))
        else:
            yield from _list_declared(child.tag, child.get("ref"), declared)
            yield from _list_declared(f"{_XS}complexType", child.get("base"), declared)
            yield from _list_names(child, declared)


def _list_declared(tag: str, name: str | None, declared: _Declared) -> Iterator[str]:
    node = declared.get((tag, name or ""))
    if node is not None:
        yield from _list_names(node, declared)


def find_left_over(root: ET.Element, where: str) -> list[LeftOver]:
    """Return what FMI does not have in a description; parts of other namespaces are left out."""
    vocabulary = read_vocabulary(3 if root.get("fmiVersion", "").startswith("3.") else 2)
    ledger = Ledger(where, "part")
    stack = [root]
    while stack:
        element = stack.pop()
        known = vocabulary[element.tag]
        children = [child for child in element if isinstance(child.tag, str)]
        _compare_names(ledger, element.tag, element.attrib, known, may_repeat=False)
        _compare_names(ledger, element.tag, [child.tag for child in children], known)
        stack += [child for child in children if child.tag in known and child.tag in vocabulary]
    return ledger.left_over


def _compare_names(
    ledger: Ledger,
    element: str,
    names: Iterable[str],
    known: frozenset[str],
    *,
    may_repeat: bool = True,
) -> None:
    # Descriptions have 10^5 elements, which are nearly always right.
    if not known.issuperset(names):
        plain_names = [name for name in names if not name.startswith("{")]
        ledger.compare(f"<{element}>", plain_names, known, may_repeat=may_repeat)


def judge_description(data: bytes, where: str) -> list[Finding]:
    """Return a warning for each name that is probably mistyped, at most three."""
    try:
        root = ET.fromstring(data)
    except (ET.ParseError, LookupError, ValueError):  # reported by the reader of the description
        return []
    if root.tag != "fmiModelDescription":
        return []
    mistyped = [item for item in find_left_over(root, where) if item.meant]
    if len(mistyped) <= _MAX_FINDINGS:
        return [_warn(item, where) for item in mistyped]
    shown = mistyped[: _MAX_FINDINGS - 1]
    others = [item.text for item in mistyped[len(shown) :]]
    observation = f"{len(others)} more names are not used: {list_left_over(where, others)}"
    return [
        *(_warn(item, where) for item in shown),
        caution(check="left-over", where=where, found=observation),
    ]


def _warn(item: LeftOver, where: str) -> Finding:
    observation = f"{quote(item.name)} is no part of {item.place} and is not used"
    return caution(
        check="left-over", where=where, found=f"{observation}; {format_suggestion(item.meant)}"
    )


def suggest_names(version: int, element: str, name: str) -> str:
    """Return "did you mean ..?" for a name that an element does not have, or ""."""
    known = read_vocabulary(version).get(element, frozenset())
    return format_suggestion(find_close_names(name, known))
