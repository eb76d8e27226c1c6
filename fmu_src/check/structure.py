"""Rules on ModelStructure, and on terminalsAndIcons.xml of FMI 2.0 and 3.0."""

from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from lxml import etree

from fmu_src.check.archive import Contents
from fmu_src.check.description import STRUCTURE, ParsedDescription, Unknown, name_of, names_of
from fmu_src.check.general import repeated
from fmu_src.check.rules import Problem
from hesr_model.support.text import listed, quoted

TERMINALS = "terminalsAndIcons/terminalsAndIcons.xml"
_ICON = "terminalsAndIcons/icon.png"


def terminal_problems(
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


def _derivatives(about: ParsedDescription) -> Iterator[Problem]:
    if all(kind.element != "ModelExchange" for kind in about.kinds):
        return
    place, found = about.lists["Derivatives"], {u.index for u in about.structure["Derivatives"]}
    declared = [v for v in about.variables if "derivative" in v.own]
    wrong = {
        ("structure-states", "lacks"): [
            v for v in declared if v.variability == "continuous" and v.index not in found
        ],
        ("structure-derivatives", "lists"): [
            v for v in declared if v.variability != "continuous" and v.index in found
        ],
    }
    for (rule, verb), variables in wrong.items():
        if variables:
            yield (
                rule,
                f"{place} {verb} {listed(v.name for v in variables)}; it must list every "
                "derivative of a state and no other variable.",
            )


def _order(about: ParsedDescription) -> Iterator[Problem]:
    place = "InitialUnknowns"
    found = [v for u in about.structure[place] if (v := about.variable(u.index))]
    for before, after in pairwise(found if about.fmi == 2 else ()):
        if after.index < before.index:
            yield (
                "structure-order",
                f"{about.lists[place]} lists {quoted(after.name)} after {quoted(before.name)}; it "
                "must follow the order of the variables.",
            )


def _indices(about: ParsedDescription) -> Iterator[Problem]:
    for name in STRUCTURE:
        for index, times in Counter(u.index for u in about.structure[name]).items():
            if (variable := about.variable(index)) is None:
                text = f"{about.lists[name]} lists {about.shown(index)}, which does not exist."
                yield "structure-index", text
            elif times > 1:
                text = f"{about.lists[name]} lists {quoted(variable.name)} {times} times."
                yield "structure-index", text


def _dependencies(about: ParsedDescription) -> Iterator[Problem]:
    inputs = any(v.causality == "input" and v.kind != "Clock" for v in about.variables)
    for name in STRUCTURE:
        unknowns = about.structure[name]
        if silent := [_named(about, u) for u in unknowns if u.dependencies is None and inputs]:
            yield (
                "structure-loops",
                f"{about.lists[name]} gives no dependencies for {listed(silent)}, "
                "so importers assume all inputs and find false algebraic loops.",
            )
        for unknown in unknowns:
            who = f"{about.lists[name]} gives {quoted(_named(about, unknown))}"
            known = unknown.dependencies or ()
            if missing := [i for i in known if about.variable(i) is None]:
                text = f"{who} a dependency on {about.shown(missing[0])}, which does not exist."
                yield "structure-dependency", text
            elif about.fmi == 2 and any(a >= b for a, b in pairwise(known)):
                yield "structure-order", f"{who} dependencies that are not in ascending order."


def _named(about: ParsedDescription, unknown: Unknown) -> str:
    variable = about.variable(unknown.index)
    return variable.name if variable else about.shown(unknown.index)


RULES = (_derivatives, _order, _indices, _dependencies)
