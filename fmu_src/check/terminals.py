"""Rules on terminalsAndIcons.xml, which is the same in FMI 2.0 and 3.0."""

from collections import Counter
from collections.abc import Iterable, Iterator

from lxml import etree

from fmu_src.check.archive import Contents
from fmu_src.check.description import Description, name_of
from hesr_model.support.text import quoted

FILE = "terminalsAndIcons/terminalsAndIcons.xml"
_ICON = "terminalsAndIcons/icon.png"


def problems(root: etree._Element, about: Description, contents: Contents) -> Iterator[str]:
    """Yield what terminals refer to and is not there, and names that are not unique."""
    known = {name for v in about.variables for name in (v.name, *v.others)}
    yield from _repeated("terminal", [name_of(e) for e in root.findall("Terminals/Terminal")])
    for terminal in root.iter("Terminal"):
        members = terminal.findall("TerminalMemberVariable")
        who = f"terminal {quoted(name_of(terminal))}"
        named = [e.get("memberName", "") for e in members if e.get("memberName")]
        yield from _repeated(f"member of the {who},", named)
        nested = [name_of(e) for e in terminal.findall("Terminal")]
        yield from _repeated(f"nested terminal of the {who},", nested)
        for member in members:
            variable = member.get("variableName", "")
            if variable not in known:
                yield f"the {who} has the member {quoted(variable)}, which is no variable."
    if root.find("GraphicalRepresentation/Icon") is not None and _ICON not in contents.names:
        yield f"it has a place for an icon, but there is no {_ICON}."


def _repeated(what: str, names: Iterable[str]) -> Iterator[str]:
    for name, times in Counter(names).items():
        if times > 1:
            yield f"the {what} {quoted(name)} is there {times} times."
