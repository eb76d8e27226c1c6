"""Severities: deliberate violations, correct but unusual FMUs, and the page of the rules."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import fmu_cases
import pytest
from fmu_files import MODEL, Xml, changed, write
from rule_changes import PARAMETER, both, enumeration, new, own, put, unknown, var
from test_check_versions import BUILD, CONNECTED, FMI_3, FULL

import hesr
from fmu_src.check.rules import RULES, findings
from fmu_src.check.run import check

ICON = "terminalsAndIcons/terminalsAndIcons.xml"


def twice(path, tag, **attributes):
    def change(xml: Xml) -> None:
        for _ in range(2):
            xml.find(path).append(xml.find(path).makeelement(tag, attributes))

    return change


VIOLATIONS = {
    "fmi-version error": (put(".", fmiVersion="2.5"), {}),
    "xsd error": (var("dq[1]", causality="nonsense"), {}),
    "fmpy error": (own("dq[1]", start=None), {}),
    "fmpy-failed warning": (own("tau[1]", displayUnit="x", unit=None), {}),
    "kind-identifier error": (put("CoSimulation", modelIdentifier="1-2"), {}),
    "kind-tool advice": (put("CoSimulation", needsExecutionTool="true"), {}),
    "kind-state error": (put("CoSimulation", canGetAndSetFMUstate="false"), {}),
    "token-empty error": (put(".", guid=" "), {}),
    "date-format advice": (put(".", generationDateAndTime="2024-05-06T07:08:09+02:00"), {}),
    "experiment-times warning": (put("DefaultExperiment", startTime="2", stopTime="2"), {}),
    "unit-twice error": (twice("UnitDefinitions", "Unit", name="furlong"), {}),
    "variable-range error": (own("dq[1]", min="1"), {}),
    "variable-nominal error": (new("Real", {"start": "1", "nominal": "0"}, name="x", **PARAMETER),
                               {}),
    "variable-item error": (enumeration(("a", "1"), start="7"), {}),
    "variable-initial error": (var("dq[1]", initial="exact"), {}),
    "structure-dependency error": (unknown("Outputs", "tau[1]", dependencies="1 9999"), {}),
    "structure-order warning": (unknown("Outputs", "tau[1]", dependencies="2 1"), {}),
    "structure-loops advice": (unknown("Outputs", "tau[1]", dependencies=None), {}),
    "source-missing error": (
        lambda xml: xml.find("CoSimulation/SourceFiles/File").set("name", "none.c"), {}),
    "source-include warning": (put(".", author="x"), {"sources/all.c": b'#include "none.h"\n'}),
    "binary-format error": (put(".", author="x"), {"binaries/linux64/friction_parfam_h.so": b"no"}),
    "machine-path advice": (put(".", description="/home/anna/x/y"), {}),
    "archive-backslash error": (put(".", author="x"), {"documentation\\x.html": b""}),
    "terminal-member error": (put(".", author="x"), {ICON: CONNECTED}),
    "xml-encoding error": (put(".", author="x"),
                           {ICON: b"<?xml version='1.0' encoding='ascii'?><x/>"}),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize(("change", "files"), VIOLATIONS.values(), ids=VIOLATIONS)
def test_violations_have_their_severity(change, files, source_fmu, tmp_path, request):
    name, severity = request.node.callspec.id.split(" ")
    report = check(changed(source_fmu, tmp_path / "F.fmu", change, files))
    assert {f.severity for f in report.problems if f.check.partition(":")[0] == name} == {severity}


@pytest.mark.ci
@pytest.mark.parametrize(("case", "files"), fmu_cases.VIOLATIONS.items())
def test_planted_violations_are_found(case, files, tmp_path):
    name, severity, *_ = case.split(" ")
    found = check(write(tmp_path / "F.fmu", files)).problems
    assert {f.severity for f in found if f.check.partition(":")[0] == name} == {severity}


CLOCKS = FMI_3.replace(
    b"  </ModelVariables>",
    b"""
    <Clock name="tick" valueReference="2" causality="input" intervalVariability="triggered"/>
    <Clock name="tock" valueReference="3" causality="output" intervalVariability="triggered"/>
    <Int32 name="count" valueReference="4" causality="output" clocks="2"/>
    <Float64 name="sampled" valueReference="5" causality="local" variability="discrete"
      initial="calculated" clocks="2" previous="6"/>
    <Float64 name="before" valueReference="6" causality="local" variability="discrete" start="0"
      initial="exact" clocks="2"/>
  </ModelVariables>""",
).replace(
    b"    <InitialUnknown",
    b"""    <Output valueReference="3"/>
    <Output valueReference="4"/>
    <ClockedState valueReference="5"/>
    <InitialUnknown""",
)
BINARY = FMI_3.replace(
    b"  </ModelVariables>",
    b"""    <Binary name="data" valueReference="2" causality="parameter" variability="fixed">
      <Start value="00ff"/></Binary>
    <String name="text" valueReference="3" causality="parameter" variability="tunable">
      <Start value="\xc3\xa4"/></String>
    <UInt64 name="n" valueReference="4" causality="structuralParameter" variability="fixed"
      start="2"/>
    <Float64 name="v" valueReference="7" causality="parameter" variability="fixed" start="1">
      <Dimension valueReference="4"/></Float64>
  </ModelVariables>""",
)
SOURCES = {
    "sources/all.c": b"",
    "sources/buildDescription.xml": BUILD.replace(b'<SourceFile name="none.c"/>', b""),
}
SCHEDULED = FMI_3.replace(b"CoSimulation", b"ScheduledExecution")
BRANCHES = b"""#if defined(_WIN32)
#include "only_windows.h"
#else
#  ifndef NO_POSIX
#    include "only_posix.h"
#  endif
#endif
/* from /home/anna/robot/x.c */
"""
FLAT = both(put(".", variableNamingConvention="flat"), var("joint[1].alpha", name="\xe4 b (1)"))


def no_inputs(xml: Xml) -> None:
    for v in xml.variables():
        if v.get("causality") == "input":
            v.set("causality", "parameter")
            v.set("variability", "tunable")
    for element in xml.root.iter("Unknown"):
        element.attrib.pop("dependencies", None)


UNUSUAL = {
    "clocks": {MODEL: CLOCKS, **SOURCES},
    "binary, text and sizes": {MODEL: BINARY, **SOURCES},
    "aliases and arrays": {MODEL: FULL, **SOURCES},
    "scheduled execution": {MODEL: SCHEDULED, **SOURCES},
    "byte-order mark": {MODEL: b"\xef\xbb\xbf" + FMI_3, **SOURCES},
    "undeclared encoding": {MODEL: FMI_3.partition(b"\n")[2], **SOURCES},
    "other files": {MODEL: FMI_3, "extra/org.x/a b.bin": b"\0", "license.spdx": b"", **SOURCES},
    "branches": {MODEL: FMI_3, **SOURCES, "sources/all.c": BRANCHES},
    "comments": {MODEL: FMI_3 + b"<!-- /home/anna/robot/x.c -->", **SOURCES},
    "flat names": FLAT,
    "no inputs": no_inputs,
    "tool": put("CoSimulation", needsExecutionTool="true"),
    "unusual date": put(".", generationDateAndTime="2024-05-06T07:08:09.123+02:00"),
    "quoted name": var("joint[1].alpha", name="'a b'.c[1,2]"),
    "infinite limits": own("dq[1]", min="-INF", max="INF"),
    "no unit definition": lambda xml: [
        xml.drop(e) for e in xml.root.findall("UnitDefinitions/Unit/BaseUnit")],
    "no experiment": lambda xml: xml.drop(xml.find("DefaultExperiment")),
    "settable once": put("CoSimulation", canBeInstantiatedOnlyOncePerProcess="true"),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("made", UNUSUAL.values(), ids=UNUSUAL)
def test_unusual_fmus_have_no_error(made, source_fmu, tmp_path):
    path = tmp_path / "F.fmu"
    path = write(path, made) if isinstance(made, dict) else changed(source_fmu, path, made)
    found = check(path).problems
    assert [f for f in found if f.severity != "advice"] == []


@pytest.mark.ci
@pytest.mark.parametrize("case", fmu_cases.UNUSUAL)
def test_correct_fmus_have_neither_error_nor_warning(case, tmp_path):
    found = check(write(tmp_path / "F.fmu", fmu_cases.UNUSUAL[case])).problems
    assert [f for f in found if f.severity != "advice"] == []


@pytest.mark.parametrize("case", fmu_cases.UNREAD_BY_FMPY)
def test_correct_fmus_that_fmpy_cannot_read_have_a_warning(case, tmp_path):
    found = check(write(tmp_path / "F.fmu", fmu_cases.UNREAD_BY_FMPY[case])).problems
    assert [(f.check, f.severity) for f in found] == [("fmpy-failed", "warning")]


def test_the_page_lists_every_rule():
    page = Path(__file__).parents[3] / "docs" / "check.md"
    rows = re.findall(
        r"^\| `([\w-]+)` \| (\w+) \| (.*?) \| (.*?) \|$", page.read_text(), re.MULTILINE
    )
    assert rows == [(name, rule.severity, rule.finds, rule.clause) for name, rule in RULES.items()]


def test_rules_link_to_their_clause():
    """In the text of FMI 3, whose sections have names; FMI 2 is one document without any."""
    links = {rule.clause: rule.link for rule in RULES.values()}
    base = "https://fmi-standard.org/docs/3.0.1/#"
    assert links["FMI 2: 2.1.1, 2.3; FMI 3: 2.2, 2.5.1.4"] == f"{base}binaries-directory"
    assert links["FMI 2: 2.2.7; FMI 3: 2.4.7"] == f"{base}ModelVariables"
    assert links["SSP: 5 to 7"] == "https://ssp-standard.org/"
    assert all(link.startswith(base) for clause, link in links.items() if "FMI 3" in clause)


def test_findings_are_written_for_other_programs(source_fmu, tmp_path):
    bad = changed(
        source_fmu,
        tmp_path / "F.fmu",
        both(put(".", guid=" "), put("CoSimulation", needsExecutionTool="true")),
    )
    files = tmp_path / "junit.xml", tmp_path / "new" / "check.sarif"
    report = hesr.check([bad, source_fmu], junit=files[0], sarif=files[1])
    assert not report.passed
    assert list(report.files) == list(files)
    assert f"{bad}: 1 error, 1 advice." in report.summary()
    first, second = ET.parse(files[0]).getroot()
    assert [case.get("name") for case in first] == ["token-empty", "kind-tool"]
    assert (first.get("tests"), first.get("failures")) == ("2", "1")
    assert "the attribute guid is empty" in first.find("testcase/failure").get("message")
    assert (second.get("tests"), second.get("failures"), len(second)) == ("1", "0", 1)
    (run,) = json.loads(files[1].read_text())["runs"]
    results = run["results"]
    assert [(r["ruleId"], r["level"]) for r in results] == [
        ("token-empty", "error"),
        ("kind-tool", "note"),
    ]
    rules = run["tool"]["driver"]["rules"]
    assert [rules[r["ruleIndex"]]["id"] for r in results] == [r["ruleId"] for r in results]


def test_identifiers_of_validators_keep_the_severity():
    (found,) = findings([("xsd:cvc_attribute_3", "wrong.")])
    assert (found.check, found.severity) == ("xsd:cvc_attribute_3", "error")
