"""Rules for ModelStructure: one change of Table I gives one message that names the list."""

import pytest
from containing import Containing
from lxml import etree
from rule_changes import NUMBER, sentences, unknown

LOOPS = "so importers assume"

STRUCTURE = {
    "output twice": (
        lambda xml: etree.SubElement(xml.find("ModelStructure/Outputs"), "Unknown",
                                     index=str(xml.index("tau[1]")), dependencies=""),
        "ModelStructure/Outputs lists 'tau[1]' 2 times.",
    ),
    "output that is none": (
        lambda xml: etree.SubElement(xml.find("ModelStructure/Outputs"), "Unknown",
                                     index="0", dependencies=""),
        "ModelStructure/Outputs lists variable number 0, which does not exist.",
    ),
    "derivative that is none": (
        lambda xml: etree.SubElement(xml.find("ModelStructure/Derivatives"), "Unknown",
                                     index=str(NUMBER), dependencies=""),
        f"ModelStructure/Derivatives lists variable number {NUMBER}, which does not exist.",
    ),
    "initial out of order": (
        lambda xml: xml.find("ModelStructure/InitialUnknowns").insert(
            0, xml.unknown("InitialUnknowns", "tau[2]")),
        "ModelStructure/InitialUnknowns lists 'tau[1]' after 'tau[2]'",
    ),
    "no dependencies": (
        unknown("Outputs", "tau[1]", dependencies=None),
        f"ModelStructure/Outputs gives no dependencies for 'tau[1]', {LOOPS}",
    ),
    "dependency that is none": (
        unknown("Outputs", "tau[1]", dependencies=f"1 {NUMBER}"),
        f"'tau[1]' a dependency on variable number {NUMBER}",
    ),
    "dependencies out of order": (
        unknown("InitialUnknowns", "tau[1]", dependencies="2 1"),
        "ModelStructure/InitialUnknowns gives 'tau[1]' dependencies that",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), STRUCTURE.values(), ids=STRUCTURE)
def test_each_change_gives_one_message(change, expected, xml):
    change(xml)
    expected_texts = [expected] if isinstance(expected, str) else expected
    assert sentences(xml) == [Containing(text) for text in expected_texts]


def test_long_lists_of_names_are_truncated(xml):
    for output in list(xml.find("ModelStructure/Outputs")):
        del output.attrib["dependencies"]
    names = [v.get("name") for v in xml.variables() if v.get("causality") == "output"]
    first = ", ".join(f"'{name}'" for name in names[:5])
    (text,) = sentences(xml)
    assert f"no dependencies for {first} and {len(names) - 5} more, so" in text


@pytest.mark.parametrize("exchange", [True, False])
def test_complete_derivatives_are_required_only_for_model_exchange(exchange, xml):
    for element in xml.root.findall("ModelExchange"):
        xml.drop(element)
    if exchange:
        xml.root.insert(0, etree.Element("ModelExchange", modelIdentifier="m"))
    xml.drop(xml.unknown("Derivatives", "der(h[3])"))
    xml.drop(xml.unknown("InitialUnknowns", "der(h[3])"))
    xml.drop(xml.unknown("InitialUnknowns", "h[3]"))
    wanted = "ModelStructure/Derivatives lacks 'der(h[3])'; it must list"
    assert sentences(xml) == ([Containing(wanted)] if exchange else [])


def test_derivatives_of_discrete_variables_are_not_states(xml):
    if xml.root.find("ModelExchange") is None:
        xml.root.insert(0, etree.Element("ModelExchange", modelIdentifier="m"))
    xml.variable("der(h[1])").set("variability", "discrete")
    assert "ModelStructure/Derivatives lists 'der(h[1])'; it must list" in sentences(xml)[0]
