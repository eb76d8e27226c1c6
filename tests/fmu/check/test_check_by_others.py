"""Changes that FMPy or the schema detects, so that our rules need not repeat them."""

from types import SimpleNamespace

import pytest
from containing import Containing
from fmu_files import MODEL, Xml, changed, said, write
from lxml import etree
from rule_changes import NUMBER, PARAMETER, both, new, own, put, sentences, unknown, var

from fmu_src.check import external, readers

OUTPUTS = "ModelStructure/Outputs must have exactly one entry for each variable with causality"
INITIAL = "ModelStructure/InitialUnknowns does not contain the expected set of variables."
KINDS = "dependencies and dependenciesKind attributes"
LOOPS = Containing("ModelStructure/Outputs gives no dependencies for 'tau[1]'")

FMPY = {
    "name twice": (
        lambda xml: xml.variable("joint[1].alpha").set("name", "joint[2].alpha"),
        'The variable name "joint[2].alpha" (line ',
    ),
    "combination": (
        var("joint[1].alpha", variability="continuous"),
        'causality="parameter" and variability="continuous" in variable "joint[1].alpha" (line ',
    ),
    "initial of a parameter": (
        both(var("joint[1].alpha", initial="calculated"), own("joint[1].alpha", start=None)),
        'causality="parameter" and variability="tunable" in variable "joint[1].alpha" (line ',
    ),
    "continuous integer": (
        new("Integer", {}, name="n"),
        'is of type Integer and must have variability != "continuous".',
    ),
    "input without start": (
        own("dq[1]", start=None), 'Variable "dq[1]" (line 60) has no start value.',
    ),
    "state without start": (
        both(var("h[1]", initial="exact"),
             lambda xml: xml.drop(xml.unknown("InitialUnknowns", "h[1]"))),
        'Variable "h[1]" (line 129) has no start value.',
    ),
    "constant without start": (
        new("Real", {}, name="c", variability="constant"), 'Variable "c" (line ',
    ),
    "calculated with start": (
        own("tau[1]", start="0"),
        'The variable "tau[1]" (line 87) has initial="calculated" but provides a start value.',
    ),
    "independent with start": (
        new("Real", {"start": "0"}, name="t", causality="independent"),
        'has causality="independent" but provides a start value.',
    ),
    "name": (
        var("joint[1].alpha", name="1 alpha"),
        '"1 alpha" (line 162) is not a legal variable name for naming convention "structured".',
    ),
    "unit": (
        own("tau[1]", unit="furlong"),
        'The unit "furlong" of variable "tau[1]" (line 87) is not defined.',
    ),
    "display unit": (
        own("tau[1]", displayUnit="furlong"),
        'The display unit "furlong" of variable "tau[1]" (line 87) is not defined.',
    ),
    "type": (
        new("Real", {"start": "1", "declaredType": "T"}, name="x", **PARAMETER),
        'has declaredType="T" which has not been defined.',
    ),
    "derivative of nothing": (
        new("Real", {"derivative": str(NUMBER)}, name="x", variability="discrete"),
        f"references model variable index {NUMBER} which does not exist.",
    ),
    "output lacks": (lambda xml: xml.drop(xml.unknown("Outputs", "tau[2]")), OUTPUTS),
    "output too much": (
        lambda xml: etree.SubElement(xml.find("ModelStructure/Outputs"), "Unknown",
                                     index=str(xml.index("h[1]")), dependencies=""),
        OUTPUTS,
    ),
    "derivative without the attribute": (
        both(lambda xml: [xml.drop(e) for e in xml.root.findall("ModelExchange")],
             lambda xml: xml.typed("der(h[1])").attrib.pop("derivative")),
        'The variable "der(h[1])" (line ',
    ),
    "initial lacks": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "tau[2]")), "It lacks 'tau[2]'.",
    ),
    "initial lacks a derivative": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "der(h[2])")),
        "It lacks 'der(h[2])'.",
    ),
    "initial lacks a state": (
        lambda xml: xml.drop(xml.unknown("InitialUnknowns", "h[1]")), "It lacks 'h[1]'.",
    ),
    "initial lacks a calculated parameter": (
        new("Real", {}, name="p", causality="calculatedParameter", variability="fixed"),
        "It lacks 'p'.",
    ),
    "initial has a state that is exact": (
        both(var("h[1]", initial="exact"), own("h[1]", start="0")), "It must not list 'h[1]'.",
    ),
    "kinds": (
        unknown("Outputs", "tau[1]", dependencies="1 2", dependenciesKind="dependent"),
        f"The number of elements in the {KINDS} of the outputs (line ",
    ),
    "kinds alone": (
        unknown("Outputs", "tau[1]", dependencies=None, dependenciesKind="dependent"),
        "If dependenciesKind exists dependencies must also exist in the outputs (line ",
    ),
}  # fmt: skip


# FMPy keeps the archive open after an error.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("change", "expected"), FMPY.values(), ids=FMPY)
def test_findings_of_fmpy_need_no_rule(change, expected, xml, tmp_path):
    change(xml)
    assert sentences(xml) == ([LOOPS] if "If dependenciesKind" in expected else [])
    reader = SimpleNamespace(run=lambda _, file, _seconds: readers.validate(str(file)))
    found, skipped = external.fmpy(write(tmp_path / "F.fmu", {MODEL: xml.bytes()}), reader, 2)
    assert any(expected in text for _, text in found), found
    assert skipped == []
    if "It " in expected:
        assert any(text.startswith(INITIAL) for _, text in found)


SCHEMA = {
    "no identifier": (
        put("CoSimulation", modelIdentifier=None),
        "Element 'CoSimulation': The attribute 'modelIdentifier' is required but missing.",
    ),
    "no guid": (
        put(".", guid=None),
        "Element 'fmiModelDescription': The attribute 'guid' is required but missing.",
    ),
    "impossible date": (
        put(".", generationDateAndTime="2024-02-30T07:08:09Z"),
        "attribute 'generationDateAndTime': '2024-02-30T07:08:09Z' is not a valid value of the "
        "atomic type 'xs:dateTime'.",
    ),
}


@pytest.mark.parametrize(("change", "expected"), SCHEMA.values(), ids=SCHEMA)
def test_the_schema_detects_changes(change, expected, xml, tmp_path):
    change(xml)
    (tmp_path / "m.xml").write_bytes(xml.bytes())
    assert [text for _, _, text in readers.compare(str(tmp_path / "m.xml")) if expected in text]


def test_external_findings_are_in_the_report(source_fmu, tmp_path):
    def change(xml: Xml) -> None:
        xml.drop(xml.unknown("InitialUnknowns", "tau[2]"))
        del xml.typed("dq[1]").attrib["start"]

    initial, start = sorted(said(changed(source_fmu, tmp_path / "F.fmu", change)))
    assert initial.startswith(INITIAL)
    assert initial.endswith(" It lacks 'tau[2]'.")
    assert start == 'Variable "dq[1]" (line 60) has no start value.'
