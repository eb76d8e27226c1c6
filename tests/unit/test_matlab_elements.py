"""Elements of MATLAB files, byte by byte: accepted for SciPy or refused."""

import struct
import zlib
from pathlib import Path

import pytest
from containing import Containing

from hesr_model.logs.parsers.matlab import require_sound

KNOWN = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18)
SIZES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}
MOST = 10_000


def element(kind: int, data: bytes = b"", order: str = "<", length: int | None = None) -> bytes:
    return struct.pack(f"{order}II", kind, len(data) if length is None else length) + data


def matrix(*inner: bytes, kind: int = 6, order: str = "<", flags: int = 6, size: int = 8) -> bytes:
    """A matrix of the given class, with elements after its flags."""
    head = struct.pack(f"{order}IIII", flags, size, kind | 0xFF00, 0)
    return element(14, head + b"".join(inner), order)


def version_4(
    kind: int = 0,
    *,
    rows: int = 2,
    columns: int = 3,
    imaginary: int = 0,
    name: bytes = b"q\0",
    digits: int = 0,
    order: str = "<",
    less: int = 0,
) -> bytes:
    """A matrix of version 4, truncated by some bytes."""
    size = SIZES.get(kind, 8) * abs(rows * columns) * (1 + imaginary)
    head = struct.pack(f"{order}IiiII", digits + 10 * kind, rows, columns, imaginary, len(name))
    return head + name + b"\1" * (size - less)


def verdict(folder: Path, content: bytes, most: int = MOST) -> str:
    """Error sentence for the content of a file."""
    path = folder / "log.mat"
    path.write_bytes(content)
    try:
        require_sound(path, most)
    except ValueError as error:
        return str(error)
    except OverflowError:
        return "too long"
    return ""


def of_5(folder: Path, *elements: bytes, order: str = "<", most: int = MOST) -> str:
    head = b"MATLAB".ljust(124) + b"\0\1" + (b"IM" if order == "<" else b"MI")
    return verdict(folder, head + b"".join(elements), most)


def of_4(folder: Path, *matrices: bytes) -> str:
    """The first matrix brings the file to the minimum length for a check."""
    return verdict(folder, version_4(rows=10, columns=2) + b"".join(matrices))


@pytest.mark.parametrize("order", ["<", ">"])
def test_known_elements_are_accepted(tmp_path: Path, order: str) -> None:
    for kind in range(22):
        data = b"" if kind == 14 else b"\0" * 8
        said = of_5(tmp_path, element(kind, data, order), order=order)
        if kind == 15:  # a packed element, but these bytes are not
            assert said == "its compressed data are corrupt"
        else:
            assert said == ("" if kind in KNOWN else Containing(f"unknown type {kind}"))


def test_matrices_are_of_known_classes_and_begin_with_flags(tmp_path: Path) -> None:
    for kind in range(20):
        said = of_5(tmp_path, matrix(kind=kind))
        assert said == ("" if 1 <= kind <= 17 else "a matrix has an unknown class")
    begin = "a matrix lacks its flags"
    assert of_5(tmp_path, matrix(flags=5)) == begin
    assert of_5(tmp_path, matrix(size=4)) == begin
    assert of_5(tmp_path, element(14, b"\0" * 15)) == begin
    assert of_5(tmp_path, element(14, struct.pack("<IIII", 6, 8, 6, 0)[:15])) == begin
    assert of_5(tmp_path, matrix(element(14), order="<")) == ""
    assert of_5(tmp_path, matrix(matrix(element(5, b"\0" * 4)))) == ""
    assert "unknown type 99" in of_5(tmp_path, matrix(element(99)))
    assert of_5(tmp_path, matrix(order=">"), order=">") == ""


def test_nesting_is_limited_to_fifty(tmp_path: Path) -> None:
    nest = matrix()
    for _ in range(49):
        nest = matrix(nest)
    assert of_5(tmp_path, nest) == ""
    assert of_5(tmp_path, matrix(nest)) == "it is nested too deeply"
    packed = [element(15, zlib.compress(each)) for each in (nest, matrix(nest))]
    assert of_5(tmp_path, packed[0]) == ""
    assert of_5(tmp_path, packed[1]) == "it is nested too deeply"


def test_elements_end_within_their_parent(tmp_path: Path) -> None:
    behind = "an element extends past its container"
    assert of_5(tmp_path, element(1, b"\0" * 8, length=8)) == ""
    assert of_5(tmp_path, element(1, b"\0" * 8, length=9)) == behind
    # Data are padded to eight bytes; a remainder too short for a tag is ignored.
    assert of_5(tmp_path, element(1, b"\0" * 3 + b"\xff" * 5, length=3), element(2)) == ""
    assert of_5(tmp_path, element(1, b"\0" * 8), element(99)).endswith("type 99")
    assert of_5(tmp_path, element(1, b"\0" * 8), element(99)[:7]) == ""
    inner = element(1, b"\0" * 8)
    assert of_5(tmp_path, matrix(inner)) == ""
    assert of_5(tmp_path, matrix(inner, inner[:12])) == behind
    assert of_5(tmp_path, matrix(inner, inner[:7])) == "an element is truncated"


def test_short_elements_hold_at_most_four_bytes(tmp_path: Path) -> None:
    for length in (1, 4, 5):
        short = struct.pack("<I", length << 16 | 1) + b"abcd"
        expected = "" if length <= 4 else Containing("short element has too many bytes")
        assert of_5(tmp_path, matrix(short)) == expected
        assert of_5(tmp_path, matrix(short, element(99))) == (
            expected or Containing("unknown type 99")
        )
        assert of_5(tmp_path, short, element(99)) == (expected or Containing("unknown type 99"))
    unknown = struct.pack("<I", 2 << 16 | 11) + b"abcd"
    assert "unknown type 11" in of_5(tmp_path, unknown)


def test_packed_data_are_limited_in_total(tmp_path: Path) -> None:
    data = element(1, b"\0" * 992)
    packed = element(15, zlib.compress(data))
    assert of_5(tmp_path, packed, most=1000) == ""
    assert of_5(tmp_path, packed, most=999) == "too long"
    assert of_5(tmp_path, packed, packed, most=2000) == ""
    assert of_5(tmp_path, packed, packed, most=1999) == "too long"
    assert of_5(tmp_path, packed, packed, most=1000) == "too long"
    assert of_5(tmp_path, packed, element(99), most=1000).endswith("type 99")
    assert of_5(tmp_path, element(15, zlib.compress(element(99)))).endswith("type 99")


def test_a_short_file_is_left_to_its_reader(tmp_path: Path) -> None:
    assert verdict(tmp_path, b"\0" * 127) == ""
    assert verdict(tmp_path, b"\0" * 128) != ""


@pytest.mark.parametrize("order", ["<", ">"])
def test_version_4_matrices_have_the_declared_length(tmp_path: Path, order: str) -> None:
    digits = 0 if order == "<" else 1000
    for kind in SIZES:
        for imaginary in (0, 1):
            one = version_4(kind, imaginary=imaginary, digits=digits, order=order)
            assert of_4(tmp_path, one) == ""
            assert of_4(tmp_path, one, one) == ""
            cut = version_4(kind, imaginary=imaginary, digits=digits, order=order, less=1)
            assert of_4(tmp_path, cut) == "a matrix extends past the file"


def test_invalid_version_4_matrices_are_refused(tmp_path: Path) -> None:
    wrong = "a matrix is malformed"
    for changes in ({"kind": 6}, {"rows": -1}, {"columns": -1}, {"imaginary": 2}, {"name": b""}):
        assert of_4(tmp_path, version_4(**changes)) == wrong, changes
    for changes in ({"rows": 0}, {"columns": 0}, {"imaginary": 1}, {"name": b"q"}):
        assert of_4(tmp_path, version_4(**changes)) == "", changes
    assert of_4(tmp_path, version_4(rows=-1, columns=-1)) == wrong
    for rest in (1, 19):
        assert of_4(tmp_path, version_4()[:rest]) == "a matrix is truncated"
    assert of_4(tmp_path, version_4(columns=0, name=b"q")[:20]) == (
        "a matrix extends past the file"
    )
