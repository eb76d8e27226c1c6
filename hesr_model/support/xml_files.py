"""XML files from elements."""

from xml.etree import ElementTree as ET


def to_bytes(root: ET.Element) -> bytes:
    """Serialise an element to the bytes of a file."""
    ET.indent(root)
    data: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return data + b"\n"
