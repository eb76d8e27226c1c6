"""Rules on terminalsAndIcons.xml of FMI 2.0 and 3.0."""

from collections.abc import Iterator

from lxml import etree

from fmu_src.check.archive import Contents
from fmu_src.check.description import ParsedDescription, name_of, names_of
from fmu_src.check.general import repeated
from fmu_src.check.rules import Problem
from hesr_model.support.text import quoted

FILE = "terminalsAndIcons/terminalsAndIcons.xml"
_ICON = "terminalsAndIcons/icon.png"


def problems(
    root: etree._Element, about: ParsedDescription, contents: Contents
) -> Iterator[Problem]:
    """Yield missing references and repeated names of terminals."""
    known = {name for v in about.variables for name in (v.name, *v.others)}
    yield from repeated(
        "terminal-twice", "terminal", names_of(root.findall("Terminals/Terminal")), "there"
    )
    for terminal in root.iter("Terminal"):
        members = terminal.findall("TerminalMemberVariable")
        who = f"terminal {quoted(name_of(terminal))}"
        named = [e.get("memberName", "") for e in members if e.get("memberName")]
        yield from repeated("terminal-twice", f"member of the {who},", named, "there")
        nested = names_of(terminal.findall("Terminal"))
        yield from repeated("terminal-twice", f"nested terminal of the {who},", nested, "there")
        for member in members:
            if (variable := member.get("variableName", "")) not in known:
                yield (
                    "terminal-member",
                    f"the {who} has the member {quoted(variable)}, which is not a variable.",
                )
    if root.find("GraphicalRepresentation/Icon") is not None and _ICON not in contents.names:
        yield "terminal-icon", f"it declares an icon, but {_ICON} is missing."
