"""FMI 1 and 3: the archive, the schema and FMPy, and a word on what is not looked at."""

import pytest
from fmu_files import MODEL, texts, write

from fmu_src.check import check

FMI_3 = b"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="Line" instantiationToken="{1}">
  <CoSimulation modelIdentifier="Line"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="y" valueReference="1" causality="output" initial="calculated"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="1"/>
    <InitialUnknown valueReference="1"/>
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


@pytest.mark.parametrize(("version", "xml"), [("1.0", FMI_1), ("3.0", FMI_3)])
def test_what_is_looked_at(version, xml, tmp_path):
    found = check(write(tmp_path / "F.fmu", {MODEL: xml}))
    assert texts(found) == []
    assert found.skipped == (
        f"Rules, sources and binaries: looked at in FMI 2.0 only, this is FMI {version}.",
        f"VDMCheck2: it is for FMI 2.0, this is FMI {version}.",
    )


@pytest.mark.parametrize("xml", [FMI_1, FMI_3])
def test_the_schema_of_the_version(xml, tmp_path):
    path = write(tmp_path / "F.fmu", {MODEL: xml.replace(b'causality="output"', b'causality="x"')})
    assert texts(check(path), "schema")


def test_fmpy_of_fmi_3(tmp_path):
    xml = FMI_3.replace(b'<InitialUnknown valueReference="1"/>', b"")
    (text,) = texts(check(write(tmp_path / "F.fmu", {MODEL: xml})), "fmpy")
    assert text.startswith("ModelStructure/InitialUnknowns does not contain the expected set of")


def test_an_archive_that_leads_out_is_told_of_any_version(tmp_path):
    path = write(tmp_path / "F.fmu", {MODEL: FMI_3, "../x": b"/home/anna/robot"})
    found = check(path)
    assert [p.check for p in found.problems] == ["archive", "paths"]
    assert found.skipped[-1] == (
        "FMPy and VDMCheck2: run once the archive, its XML and the schema are right."
    )
