"""XML files: read with prefixes that they do not declare, and written from elements."""

import re
from collections.abc import Mapping
from xml.etree import ElementTree as ET

_UNBOUND_PREFIX = 27  # of expat: an element or attribute whose prefix is not declared
_PREFIX = re.compile(r"[<\s/]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*(?=[\s=/>])")
_DECLARED_PREFIX = re.compile(r"\bxmlns:([\w.-]+)\s*=")
_FIRST_TAG = re.compile(r"<[A-Za-z_][\w.:-]*")


def parse_xml(data: str | bytes, namespaces: Mapping[str, str] | None = None) -> ET.Element:
    """Parse XML, also with prefixes as ``drake:`` that it does not declare.

    Parsers of other tools know no namespaces, so that nobody misses the declaration. Such a prefix
    has the namespace in `namespaces`, or its own name. Raises what ElementTree raises.
    """
    try:
        return ET.fromstring(data)
    except ET.ParseError as error:
        if error.code != _UNBOUND_PREFIX:
            raise
        content = data if isinstance(data, str) else data.decode()
    declared = {"xml", "xmlns", *_DECLARED_PREFIX.findall(content)}
    declarations = "".join(
        f' xmlns:{prefix}="{(namespaces or {}).get(prefix, prefix)}"'
        for prefix in dict.fromkeys(_PREFIX.findall(content))
        if prefix not in declared
    )
    # What comes before the first element has no prefixes.
    return ET.fromstring(_FIRST_TAG.sub(rf"\g<0>{declarations}", content, count=1))


def to_bytes(root: ET.Element) -> bytes:
    """Serialise an element to the bytes of a file."""
    ET.indent(root)
    data: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return data + b"\n"
