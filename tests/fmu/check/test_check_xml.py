"""Hostile, malformed and foreign XML, and the schema."""

import sys

import pytest
from containing import Containing
from fmu_files import MODEL, RULES, changed, said, texts

from fmu_src.check import archive
from fmu_src.check.run import check

PROLOG = b'<?xml version="1.0" encoding="UTF-8"?>\n'
DOCTYPE = Containing("modelDescription.xml: it has a DOCTYPE")
NO_MODEL = (Containing("All other checks: modelDescription.xml"),)


@pytest.fixture
def of_xml(source_fmu, tmp_path):
    def check_xml(data):
        return check(changed(source_fmu, tmp_path / "F.fmu", files={MODEL: data}))

    return check_xml


def bomb():
    entities = "".join(
        f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "ha" * 100}">' for i in range(12)
    )
    return PROLOG + f"<!DOCTYPE x [{entities}]><x>&e11;</x>".encode()


@pytest.mark.parametrize(
    "data",
    [
        bomb(),
        PROLOG + b'<!DOCTYPE x [<!ENTITY f SYSTEM "file:///etc/passwd">]><x>&f;</x>',
        PROLOG + b'<!DOCTYPE x SYSTEM "http://localhost:9/x.dtd"><x/>',
        PROLOG + b"<!DOCTYPE x><x/>",
        PROLOG + b'<!DOCTYPE x [<!ENTITY % p SYSTEM "file:///etc/passwd"> %p;]><x/>',
    ],
    ids=["bomb", "external entity", "external DTD", "empty", "parameter entity"],
)
def test_a_doctype_is_refused(data, of_xml):
    found = of_xml(data)
    assert texts(found) == [DOCTYPE]
    assert found.skipped == NO_MODEL


def test_an_undeclared_entity_is_reported(of_xml):
    assert texts(of_xml(PROLOG + b"<x>&e;</x>")) == [
        Containing("undefined entity in line 2, column 4")
    ]


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "no element found in line 1, column 1"),
        (PROLOG + b"<a><b></a>", "mismatched tag in line 2, column 9"),
        (b"hello", "syntax error in line 1, column 1"),
        (PROLOG + b"<a/>\1", "not well-formed (invalid token) in line 2, column 5"),
        (PROLOG + b"<a x='1' x='2'/>", "duplicate attribute in line 2, column 10"),
    ],
)
def test_malformed_xml_is_reported(data, why, of_xml):
    assert texts(of_xml(data)) == [f"modelDescription.xml: it is not well-formed XML ({why})."]


def test_other_encodings_are_reported(source_fmu, of_xml):
    text = "<?xml version='1.0' encoding='{}'?><fmiModelDescription fmiVersion='2.0' x='ä'/>"

    def no_utf8(byte: int) -> Containing:
        return Containing("UTF-8", f"(byte {byte})")

    latin = text.format("ISO-8859-2").encode("latin-1")
    assert texts(of_xml(latin)) == [no_utf8(latin.index(b"\xe4") + 1)]
    assert texts(of_xml(text.format("UTF-16").encode("utf-16"))) == [no_utf8(1)]
    assert texts(of_xml(text.format("cp037").encode("cp037"))) == [no_utf8(3)]
    ascii_only = text.format("UTF-16").replace("ä", "").encode("utf-16-le")
    assert texts(of_xml(ascii_only)) == [no_utf8(2)]


def test_a_missing_declaration_of_the_encoding_is_advice(of_xml):
    for declaration in (b"<?xml version='1.0'?>", b""):
        report = of_xml(declaration + b"<fmiModelDescription fmiVersion='2.0'/>")
        (found,) = (p for p in report.problems if p.check.startswith("xml"))
        assert (found.check, found.severity) == ("xml-undeclared", "advice")
        assert "first line declares no encoding" in found.found


@pytest.mark.parametrize(
    ("declaration", "declares"),
    [
        (b"<?xml version='1.0' encoding='ISO-8859-1'?>", "'ISO-8859-1'"),
        (b"<?xml version='1.0' encoding='utf-7'?>", "'utf-7'"),
    ],
)
def test_another_declaration_of_the_encoding_is_reported(declaration, declares, source_fmu, of_xml):
    data = declaration + b"<fmiModelDescription fmiVersion='2.0'/>"
    assert texts(of_xml(data), "xml") == [Containing(f"first line declares {declares}; FMI needs")]


def test_a_byte_order_mark_is_harmless(source_fmu, tmp_path, xml):
    path = changed(source_fmu, tmp_path / "F.fmu", files={MODEL: b"\xef\xbb\xbf" + xml.bytes()})
    assert said(path, "xml") == []


def test_xml_that_exhausts_memory_is_refused(of_xml, monkeypatch):
    monkeypatch.setattr(archive, "MAX_XML_NODES", 10)
    assert texts(of_xml(PROLOG + b"<a b='1'>" + b"<a/>" * 9 + b"</a>")) == [
        Containing("more than 10 elements and attributes")
    ]
    monkeypatch.setattr(archive, "MAX_XML_BYTES", 20)
    assert texts(of_xml(PROLOG + b"<a/>")) == [Containing("more than 20 bytes")]


def test_deeply_nested_xml_is_refused(of_xml):
    (text,) = texts(of_xml(PROLOG + b"<a>" * 5000 + b"</a>" * 5000))
    assert text.startswith("modelDescription.xml: it cannot be read as XML (Excessive depth in doc")
    assert sys.getrecursionlimit() < 5000


def test_another_root_element_is_reported(of_xml):
    assert texts(of_xml(PROLOG + b"<a:model xmlns:a='urn:x'/>")) == [
        Containing("modelDescription.xml: its root is '{urn:x}model'")
    ]


@pytest.mark.parametrize("version", ["", "2.1", "4.0"])
def test_another_version_is_reported(version, of_xml):
    data = PROLOG + f"<fmiModelDescription fmiVersion='{version}'/>".encode()
    assert texts(of_xml(data)) == [
        f"modelDescription.xml: its fmiVersion is '{version}'; expected '2.0'."
    ]


def test_violations_of_the_schema_are_reported(source_fmu, tmp_path):
    def change(xml):
        xml.variable("dq[1]").set("causality", "inpud")
        xml.root.set("generationDateAndTime", "yesterday")
        xml.find("ModelVariables").set("colour", "red")

    path = changed(source_fmu, tmp_path / "F.fmu", change)
    found = check(path)
    schema = texts(found, "xsd")
    assert len(schema) >= 3
    for part in ("'inpud'", "'yesterday'", "'colour'"):
        assert any(part in text for text in schema)
    assert all(text.startswith("modelDescription.xml, line ") for text in schema)
    others = Containing("FMPy and VDMCheck2: not run")
    assert found.skipped == (others,)


def test_the_list_of_problems_is_limited(source_fmu, tmp_path):
    def change(xml):
        for i in range(1500):
            xml.add_variable("Real", {"nominal": "0"}, name=f"x{i}")

    path = changed(source_fmu, tmp_path / "F.fmu", change)
    found = said(path, RULES)
    assert len(found) == 1000
    assert said(path, "more") == ["500 more findings are not listed."]
