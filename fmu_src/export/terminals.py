"""terminalsAndIcons.xml of FMI 3.0: terminals and an icon."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.etree import ElementTree as ET

from fmu_src.export.description import to_bytes
from fmu_src.export.description3 import Arrays
from fmu_src.export.interface import Interface

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
ICON = "terminalsAndIcons/icon.png"

Kind = Literal["signal", "inflow", "outflow"]
"""Kind of a member: a signal, or an inflow or outflow that sums to zero."""

_SIZE = "100"  # in the coordinates of the picture


@dataclass(frozen=True, kw_only=True)
class Terminal:
    """Variables of a joint that are connected together; see `Interface.connected`.

    `kind` is a class of the Modelica Standard Library; each member has the name of its variable
    without index, and a kind.
    """

    name: str
    kind: str
    description: str
    members: Mapping[str, tuple[str, Kind]]


def to_terminals(table: Interface, terminals: Sequence[Terminal], *, icon: bool) -> bytes | None:
    """Return terminalsAndIcons.xml, or None if it would be empty."""
    if not terminals and not icon:
        return None
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    if icon:
        picture = ET.SubElement(root, "GraphicalRepresentation")
        place = {"x1": f"-{_SIZE}", "y1": f"-{_SIZE}", "x2": _SIZE, "y2": _SIZE}
        ET.SubElement(picture, "CoordinateSystem", place, suggestedScalingFactorTo_mm="0.1")
        ET.SubElement(picture, "Icon", place)
    if terminals:
        parent = ET.SubElement(root, "Terminals")
        names = [array.name for array in Arrays(table).all]
        for terminal in terminals:
            first, _ = next(iter(terminal.members.values()))
            for name in names:
                if name.startswith(f"{first}["):
                    _add(parent, terminal, name.removeprefix(first))
    return to_bytes(root)


def _add(parent: ET.Element, terminal: Terminal, index: str) -> None:
    about = {"name": terminal.name + index, "matchingRule": "plug", "terminalKind": terminal.kind}
    element = ET.SubElement(parent, "Terminal", about, description=terminal.description)
    for member, (variable, kind) in terminal.members.items():
        about = {"variableName": variable + index, "memberName": member, "variableKind": kind}
        ET.SubElement(element, "TerminalMemberVariable", about)
