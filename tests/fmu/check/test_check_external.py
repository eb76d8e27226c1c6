"""External validators: their findings are included, and they can do no harm."""

import os
import shutil
import time
import zipfile
from pathlib import Path

import pytest
from containing import Containing
from fmpy import read_model_description
from fmpy.model_description import ValidationError
from fmu_files import MODEL, changed, texts
from lxml import etree

from fmu_src.check import external, readers
from fmu_src.check.run import check
from hesr_model.errors import ConfigError

REPOSITORY = Path(__file__).parents[3]
FOLDER = REPOSITORY / ".tools" / "vdmcheck2"

needs_vdmcheck = pytest.mark.skipif(
    shutil.which("java") is None or not (FOLDER / external.JAR).exists(),
    reason="VDMCheck2 is not there: run `.ci/vdmcheck2 .tools/vdmcheck2` first (needs Java)",
)


@pytest.fixture
def vdmcheck(tmp_path, monkeypatch):
    """A folder with a fake VDMCheck2 that prints a given text."""

    def make(script):
        folder, tools = tmp_path / "vdm", tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        tools.mkdir(exist_ok=True)
        (folder / external.JAR).write_bytes(b"")
        java = tools / "java"
        java.write_text(f"#!/bin/sh\n{script}\n")
        java.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
        return folder

    return make


@pytest.mark.ci
@needs_vdmcheck
def test_table1_passes_vdmcheck2(table1_fmu, tmp_path):
    before = sorted(FOLDER.iterdir())
    found = check(table1_fmu, vdmcheck=FOLDER)
    assert texts(found) == []
    assert found.skipped == ()
    assert list(tmp_path.iterdir()) == []  # the current folder
    assert sorted(FOLDER.iterdir()) == before


@pytest.mark.ci
@needs_vdmcheck
def test_findings_of_vdmcheck2_are_reported(source_fmu, tmp_path):
    def change(xml):
        xml.find("DefaultExperiment").set("startTime", "3")
        xml.find("DefaultExperiment").set("stopTime", "2")

    path = changed(source_fmu, tmp_path / "F.fmu", change)
    found = texts(check(path, vdmcheck=FOLDER), "vdmcheck2")
    assert found[0].startswith("modelDescription.xml, line ")
    assert found[0].endswith(": stop time must be later than start time.")
    assert not any("https://" in text for text in found)


@pytest.mark.parametrize("place", [".tools/vdmcheck2", "vdmcheck2", "."])
def test_vdmcheck2_of_the_current_folder_is_not_run(source_fmu, vdmcheck, tmp_path, place):
    (tmp_path / place).mkdir(parents=True, exist_ok=True)
    shutil.copy(vdmcheck(f"echo ran > {tmp_path}/ran") / external.JAR, tmp_path / place)
    assert check(source_fmu).skipped == (external.NO_VDMCHECK,)
    assert not (tmp_path / "ran").exists()


def test_java_of_the_current_folder_is_not_run(source_fmu, vdmcheck, tmp_path, monkeypatch):
    folder = vdmcheck(f"echo ran > {tmp_path}/ran")
    monkeypatch.chdir(tmp_path / "bin")
    monkeypatch.setenv("PATH", f".{os.pathsep}")
    assert check(source_fmu, vdmcheck=folder).skipped == ("VDMCheck2: Java is not installed.",)
    assert not (tmp_path / "ran").exists()


def test_a_folder_without_vdmcheck2_is_an_error(source_fmu, tmp_path):
    with pytest.raises(
        ConfigError, match=r"'vdmcheck' is 'none', which does not contain vdmcheck2\.jar"
    ):
        check(source_fmu, vdmcheck=Path("none"))


def test_missing_java_is_reported(source_fmu, vdmcheck, monkeypatch):
    folder = vdmcheck("")
    monkeypatch.setenv("PATH", "")
    assert check(source_fmu, vdmcheck=folder).skipped == ("VDMCheck2: Java is not installed.",)


@pytest.mark.parametrize(
    ("script", "problems", "skipped"),
    [
        ("echo 'No errors found.'", [], []),
        ("echo boom; exit 3", [], [Containing("gave no verdict but said 'boom'")]),
        ("true", [], [Containing("verdict but said 'no message'")]),
        ("echo 'Errors found.'", ["it found unnamed errors."], []),
        ("echo 'validGenerationDateAndTime: bad'; echo 'Errors found.'", [], []),
        (
            "echo 'validX: Warning: odd at modelDescription.xml:3'; echo 'No errors found.'",
            [],
            [],
        ),
        (
            "echo 'validX: bad thing at modelDescription.xml:3'; echo https://x.y/z; "
            "echo 'validY: worse'; echo 'Errors found.'; exit 1",
            ["modelDescription.xml, line 3: bad thing.", "worse."],
            [],
        ),
    ],
)
def test_output_of_vdmcheck2_is_parsed(script, problems, skipped, source_fmu, vdmcheck):
    found = check(source_fmu, vdmcheck=vdmcheck(script))
    assert texts(found) == problems
    assert list(found.skipped) == skipped


def test_a_hanging_validator_is_ended_with_its_children(
    source_fmu, vdmcheck, monkeypatch, tmp_path
):
    monkeypatch.setattr(external, "VDMCHECK_SECONDS", 1.0)
    folder = vdmcheck(f"(sleep 3; echo late > {tmp_path}/late) & sleep 600")
    start = time.monotonic()
    found = check(source_fmu, vdmcheck=folder)
    assert time.monotonic() - start < 120
    assert found.skipped == ("VDMCheck2: it gave no answer within 1 s.",)
    time.sleep(3)
    assert not (tmp_path / "late").exists()


def test_hanging_fmpy_is_reported(source_fmu, monkeypatch):
    monkeypatch.setattr(external, "FMPY_SECONDS", 0.0)
    assert Containing("FMPy gave no answer within 0 s") in check(source_fmu).skipped


def test_a_name_that_makes_fmpy_hang_is_bounded(source_fmu, tmp_path, monkeypatch):
    """The run time of its grammar explodes with the length of a name."""
    monkeypatch.setattr(external, "FMPY_SECONDS", 2.0)
    path = changed(
        source_fmu,
        tmp_path / "F.fmu",
        lambda xml: xml.variable("joint[1].alpha").set("name", "a" * 100_000 + "!"),
    )
    found = check(path)
    assert "within 2 s and was ended" in found.skipped[0]


def test_only_the_first_of_several_lines_is_reported(source_fmu, tmp_path):
    path = changed(
        source_fmu, tmp_path / "F.fmu", lambda xml: xml.variable("h[1]").set("name", "h 1")
    )
    (text,) = texts(check(path), "fmpy")
    assert text.startswith('"h 1" (line ')
    assert text.endswith("at line 1 col 2.")


GOOD = b"<?xml version='1.0' encoding='UTF-8'?><fmiTerminalsAndIcons fmiVersion='3.0'/>"
BOMB = b"<?xml version='1.0' encoding='UTF-8'?><!DOCTYPE x><x/>"


@pytest.mark.parametrize("content", [GOOD, BOMB])
def test_validators_get_only_checked_xml(content, source_fmu, vdmcheck, tmp_path):
    folder = vdmcheck(
        f"for last; do :; done; cp \"$last\" {tmp_path}/seen.fmu; echo 'No errors found.'"
    )
    terminals = "terminalsAndIcons/terminalsAndIcons.xml"
    path = changed(source_fmu, tmp_path / "F.fmu", files={terminals: content})
    found = check(path, vdmcheck=folder)
    refused = Containing(f"{terminals}: it has a DOCTYPE")
    assert texts(found) == ([refused] if content == BOMB else [])
    with zipfile.ZipFile(tmp_path / "seen.fmu") as seen, zipfile.ZipFile(path) as original:
        assert seen.namelist() == original.namelist()
        full = {name for name in seen.namelist() if seen.read(name)}
    assert full == ({MODEL} if content == BOMB else {MODEL, terminals})


ODD = ("1 a", "a b", "a[1", "a[x]", "a.", "der(a", "der(a,x)", "a..b", "ä", "a[1]b", "a\n")
PLAIN = ("a", "_b1", "a.b[1,2].c", "der(a.b[3])", "der(a,2)", "'a b'.c", "a[12]")


@pytest.mark.parametrize("convention", ["structured", "flat"])
def test_fmpy_parses_only_names_that_are_not_plainly_legal(table1_fmu, tmp_path, convention):
    with zipfile.ZipFile(table1_fmu) as archive:
        text = archive.read(MODEL)
    for names in (ODD, PLAIN):
        root = etree.fromstring(text)
        root.set("variableNamingConvention", convention)
        for name in names:
            variable = etree.SubElement(
                root.find("ModelVariables"),
                "ScalarVariable",
                name=name,
                valueReference="99999",
                causality="parameter",
                variability="fixed",
                initial="exact",
            )
            etree.SubElement(variable, "Real", start="0")
        file = tmp_path / "modelDescription.xml"
        file.write_bytes(etree.tostring(root))
        try:  # all names
            read_model_description(str(file), validate_variable_names=True)
            expected = []
        except ValidationError as error:
            expected = error.problems
        assert readers.validate(str(file)) == (expected, "")
        wrong = len(ODD) if convention == "structured" else 1
        assert len(expected) == (wrong if names is ODD else 0)
