"""FMI 1 is refused; FMI 2 in other encodings and with several derivatives; FMI 3: also rules."""

import re
import zipfile

import pytest
from containing import Containing
from fmu_files import MODEL, changed, texts, write
from lxml import etree

from fmu_src.check import description_rules, readers
from fmu_src.check.description import read_description
from fmu_src.check.run import check

NOTHING_RUNS = Containing("source files are both missing")

FMI_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Line" instantiationToken="{1}">
  <CoSimulation modelIdentifier="Line"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="y" valueReference="1" causality="output" initial="calculated"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1" dependencies=""/>
    <InitialUnknown valueReference="1" dependencies=""/>
  </ModelStructure>
</fmiModelDescription>
"""
FMI_1 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="1.0" modelName="Line" modelIdentifier="Line" guid="{1}"
    numberOfContinuousStates="0" numberOfEventIndicators="0">
  <ModelVariables>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real/></ScalarVariable>
  </ModelVariables>
</fmiModelDescription>
"""


def test_fmi_1_is_refused_in_one_sentence(tmp_path):
    found = check(write(tmp_path / "F.fmu", {MODEL: FMI_1}))
    assert [(f.check, f.severity) for f in found.problems] == [("fmi-version", "error")]
    assert found.problems[0].found == Containing("FMI 1.0 is not checked")
    assert found.skipped == ()


@pytest.mark.parametrize(
    ("encoding", "expected"),
    [("ISO-8859-1", [("xml-other-encoding", "warning")]), ("UTF-8", [])],
)
def test_fmi_2_in_another_encoding_is_a_warning(encoding, expected, source_fmu, tmp_path):
    path = changed(source_fmu, tmp_path / "F.fmu", lambda xml: xml.root.set("author", "Zoé"))
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    text = files[MODEL].decode()
    assert re.match(r"<\?xml [^>]*encoding=.UTF-8.", text)
    files[MODEL] = text.replace("UTF-8", encoding, 1).encode(encoding)
    found = check(write(path, files))
    assert [(f.check, f.severity) for f in found.problems] == expected


DERIVATIVES = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g" numberOfEventIndicators="0">
<ModelExchange modelIdentifier="m"/><ModelVariables>
<ScalarVariable name="x" valueReference="1" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="2" initial="calculated"><Real derivative="1"/>
</ScalarVariable>
<ScalarVariable name="v" valueReference="2" initial="calculated"><Real derivative="1"/>
</ScalarVariable></ModelVariables><ModelStructure>%b
<InitialUnknowns><Unknown index="2"/><Unknown index="3"/></InitialUnknowns></ModelStructure>
</fmiModelDescription>"""


@pytest.mark.parametrize("listed", [b"2", b"3", b""])
def test_one_of_two_derivatives_of_a_state_is_listed(listed, tmp_path):
    structure = b'<Derivatives><Unknown index="%b"/></Derivatives>' % listed if listed else b""
    found = check(write(tmp_path / "F.fmu", {MODEL: DERIVATIVES % structure}))
    names = [f.check for f in found.problems]
    assert names.count("structure-states") == (0 if listed else 1)


def test_fmi_3_is_checked(tmp_path):
    found = check(write(tmp_path / "F.fmu", {MODEL: FMI_3}))
    assert texts(found) == [NOTHING_RUNS]
    assert found.skipped == (Containing("FMI 2.0, this is FMI 3.0"),)


TWO_INPUTS = """<Float64 name="y" valueReference="1" causality="output" initial="calculated">
      <Dimension start="2"/><Alias name="z"/></Float64>
    <Float64 name="u" valueReference="2" causality="input" start="0.5 0.5"><Dimension start="2"/>
    </Float64>
    <Int32 name="k" valueReference="3" causality="parameter" variability="fixed" start="1" min="1"
      max="3"/>
    <Float64 name="x" valueReference="4" initial="calculated"><Dimension start="2"/></Float64>
    <Float64 name="rate" valueReference="5" derivative="4"><Dimension start="2"/></Float64>"""
OUTPUT = '<Output valueReference="1" dependencies=""/>'
FULL = re.sub(rb'<Float64 name="y".*?/>', TWO_INPUTS.encode(), FMI_3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('start="0.5 0.5"', 'start="0.5"', ""),
        ('start="0.5 0.5"', 'start="1 2 3"', "variable 'u' has 3 start values for 2 elements"),
        ('start="0.5 0.5"', 'start="1 9" max="8"', "'u' has the start value 9, outside"),
        ('start="1" min', 'start="4" min', "'k' has the start value 4, outside its"),
        ('derivative="4"', 'derivative="1"', ""),
        (
            'derivative="4"',
            'derivative="3"',
            "type Float32 or Float64 and of",
        ),
        (
            OUTPUT,
            OUTPUT.replace('""', '"7"'),
            "'y' a dependency on value reference 7",
        ),
        (
            'instantiationToken="{1}"',
            'instantiationToken=" "',
            "the attribute instantiationToken is empty",
        ),
    ],
)
def test_rules_of_fmi_3_are_checked(old, new, said):
    assert old.encode() in FULL
    about = read_description(etree.fromstring(FULL.replace(old.encode(), new.encode())))
    rules = (*description_rules.RULES, *description_rules.RULES_3)
    found = [text for rule in rules for _, text in rule(about)]
    assert any(said in text for text in found) if said else found == []


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('start="0.5 0.5"', "", 'Variable "u" (line 8) has no start value.'),
        ('valueReference="3"', 'valueReference="2"', ' has the same value reference as variable "'),
        ('Alias name="z"', 'Alias name="u"', 'The variable name "u" (line 6) is not unique.'),
        ('derivative="4"', 'derivative="9"', "references value reference 9 which does not exist."),
        (OUTPUT, "", "ModelStructure/Outputs must have exactly one entry for each variable with"),
        (
            'variability="fixed" start="1"',
            'variability="continuous" start="1"',
            'an illegal combination of causality="parameter" and variability="continuous".',
        ),
    ],
)
def test_findings_of_fmpy_in_fmi_3_need_no_rule(old, new, said, tmp_path):
    assert old.encode() in FULL
    members = {MODEL: FULL.replace(old.encode(), new.encode())}
    found, failed = readers.validate(str(write(tmp_path / "F.fmu", members)))
    assert any(said in text for text in found), (found, failed)


BUILD = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="Line">
    <SourceFileSet language="C99">
      <SourceFile name="all.c"/><SourceFile name="none.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


def test_sources_and_binaries_of_fmi_3_are_checked(tmp_path):
    members = {
        MODEL: FMI_3, "sources/buildDescription.xml": BUILD,
        "sources/all.c": b'#include "fmi3Functions.h"\n#include "mine.h"\n',
        "binaries/x86_64-linux/Line.so": b"no library", "binaries/linux64/Line.so": b"none either",
    }  # fmt: skip
    found = check(write(tmp_path / "F.fmu", members))
    assert texts(found, ("source", "binary-none")) == [
        Containing("1 source file", "'none.c'"),
        Containing("sources/all.c: includes 'mine.h', which"),
    ]
    assert texts(found, "binary") == [Containing("folder is ELF for X86_64")]
    assert "binaries/linux64: not checked; the platform is unknown." in (found.skipped)


def test_the_schema_of_the_version_is_used(tmp_path):
    xml = FMI_3.replace(b'causality="output"', b'causality="x"')
    path = write(tmp_path / "F.fmu", {MODEL: xml})
    assert texts(check(path), "xsd")


def test_fmpy_checks_fmi_3(tmp_path):
    xml = FMI_3.replace(b'<InitialUnknown valueReference="1" dependencies=""/>', b"")
    (text,) = texts(check(write(tmp_path / "F.fmu", {MODEL: xml})), "fmpy")
    assert text.startswith("ModelStructure/InitialUnknowns does not contain the expected set of")


def test_names_outside_the_archive_are_reported_for_any_version(tmp_path):
    path = write(tmp_path / "F.fmu", {MODEL: FMI_3, "../x": b"/home/anna/robot"})
    found = check(path)
    assert [p.check for p in found.problems] == ["archive-entry", "binary-none", "machine-path"]
    assert "FMPy and VDMCheck2: not run" in found.skipped[-1]


CONNECTED = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiTerminalsAndIcons fmiVersion="3.0">
  <GraphicalRepresentation><Icon x1="0" y1="0" x2="1" y2="1"/></GraphicalRepresentation>
  <Terminals>
    <Terminal name="a" matchingRule="plug">
      <TerminalMemberVariable variableName="y" memberName="m" variableKind="signal"/>
      <TerminalMemberVariable variableName="none" memberName="m" variableKind="signal"/>
    </Terminal>
    <Terminal name="a" matchingRule="plug"/>
  </Terminals>
</fmiTerminalsAndIcons>
"""


def test_terminals_are_checked(tmp_path):
    file = "terminalsAndIcons/terminalsAndIcons.xml"
    found = check(write(tmp_path / "F.fmu", {MODEL: FMI_3, file: CONNECTED}))
    assert texts(found, "terminal") == [
        "the terminal 'a' is there 2 times.",
        "the member of the terminal 'a', 'm' is there 2 times.",
        Containing("terminal 'a' has the member 'none'"),
        Containing("declares an icon, but terminalsAndIcons/icon.png"),
    ]
    wrong = CONNECTED.replace(b' matchingRule="plug"', b"")
    found = check(write(tmp_path / "G.fmu", {MODEL: FMI_3, file: wrong}))
    assert texts(found, "xsd")[0].startswith(f"{file}, line ")
