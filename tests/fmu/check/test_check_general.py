"""Rules for everything except variables: one change of Table I gives one specific message."""

import pytest
from containing import Containing
from fmu_files import RULES, Xml, changed, said
from lxml import etree
from rule_changes import enumeration, put, sentences

GENERAL = {
    "neither kind": (
        lambda xml: [xml.drop(e) for k in ("ModelExchange", "CoSimulation")
                     for e in xml.root.findall(k)],
        "the elements ModelExchange and CoSimulation are both missing.",
    ),
    "identifier": (
        put("CoSimulation", modelIdentifier="1-2"),
        "CoSimulation has the modelIdentifier '1-2'",
    ),
    "no identifier": (
        put("CoSimulation", modelIdentifier=None),
        "CoSimulation has the modelIdentifier '', which is not a C identifier.",
    ),
    "tool": (
        put("CoSimulation", needsExecutionTool="1"),
        "CoSimulation has needsExecutionTool='true', so the FMU",
    ),
    "serialise": (
        put("CoSimulation", canGetAndSetFMUstate="false", canSerializeFMUstate="true"),
        "CoSimulation has canSerializeFMUstate='true', which requires "
        "canGetAndSetFMUstate='true'.",
    ),
    "no guid": (
        put(".", guid=None),
        "attribute guid is empty",
    ),
    "empty guid": (
        put(".", guid=" "),
        "attribute guid is empty",
    ),
    "date in another zone": (
        put(".", generationDateAndTime="2024-05-06T07:08:09+02:00"),
        "generationDateAndTime is '2024-05-06T07:08:09+02:00'; the format is "
        "YYYY-MM-DDThh:mm:ssZ.",
    ),
    "date without zeros": (
        put(".", generationDateAndTime="2024-2-3T7:8:9Z"),
        "generationDateAndTime is '2024-2-3T7:8:9Z'; the format is YYYY-MM-DDThh:mm:ssZ.",
    ),
    "stop": (
        put("DefaultExperiment", startTime="2", stopTime="2"),
        "2, not after its startTime 2",
    ),
    "long step": (
        put("DefaultExperiment", startTime="0", stopTime="1", stepSize="3"),
        "DefaultExperiment has stepSize 3, longer",
    ),
    "step": (
        put("DefaultExperiment", stepSize="0"),
        "DefaultExperiment has stepSize 0; it must be positive.",
    ),
    "tolerance": (
        put("DefaultExperiment", tolerance="-1e-3"),
        "DefaultExperiment has tolerance -0.001; it must be positive.",
    ),
    "infinite": (
        put("DefaultExperiment", startTime="0", stopTime="INF"),
        "DefaultExperiment has stopTime INF; it must be finite.",
    ),
    "unit twice": (
        lambda xml: etree.SubElement(xml.find("UnitDefinitions"), "Unit", name="N.m"),
        "the unit 'N.m' is defined 2 times.",
    ),
    "display unit twice": (
        lambda xml: [etree.SubElement(xml.find("UnitDefinitions/Unit[@name='N.m']"),
                                      "DisplayUnit", name="mN.m") for _ in range(2)],
        "the display unit of 'N.m', 'mN.m' is defined 2 times.",
    ),
    "type twice": (
        lambda xml: [xml.add_type("T", "Boolean") for _ in range(3)],
        "the type 'T' is defined 3 times.",
    ),
    "category twice": (
        lambda xml: [etree.SubElement(xml.find("LogCategories"), "Category", name="logMine")
                     for _ in range(2)],
        "the log category 'logMine' is defined 2 times.",
    ),
    "type like a variable": (
        lambda xml: xml.add_type("tau[1]", "Boolean"),
        "type 'tau[1]' has the name",
    ),
    "item twice": (
        enumeration(("a", "1"), ("a", "2"), start="1"),
        "the item of the enumeration 'Choice', 'a' is defined 2 times.",
    ),
    "value twice": (
        enumeration(("a", "2"), ("b", "2"), start="2"),
        "the enumeration 'Choice' has 2 items of the value 2.",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "expected"), GENERAL.values(), ids=GENERAL)
def test_each_change_gives_one_message(change, expected, xml):
    change(xml)
    expected_texts = [expected] if isinstance(expected, str) else expected
    assert sentences(xml) == [Containing(text) for text in expected_texts]


def test_table1_breaks_no_rule(xml):
    assert sentences(xml) == []


def test_rules_tolerate_violations_of_the_schema(table1_fmu, tmp_path):
    """Invalid numbers and missing elements are findings of the schema, not crashes."""

    def change(xml: Xml) -> None:
        xml.typed("dq[1]").set("start", "much")
        xml.variable("dq[2]").set("valueReference", "1_0")
        xml.typed("der(h[1])").set("derivative", "h[1]")
        xml.variable("dq[3]").remove(xml.typed("dq[3]"))
        del xml.variable("q[1]").attrib["name"]
        xml.unknown("Outputs", "tau[1]").set("index", "x")
        xml.unknown("Outputs", "tau[2]").set("dependencies", "1 x 2")

        xml.unknown("Outputs", "tau[3]").set("dependencies", "2 1")

    bad = changed(table1_fmu, tmp_path / "Bad.fmu", change)
    out_of_order = "ModelStructure/Outputs gives 'tau[3]' dependencies that are not in ascending"
    assert [text for text in said(bad, RULES) if text.startswith(out_of_order)]
    assert said(bad, "xsd")
