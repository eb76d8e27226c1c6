"""Archives damaged by accident or on purpose: one message each, never a crash."""

import io
import stat
import struct
import zipfile
import zlib

import pytest
from containing import Containing
from fmu_files import MODEL, members, said, texts, write

from fmu_src.check import archive
from fmu_src.check.run import check
from fmu_src.run.archive import open_file
from hesr_model.errors import ArtifactError

LEADS_OUT = "leads out of the archive"
NOTHING_ELSE = (Containing("All other checks: not run"),)


@pytest.fixture
def content(source_fmu):
    return members(source_fmu)


@pytest.fixture
def entry(content, tmp_path):
    """Findings for an archive with an additional entry."""

    def add(info, data=b"x", *, method=zipfile.ZIP_DEFLATED):
        path = write(tmp_path / "F.fmu", content)
        with zipfile.ZipFile(path, "a") as open_file:
            open_file.writestr(info, data, compress_type=method)
        return said(path, "archive")

    return add


def patched(path, name, offset, new):
    """Change both headers of an entry; `offset` counts from the flags, which both have."""
    data = bytearray(path.read_bytes())
    encoded = name.encode()
    local = data.index(b"PK\3\4" + bytes(data[4:4]), 0)
    while data[local + 30 : local + 30 + len(encoded)] != encoded:
        local = data.index(b"PK\3\4", local + 4)
    central = data.index(b"PK\1\2")
    while data[central + 46 : central + 46 + len(encoded)] != encoded:
        central = data.index(b"PK\1\2", central + 4)
    for start in (local + 6, central + 8):
        data[start + offset : start + offset + len(new)] = new
    path.write_bytes(bytes(data))
    return path


def test_a_file_other_than_a_zip_is_reported(tmp_path):
    path = tmp_path / "F.fmu"
    path.write_bytes(b"not a zip at all\n" * 100)
    found = check(path)
    assert texts(found) == [Containing("(File is not a zip file)")]
    assert found.skipped == NOTHING_ELSE


def test_an_empty_file_is_reported(tmp_path):
    path = tmp_path / "F.fmu"
    path.touch()
    assert said(path) == [Containing("(File is not a zip file)")]


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.999])
def test_a_truncated_zip_is_reported(part, table1_fmu, tmp_path):
    path = tmp_path / "F.fmu"
    data = table1_fmu.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    assert said(path) == [Containing("(File is not a zip file)")]


def test_an_empty_zip_is_reported(tmp_path):
    assert said(write(tmp_path / "F.fmu", {})) == ["modelDescription.xml is missing."]


@pytest.mark.parametrize(
    "name", ["../x", "a/../../x", "/x", "C:/x", "c:x", "..", "\\\\host\\x", "a\\..\\x", "C:\\x"]
)
def test_names_outside_the_archive_are_reported(name, entry, tmp_path):
    found = entry(name)
    shown = name.replace("\\", "\\")
    assert Containing(f"the entry '{shown}' {LEADS_OUT}") in found
    backslash = Containing(f"entry '{shown}' has a backslash")
    assert (backslash in found) == ("\\" in name)
    assert not (tmp_path.parent / "x").exists()


def test_a_backslash_is_reported(entry):
    assert entry("resources\\x") == [Containing("entry 'resources\\x' has a backslash")]


def test_entries_with_backslashes_are_checked_like_others(content, tmp_path):
    """A binary with a backslash in its name is not missing."""
    named = {name.replace("/", "\\"): data for name, data in content.items()}
    found = check(write(tmp_path / "F.fmu", named)).problems
    assert {(f.check, f.severity) for f in found} == {("archive-backslash", "error")}


@pytest.mark.parametrize(
    ("name", "shown"), [("a\nb", "a\\nb"), ("a\x1b[31mb", "a\\x1b[31mb"), ("a\u202eb", "a\\u202eb")]
)
def test_control_characters_in_names_are_escaped(name, shown, entry):
    assert entry(name) == [Containing(f"entry '{shown}' has control characters")]


def test_a_name_with_a_null_byte_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content | {"resources/abc": b""})
    path.write_bytes(path.read_bytes().replace(b"resources/abc", b"resources/a\0c"))
    assert "entry 'resources/a\\x00c' has control characters" in said(path, "archive")[0]


def test_an_entry_without_a_name_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content | {"resources/abc": b""})
    path.write_bytes(path.read_bytes().replace(b"resources/abc", b"\0esources/abc"))
    assert said(path, "archive")[0] == "an entry has no name."


def test_a_long_name_is_truncated(entry):
    (text,) = entry("../" + "x" * 5000)
    assert len(text) < 300


@pytest.mark.parametrize(
    ("kind", "what"), [(stat.S_IFLNK, "a symbolic link"), (stat.S_IFIFO, "a special file")]
)
def test_entries_other_than_files_are_reported(kind, what, entry, tmp_path):
    info = zipfile.ZipInfo("resources/link")
    info.create_system = 3
    info.external_attr = (kind | 0o777) << 16
    assert entry(info, b"/etc/passwd") == [Containing(f"entry 'resources/link' is {what}; an FMU")]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_duplicate_entries_are_reported(entry):
    assert entry(MODEL) == ["the entry 'modelDescription.xml' is duplicated."]


def test_names_differing_only_in_case_are_reported(entry):
    assert entry("modeldescription.XML") == [
        Containing("entries 'modelDescription.xml' and 'modeldescription.XML'")
    ]


def test_an_entry_of_two_gigabytes_is_refused(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    patched(path, MODEL, 16, struct.pack("<I", 2 << 30))
    found = check(path)
    assert texts(found) == [
        Containing("'modelDescription.xml' claims 2147483648 bytes", "536870912")
    ]
    assert found.skipped == (Containing("All other checks: modelDescription.xml could"),)


def test_a_zip_bomb_is_refused(entry):
    found = entry("resources/zeros", bytes(20 << 20))
    assert len(found) == 1
    assert "20971520, as in a zip bomb" in found[0]
    assert found[0].startswith("the entry 'resources/zeros' claims to unpack 20")


def test_a_small_file_of_zeros_is_accepted(entry):
    assert entry("resources/zeros", bytes(2 << 20)) == []


def test_too_much_content_is_refused(content, tmp_path, monkeypatch):
    total = sum(map(len, content.values()))
    monkeypatch.setattr(archive, "MAX_TOTAL_BYTES", total - 1)
    assert said(write(tmp_path / "F.fmu", content), "archive") == [
        Containing(f"claim {total} bytes", f"more than {total - 1}", f"'{list(content)[-1]}'")
    ]


def test_too_many_entries_are_refused(content, tmp_path, monkeypatch):
    monkeypatch.setattr(archive, "MAX_ENTRIES", 3)
    found = check(write(tmp_path / "F.fmu", content))
    assert texts(found) == [Containing(f"has {len(content)} entries", "more than 3")]
    assert found.skipped == NOTHING_ELSE


def test_a_huge_table_of_contents_is_refused(content, tmp_path, monkeypatch):
    monkeypatch.setattr("fmu_src.run.archive.MAX_DIRECTORY_BYTES", 100)
    (text,) = said(write(tmp_path / "F.fmu", content))
    assert "readable ZIP archive" in text


def test_an_encrypted_entry_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    patched(path, "sources/all.c", 0, b"\1")
    assert said(path, "archive") == [Containing("entry 'sources/all.c' is encrypted")]


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_other_compression_is_reported(method, entry):
    assert entry("resources/x", b"x" * 1000, method=method) == [
        Containing(f"'resources/x' is compressed by method {method}")
    ]


def test_unknown_compression_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    patched(path, "sources/all.c", 2, struct.pack("<H", 77))
    assert said(path, "archive") == [Containing("'sources/all.c' is compressed by method 77")]


def test_a_wrong_checksum_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    patched(path, "sources/all.c", 8, struct.pack("<I", 1))
    assert said(path, "archive") == [
        "the entry 'sources/all.c' cannot be read (Bad CRC-32 for file 'sources/all.c')."
    ]


def test_damaged_compression_is_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    data = path.read_bytes()
    place = data.index(b"sources/all.c") + len("sources/all.c")
    path.write_bytes(data[:place] + b"\xff" * 20 + data[place + 20 :])
    (text,) = said(path, "archive")
    assert text.startswith("the entry 'sources/all.c' cannot be read (Error -3 while decompressing")


def test_an_entry_with_a_wrong_size_is_reported(content, tmp_path):
    """A larger size than the content has, with the right checksum."""
    path = write(tmp_path / "F.fmu", content)
    size = len(content["sources/all.c"])
    patched(path, "sources/all.c", 16, struct.pack("<I", size + 5))
    assert said(path, "archive") == [
        f"the entry 'sources/all.c' cannot be read (it claims {size + 5} bytes and has {size})."
    ]


def test_contradictory_headers_are_reported(content, tmp_path):
    path = write(tmp_path / "F.fmu", content)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"sources/all.c", b"sources/new.c", 1))
    (text,) = said(path, "archive")
    assert text.startswith("the entry 'sources/all.c' cannot be read (File name in directory")


def test_overlapping_entries_are_reported(tmp_path, monkeypatch):
    """Many entries share one compressed piece: small in the file, large on disk."""
    kernel = zlib.compressobj(9, zlib.DEFLATED, -15)
    packed = kernel.compress(bytes(9 << 20)) + kernel.flush()
    crc = zlib.crc32(bytes(9 << 20))
    monkeypatch.setattr(archive, "MAX_TOTAL_BYTES", 50 << 20)
    out = io.BytesIO()
    sizes = struct.pack("<III", crc, len(packed), 9 << 20)
    out.write(b"PK\3\4" + struct.pack("<HHHHH", 20, 0, 8, 0, 33) + sizes)
    out.write(struct.pack("<HH", 1, 0) + b"a" + packed)
    start = out.tell()
    for _ in range(300):
        out.write(b"PK\1\2" + struct.pack("<HHHHHH", 20, 20, 0, 8, 0, 33) + sizes)
        out.write(struct.pack("<HHHHHII", 1, 0, 0, 0, 0, 0, 0) + b"a")
    length = out.tell() - start
    out.write(b"PK\5\6" + struct.pack("<HHHHIIH", 0, 0, 300, 300, length, start, 0))
    path = tmp_path / "F.fmu"
    path.write_bytes(out.getvalue())
    found = said(path, "archive")
    # Newer Python versions detect it themselves.
    own = "the entry 'a' cannot be read (Overlapped entries: 'a' (possible zip bomb))."
    assert [text for text in found if text != own] == [
        "the entry 'a' is duplicated.",
        Containing(f"claim {300 * (9 << 20)} bytes", f"more than {50 << 20}", "'a'"),
    ]


def test_a_missing_model_description_is_reported(content, tmp_path):
    del content[MODEL]
    found = check(write(tmp_path / "F.fmu", content))
    assert texts(found) == ["modelDescription.xml is missing."]
    assert found.skipped == (Containing("All other checks: modelDescription.xml could"),)


def test_a_folder_around_the_whole_content_is_reported(content, tmp_path):
    inside = {f"Friction/{name}": data for name, data in content.items()}
    assert said(write(tmp_path / "F.fmu", inside)) == [
        "modelDescription.xml is missing; 'Friction/modelDescription.xml' is in the wrong folder."
    ]


def test_an_unreadable_file_is_an_error(tmp_path):
    with pytest.raises(ArtifactError, match=r"none\.fmu: no such file\."):
        check(tmp_path / "none.fmu")
    with pytest.raises(ArtifactError, match=r"is not a file\."):
        check(tmp_path)
    with pytest.raises(ArtifactError, match=r"null: is not a file\."):
        open_file((tmp_path / "../../../../../../../dev/null").resolve())
    with pytest.raises(ArtifactError, match=r"cannot be opened \(File name too long\)\."):
        check(tmp_path / ("x" * 300))
