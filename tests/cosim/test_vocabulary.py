"""Names in model descriptions that FMI does not have."""

import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from hostile import archived

from fmu_src.check.run import check
from fmu_src.run.vocabulary import (
    find_left_over,
    judge_description,
    read_vocabulary,
    suggest_names,
)

MODEL = "modelDescription.xml"
FMI_2 = """<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g"><CoSimulation
modelIdentifier="m"/><VendorAnnotations><Tool name="t"><Real strat="1"/></Tool></VendorAnnotations>
<ModelVariables><ScalarVariable name="p" valueReference="1" causality="parameter"
variability="fixed"><Real start="1"/></ScalarVariable></ModelVariables><ModelStructure/>
</fmiModelDescription>"""
FMI_3 = """<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="g"><CoSimulation
modelIdentifier="m"/><ModelVariables><Float64 name="p" valueReference="1" causality="parameter"
variability="fixed" start="1 2"><Dimension start="2"/></Float64></ModelVariables><ModelStructure>
<InitialUnknown valueReference="1"/></ModelStructure></fmiModelDescription>"""

MISTYPED = [
    (FMI_2, '<Real start="1"', '<Real strat="1"', "'strat' is no part of <Real>", "'start'"),
    (FMI_2, "ity=", "ty=", "'causalty' is no part of <ScalarVariable>", "'causality'"),
    (FMI_2, "ModelStructure", "ModelStrukture", "'ModelStrukture'", "'ModelStructure'"),
    (FMI_2, "<Real start", "<Reel start", "'Reel' is no part of <ScalarVariable>", "'Real'"),
    (FMI_3, "Dimension start", "Dimension strt", "'strt' is no part of <Dimension>", "'start'"),
    (FMI_3, "InitialUnknown", "InitialUnknowns", "'InitialUnknowns'", "'InitialUnknown'"),
]


@pytest.mark.parametrize(("text", "old", "new", "observation", "meant"), MISTYPED)
def test_mistyped_names_have_a_near_one(
    text: str, old: str, new: str, observation: str, meant: str
) -> None:
    assert judge_description(text.encode(), "F.fmu") == []
    findings = judge_description(text.replace(old, new).encode(), "F.fmu")
    assert len(findings) <= 3
    assert {finding.severity for finding in findings} == {"warning"}
    assert any(f"{observation}" in f.found and f"mean {meant}" in f.found for f in findings)


def test_names_that_resemble_nothing_are_left_over_without_a_warning() -> None:
    text = FMI_2.replace("<Real start", '<Real zzz="1" start')
    (item,) = find_left_over(ET.fromstring(text), "F.fmu")
    assert (item.place, item.name, item.meant) == ("<Real>", "zzz", ())
    assert judge_description(text.encode(), "F.fmu") == []


def test_names_of_other_namespaces_and_of_any_content_are_left_out() -> None:
    text = FMI_3.replace(
        "<ModelVariables>",
        "<Annotations><Annotation type='t'><Real strat='1'/></Annotation></Annotations>"
        "<ModelVariables xmlns:a='urn:a' a:strat='1'>",
    )
    assert find_left_over(ET.fromstring(text), "F.fmu") == []


@pytest.mark.parametrize(
    "data", [b"no XML", b"<other/>", b"\xff", b"<?xml version='1.0' encoding='x'?>"]
)
def test_what_is_no_description_is_reported_elsewhere(data: bytes) -> None:
    assert judge_description(data, "F.fmu") == []


@pytest.mark.parametrize(("version", "element"), [(2, "Real"), (3, "Float64")])
def test_the_schema_has_inherited_and_grouped_names(version: int, element: str) -> None:
    names = read_vocabulary(version)[element]
    assert {"start", "min", "unit", "derivative", "declaredType"} <= names
    assert ("valueReference" in names) == (version == 3)
    assert suggest_names(version, element, "strat") == "did you mean 'start'?"


def test_a_foreign_fmu_with_a_mistyped_start_value_warns(
    lag_fmu: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    import hesr

    with zipfile.ZipFile(lag_fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = re.sub(
        rb'(name="T" .*?) start=', rb"\1 strat=", members[MODEL], count=1, flags=re.DOTALL
    )
    assert text != members[MODEL]
    fmu = archived(members | {MODEL: text}, tmp_path / "Lag.fmu")
    hesr.simulate(fmu, stop=0.2, step=0.1)
    assert "Lag.fmu: 'strat' is no part of <Real>" in caplog.text
    found = [f.found for f in check(fmu).problems if f.check.startswith("xsd")]
    assert any("'strat' is not allowed. Did you mean 'start'?" in sentence for sentence in found)


def test_many_mistyped_names_take_three_lines() -> None:
    variable = re.findall(r"<ScalarVariable.*?</ScalarVariable>", FMI_2, re.DOTALL)[0]
    many = "".join(variable.replace("causality=", f"causality{k}=") for k in range(9))
    findings = judge_description(FMI_2.replace(variable, many).encode(), "F.fmu")
    assert len(findings) == 3
    assert "7 more names" in findings[-1].found
    assert "'causality2' of <ScalarVariable>" in findings[-1].found
