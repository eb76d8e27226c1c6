"""Sources in an FMU: all listed and included files exist."""

import pytest
from containing import Containing
from fmu_files import changed, said
from lxml import etree

from fmu_src.check import sources


@pytest.fixture
def of(source_fmu, tmp_path):
    """Findings for an FMU with other source files; `listed` are those to be compiled."""

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
        return said(changed(source_fmu, tmp_path / "F.fmu", change, new), ("source", "binary-none"))

    return check_sources


def test_a_missing_listed_file_is_reported(source_fmu, tmp_path):
    path = changed(
        source_fmu,
        tmp_path / "F.fmu",
        lambda xml: xml.find("CoSimulation/SourceFiles/File").set("name", "b/none.c"),
    )
    assert said(path, ("source", "binary-none")) == [Containing("1 source file", "'b/none.c'")]


def test_paths_of_listed_files_are_normalised(of):
    """OpenModelica lists './util/list.c'."""
    files = {"m.c": b"", "util/list.c": b'#include "none.h"\n'}
    assert of(files, ["m.c", "./util/list.c"]) == [
        Containing("sources/util/list.c: includes 'none.h', which")
    ]


def test_headers_of_files_that_nothing_lists_may_be_anywhere(of):
    """As in FMUs of PythonFMU, which ship the code of their library."""
    files = {
        "src/lib/a.cpp": b'#include "lib/a.hpp"\n#include "fmi/fmi3Functions.h"\n',
        "src/lib/a.hpp": b'#include "none.hpp"\n',
    }
    missing = Containing("sources/src/lib/a.hpp: includes 'none.hpp'")
    assert missing in of(files)
    assert not any("a.cpp" in text for text in of(files))


def test_an_fmu_needs_binaries_or_sources(of):
    assert of({}) == [Containing("source files are both missing")]


def test_a_missing_include_is_reported(of):
    code = b'#include <stdio.h>\n  #  include "sub/own.h" /* "x" */\n#include "none.h"\n'
    found = of({"m.c": code, "sub/own.h": b'#include "other.h"\n', "sub/other.h": b""}, ["m.c"])
    assert found == [Containing("sources/m.c: includes 'none.h', which")]


def test_missing_includes_are_reported_in_the_order_of_their_files(of):
    files = {f"{name}.c": f'#include "{name}.h"\n'.encode() for name in "bca"}
    assert of(files, list(files)) == [
        Containing(f"sources/{name}.c: includes '{name}.h'") for name in "abc"
    ]


def test_includes_are_followed(of):
    files = {
        "m.c": b'#include "a/a.h"\n',
        "a/a.h": b'#include "../b.h"\n#include "m.c"\n',
        "b.h": b'#include "missing.h"\n',
        "unused.c": b'#include "unused_missing.h"\n',
    }
    assert of(files, ["m.c"]) == [Containing("sources/b.h: includes 'missing.h', which")]


def test_includes_are_relative_to_the_including_file(of):
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
def test_optional_includes_may_be_missing(line, of):
    assert of({"m.c": line + b"\n"}, ["m.c"]) == []


def test_comment_marks_in_strings_are_ignored(of):
    assert of({"m.c": b'char s[] = "/*";\n#include "x.h"\nchar t[] = "*/";\n'}, ["m.c"]) == [
        Containing("sources/m.c: includes 'x.h', which")
    ]


@pytest.mark.parametrize("piece", [b"/*", b'"', b'\\"', b'"\\'])
def test_malicious_sources_are_checked_quickly(piece, of):
    assert of({"m.c": piece * 100_000}, ["m.c"]) == []


def test_all_sources_are_checked_without_a_list(table1_fmu, tmp_path):
    def change(xml):
        for element in xml.root.findall(".//SourceFiles"):
            element.getparent().remove(element)

    files = {"sources/extra.c": b'#include "none.h"\n'}
    path = changed(table1_fmu, tmp_path / "F.fmu", change, files)
    assert said(path, ("source", "binary-none")) == [
        Containing("sources/extra.c: includes 'none.h', which")
    ]


def test_huge_sources_are_not_read(of, monkeypatch):
    monkeypatch.setattr(sources, "MAX_SOURCE_BYTES", 10)
    assert of({"m.c": b'#include "none.h"\n'}, ["m.c"]) == []
