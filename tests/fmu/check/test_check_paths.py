"""Paths of the build machine in an FMU: detected without false positives."""

from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy.container_fmu
import pytest
from containing import Containing
from fmu_files import BINARY, changed, members, said

from fmu_src.check.archive import unpack
from fmu_src.check.run import check
from fmu_src.check.sources import find_skipped_libraries, machine_paths


@pytest.fixture
def of(source_fmu, tmp_path):
    def check_file(data, name="resources/x"):
        return said(changed(source_fmu, tmp_path / "F.fmu", files={name: data}), "machine-path")

    return check_file


@pytest.mark.parametrize(
    ("text", "path"),
    [
        (b'#include "/home/anna/robot/x.h"', "/home/anna/robot"),
        (b"\0/Users/anna/robot/x.c\0", "/Users/anna/robot"),
        (b"-g -I/home/anna/robot -O2", "/home/anna/robot"),
        (b"-fdebug-prefix-map=/tmp/tmp1x2/src=.", "/tmp/tmp1x2/src"),
        (b"/var/folders/zz/abc/T/", "/var/folders/zz/abc"),
        (b"file:/home/anna/robot", "/home/anna/robot"),
        (b"file:///builds/group/robot/", "/builds/group/robot"),
        (b"\0/root/robot/main.c\0", "/root/robot/main.c"),
        (b"/root/.cache/zig/o/", "/root/.cache"),
        (rb"C:\Users\anna\robot\x.c", r"C:\\Users\\anna\\robot"),
        (rb'"c:\\Users\\anna\\robot"', r"c:\\\\Users\\\\anna\\\\robot"),
        (b"C:/Users/anna/robot", "C:/Users/anna/robot"),
        (
            b"RSDS\1\0\0\0" rb"D:\work\robot\Release\robot.pdb",
            r"D:\\work\\robot\\Release\\robot.pdb",
        ),
    ],
)
def test_machine_paths_are_detected(text, path, of):
    path = path.replace(r"\\", "\\")
    assert of(text) == [Containing(f"resources/x: it holds '{path}', a path")]


@pytest.mark.parametrize(
    "text",
    [
        b"https://example.org/home/anna/robot",
        b"https://example.org:80/home",
        b"the folder /home/ and /tmp/x.csv",
        b"//root/joint[@name]/limit and /root/element/child",
        b"./home/anna/robot",
        b"binaries/tmp/x/y",
        b"C:\\n is a newline",
        b"a:/x",
        b"",
    ],
)
def test_other_text_is_not_a_path(text, of):
    assert of(text) == []


def test_several_are_one_problem(of):
    assert of(b"/home/anna/a /home/anna/b /home/anna/b /tmp/x/y", "documentation/index.html") == [
        Containing("documentation/index.html", "'/home/anna/a' and 2 more")
    ]


def test_binaries_and_the_description_are_searched(table1_fmu, tmp_path):
    binary = members(table1_fmu)[BINARY] + b"\0/home/anna/robot/all.c\0"
    path = changed(
        table1_fmu,
        tmp_path / "F.fmu",
        lambda xml: xml.root.set("description", "from /home/anna/robot"),
        files={BINARY: binary},
    )
    rest = "holds '/home/anna/robot', a path"
    assert said(path, "machine-path") == [
        Containing("modelDescription.xml: ", rest),
        Containing(f"{BINARY}: ", rest),
    ]


def test_third_party_binaries_are_skipped(source_fmu, tmp_path):
    text = b"/home/anna/robot/x.c"
    nested = "resources/arm/binaries/linux64/libother.so.4.0.0"  # as in a container
    names = ("binaries/linux64/libother.so.4.0.0", nested, "binaries/linux64/libother.so")
    for name, problems in zip(names, (0, 0, 1), strict=True):
        fmu = changed(source_fmu, tmp_path / "F.fmu", files={name: text, "resources/z": text})
        assert len(said(fmu, "machine-path")) == problems + 1  # that of the last file
        skipped = Containing(f"paths in {name}: a library that")
        assert (skipped in check(fmu).skipped) == (problems == 0)


def test_libraries_of_fmpy_are_skipped(source_fmu, tmp_path):
    """Only identical bytes under a library's name are skipped; a modified file is searched."""
    own = Path(fmpy.container_fmu.__file__).parent / "binaries/x86_64-linux/container_fmu.so"
    library = own.read_bytes()
    other = library[:-1] + bytes([library[-1] ^ 1])
    told = Containing("container_fmu.so of FMPy", "built elsewhere")
    for name, data, passed in (
        ("resources/x.so", library, True),
        ("resources/x.so", other, False),
        ("resources/x.bin", library, False),
    ):
        with TemporaryDirectory(dir=tmp_path) as folder:
            fmu = changed(source_fmu, tmp_path / "F.fmu", files={name: data})
            contents = unpack(fmu, Path(folder))
            assert (told in find_skipped_libraries(contents)) == passed
            assert bool(list(machine_paths(contents))) != passed
