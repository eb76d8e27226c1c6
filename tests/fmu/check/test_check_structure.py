"""Rules on ModelStructure: one change of Table I, one sentence that names the list."""

import pytest
from lxml import etree
from rule_changes import NUMBER, both, new, own, sentences, unknown, var

LOOPS = "so importers assume all inputs and find false algebraic loops."
INITIAL = (
    "outputs, states and derivatives with initial 'approx' or 'calculated', calculated "
    "parameters, and no other variable."
)

STRUCTURE = {
    "output lacks": (
        lambda xml: xml.drop(xml.unknown("Outputs", "tau[2]")),
        "ModelStructure/Outputs lacks 'tau[2]'; it must list every variable with causality "
        "'output' and no other.",
    ),
    "output too much": (
        lambda xml: etree.SubElement(xml.find("ModelStructure/Outputs"), "Unknown",
                                     index=str(xml.index("h[1]")), dependencies=""),
        "ModelStructure/Outputs lists 'h[1]'; it must list every variable with causality "
        "'output' and no other.",
    ),
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
    "initial lacks": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "tau[2]")),
        f"ModelStructure/InitialUnknowns lacks 'tau[2]'; it must list {INITIAL}",
    ),
    "initial lacks a derivative": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "der(h[2])")),
        f"ModelStructure/InitialUnknowns lacks 'der(h[2])'; it must list {INITIAL}",
    ),
    "initial lacks a state": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "h[1]")),
        f"ModelStructure/InitialUnknowns lacks 'h[1]'; it must list {INITIAL}",
    ),
    "initial lacks a calculated parameter": (
        new("Real", {}, name="p", causality="calculatedParameter", variability="fixed"),
        f"ModelStructure/InitialUnknowns lacks 'p'; it must list {INITIAL}",
    ),
    "initial has a state that is exact": (
        both(var("h[1]", initial="exact"), own("h[1]", start="0")),
        f"ModelStructure/InitialUnknowns lists 'h[1]'; it must list {INITIAL}",
    ),
    "initial out of order": (
        lambda xml: xml.find("ModelStructure/InitialUnknowns").insert(
            0, xml.unknown("InitialUnknowns", "tau[2]")),
        "ModelStructure/InitialUnknowns lists 'tau[1]' after 'tau[2]'; it must follow the order "
        "of the variables.",
    ),
    "no dependencies": (
        unknown("Outputs", "tau[1]", dependencies=None),
        f"ModelStructure/Outputs gives no dependencies for 'tau[1]', {LOOPS}",
    ),
    "dependency that is none": (
        unknown("Outputs", "tau[1]", dependencies=f"1 {NUMBER}"),
        f"ModelStructure/Outputs gives 'tau[1]' a dependency on variable number {NUMBER}, which "
        "does not exist.",
    ),
    "dependencies out of order": (
        unknown("InitialUnknowns", "tau[1]", dependencies="2 1"),
        "ModelStructure/InitialUnknowns gives 'tau[1]' dependencies that are not in ascending "
        "order.",
    ),
    "kinds": (
        unknown("Outputs", "tau[1]", dependencies="1 2", dependenciesKind="dependent"),
        "ModelStructure/Outputs gives 'tau[1]' 2 dependencies and 1 kinds of them.",
    ),
    "kinds alone": (
        unknown("Outputs", "tau[1]", dependencies=None, dependenciesKind="dependent"),
        [f"ModelStructure/Outputs gives no dependencies for 'tau[1]', {LOOPS}",
         "ModelStructure/Outputs gives 'tau[1]' dependenciesKind without dependencies."],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), STRUCTURE.values(), ids=STRUCTURE)
def test_what_is_changed_is_told_in_one_sentence(change, expected, xml):
    change(xml)
    assert sentences(xml) == ([expected] if isinstance(expected, str) else expected)


def test_many_names_are_cut_short(xml):
    for i in range(9):
        xml.add_variable("Real", {}, name=f"y{i}", causality="output", initial="exact")
        xml.typed(f"y{i}").set("start", "0")
    (text,) = sentences(xml)
    assert "lacks 'y0', 'y1', 'y2', 'y3', 'y4' and 4 more;" in text


@pytest.mark.parametrize("exchange", [True, False])
def test_derivatives_are_complete_for_model_exchange_only(exchange, xml):
    for element in xml.root.findall("ModelExchange"):
        xml.drop(element)
    if exchange:
        xml.root.insert(0, etree.Element("ModelExchange", modelIdentifier="m"))
    xml.drop(xml.unknown("Derivatives", "der(h[3])"))
    xml.drop(xml.unknown("InitialUnknowns", "der(h[3])"))
    xml.drop(xml.unknown("InitialUnknowns", "h[3]"))
    wanted = (
        "ModelStructure/Derivatives lacks 'der(h[3])'; it must list every derivative of a state "
        "and no other variable."
    )
    assert sentences(xml) == ([wanted] if exchange else [])


def test_derivatives_are_derivatives_for_co_simulation_too(xml):
    for element in xml.root.findall("ModelExchange"):
        xml.drop(element)
    del xml.typed("der(h[1])").attrib["derivative"]
    assert sentences(xml)[0] == (
        "ModelStructure/Derivatives lists 'der(h[1])', which have no attribute 'derivative'."
    )
