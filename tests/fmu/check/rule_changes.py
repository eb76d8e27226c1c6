"""Changes of a model description and the resulting findings of the rules of FMI 2.0."""

from typing import Any

from fmu_files import Change, Xml
from lxml import etree

from fmu_src.check import description_rules
from fmu_src.check.description import read_description

NUMBER = 99_999  # not the value reference of any variable

PARAMETER = {"causality": "parameter", "variability": "fixed"}


def sentences(xml: Xml) -> list[str]:
    about = read_description(etree.fromstring(xml.bytes()))
    rules = (*description_rules.RULES, *description_rules.RULES_2)
    return [text for rule in rules for _, text in rule(about)]


def put(element: str, **attributes: str | None) -> Change:
    """Set attributes of an element, or remove those that are None."""

    def change(xml: Xml) -> None:
        found = xml.root if element == "." else xml.find(element)
        update(found, attributes)

    return change


def update(element: Any, attributes: dict[str, str | None]) -> None:
    for name, value in attributes.items():
        if value is None:
            del element.attrib[name]
        else:
            element.set(name, value)


def var(name: str, /, **attributes: str | None) -> Change:
    return lambda xml: update(xml.variable(name), attributes)


def own(name: str, /, **attributes: str | None) -> Change:
    return lambda xml: update(xml.typed(name), attributes)


def unknown(section: str, name: str, /, **attributes: str | None) -> Change:
    return lambda xml: update(xml.unknown(section, name), attributes)


def new(kind: str, own: dict[str, str], **attributes: str) -> Change:
    return lambda xml: xml.add_variable(kind, own, **attributes)


def both(*changes: Change) -> Change:
    return lambda xml: [change(xml) for change in changes]


def of_type(kind: str, type_attributes: dict[str, str], own: dict[str, str]) -> Change:
    """Add a type and a parameter that uses it."""

    def change(xml: Xml) -> None:
        xml.add_type("T", kind, **type_attributes)
        xml.add_variable(
            kind, own | {"declaredType": "T"}, name="x", causality="parameter", variability="fixed"
        )

    return change


def enumeration(*items: tuple[str, str], start: str) -> Change:
    """Add an Enumeration of names and values and a parameter that uses it."""

    def change(xml: Xml) -> None:
        kind = xml.add_type("Choice", "Enumeration")
        for name, value in items:
            etree.SubElement(kind, "Item", name=name, value=value)
        xml.add_variable(
            "Enumeration",
            {"declaredType": "Choice", "start": start},
            name="choice",
            causality="parameter",
            variability="fixed",
        )

    return change
