"""Sources in an FMU: what is listed and included is there."""

import pytest
from fmu_files import changed, said
from lxml import etree

from fmu_src.check import sources


@pytest.fixture
def of(source_fmu, tmp_path):
    """What is said of an FMU with other source files; `listed` are those to be compiled."""

    def check_sources(files, listed=None):
        def change(xml):
            for old in xml.root.findall(".//SourceFiles"):
                for file in list(old):
                    old.remove(file)
                for name in listed or []:
                    etree.SubElement(old, "File", name=name)
                if not listed:
                    old.getparent().remove(old)

        new = {f"sources/{name}": data for name, data in files.items()}
        return said(changed(source_fmu, tmp_path / "F.fmu", change, new), "sources")

    return check_sources


def test_a_listed_file_is_there(source_fmu, tmp_path):
    path = changed(
        source_fmu,
        tmp_path / "F.fmu",
        lambda xml: xml.find("CoSimulation/SourceFiles/File").set("name", "b/none.c"),
    )
    assert said(path, "sources") == [
        "CoSimulation lists the source file 'b/none.c', which is not in sources/."
    ]


def test_neither_binaries_nor_sources(of):
    assert of({}) == [
        "there are neither binaries nor a list of source files, so that nothing can run."
    ]


def test_what_is_included_is_there(of):
    code = b'#include <stdio.h>\n  #  include "sub/own.h" /* "x" */\n#include "none.h"\n'
    found = of({"m.c": code, "sub/own.h": b'#include "other.h"\n', "sub/other.h": b""}, ["m.c"])
    assert found == ["sources/m.c: includes 'none.h', which is not in the archive."]


def test_includes_are_followed(of):
    files = {
        "m.c": b'#include "a/a.h"\n',
        "a/a.h": b'#include "../b.h"\n#include "m.c"\n',
        "b.h": b'#include "missing.h"\n',
        "unused.c": b'#include "unused_missing.h"\n',
    }
    assert of(files, ["m.c"]) == ["sources/b.h: includes 'missing.h', which is not in the archive."]


def test_a_folder_of_includes_beside_the_file_that_includes_them(of):
    files = {"s/m.c": b'#include "top.h"\n#include "near.h"\n', "top.h": b"", "s/near.h": b""}
    assert of(files, ["s/m.c"]) == []


@pytest.mark.parametrize(
    "line",
    [
        b'#include "fmi2Functions.h"',
        b'#include "fmi2FunctionTypes.h"',
        b'#include "fmi2TypesPlatform.h"',
        b'#include "math.h"',
        b'#include "Windows.h"',
        b'/* #include "x.h" */',
        b'/*\n#include "x.h"\n*/',
        b'// #include "x.h"',
        b'const char *s = "/*";\n/* */',
        b'const char *s = "\\"#include";',
    ],
)
def test_what_need_not_be_there(line, of):
    assert of({"m.c": line + b"\n"}, ["m.c"]) == []


def test_a_comment_mark_in_a_string_is_none(of):
    assert of({"m.c": b'char s[] = "/*";\n#include "x.h"\nchar t[] = "*/";\n'}, ["m.c"]) == [
        "sources/m.c: includes 'x.h', which is not in the archive."
    ]


@pytest.mark.parametrize("piece", [b"/*", b'"', b'\\"', b'"\\'])
def test_sources_made_to_take_forever(piece, of):
    assert of({"m.c": piece * 100_000}, ["m.c"]) == []


def test_without_a_list_all_are_looked_at(table1_fmu, tmp_path):
    def change(xml):
        for element in xml.root.findall(".//SourceFiles"):
            element.getparent().remove(element)

    files = {"sources/extra.c": b'#include "none.h"\n'}
    path = changed(table1_fmu, tmp_path / "F.fmu", change, files)
    assert said(path, "sources") == [
        "sources/extra.c: includes 'none.h', which is not in the archive."
    ]


def test_huge_sources_are_not_read(of, monkeypatch):
    monkeypatch.setattr(sources, "MOST_BYTES", 10)
    assert of({"m.c": b'#include "none.h"\n'}, ["m.c"]) == []
