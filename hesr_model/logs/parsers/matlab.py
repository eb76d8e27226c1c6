"""MATLAB files before version 7.3.

Elements are checked because SciPy may crash or unpack a bomb. Format: MathWorks, "MAT-File Format",
chapter on level 5.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import NO_NUMBERS, TextCell, compute_max_bytes, readable
from hesr_model.logs.number_arrays import find_number_arrays
from hesr_model.logs.parsers.items import build_item
from hesr_model.support.arrays import Array
from hesr_model.support.child_main import Item

Order = Literal["<", ">"]
_HEADER_SIZE = 128  # [B]
_FLAGS_TYPE = 6
_MATRIX_TYPE = 14
_COMPRESSED_TYPE = 15
_KNOWN_TYPES = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18}
_NUMBER_SIZES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # [B] per number in version 4
_CLASSES = range(1, 18)
_MAX_DEPTH = 50  # nesting of matrices in structs and cells


def require_sound(path: Path, max_bytes: int) -> None:
    """Check a file; raises ValueError, or OverflowError above `max_bytes` [B] of packed data."""
    if path.stat().st_size < _HEADER_SIZE:
        return
    content = np.memmap(path, dtype=np.uint8, mode="r").data
    if 0 in bytes(content[:4]):
        _require_version_4(content)
        return
    order: Order = "<" if bytes(content[126:128]) == b"IM" else ">"
    offset = _HEADER_SIZE
    while offset + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, offset)
        end = offset + 8 + length
        if kind != _COMPRESSED_TYPE:
            end = _require_element(content, offset, order, 0)
        else:
            packed = content[offset + 8 : end]
            unpacker = zlib.decompressobj()
            try:
                unpacked = unpacker.decompress(packed, max(max_bytes, 1))
            except zlib.error as error:
                raise ValueError("its compressed data are corrupt") from error
            if unpacker.unconsumed_tail:
                raise OverflowError
            max_bytes -= len(unpacked)
            _require_element(memoryview(unpacked), 0, order, 0)
        offset = end


def _require_version_4(content: memoryview) -> None:
    offset = 0
    while offset < len(content):
        if offset + 20 > len(content):
            raise ValueError("a matrix is truncated")
        is_little_endian = struct.unpack_from("<I", content, offset)[0] < 5000  # the byte order
        header = struct.unpack_from(f"{'<' if is_little_endian else '>'}IiiII", content, offset)
        digits, rows, columns, imaginary, name_length = header
        size = _NUMBER_SIZES.get(digits // 10 % 10)
        if size is None or rows < 0 or columns < 0 or imaginary > 1 or name_length == 0:
            raise ValueError("a matrix is malformed")
        offset += 20 + name_length + rows * columns * size * (1 + imaginary)
    if offset > len(content):
        raise ValueError("a matrix extends past the file")


def _require_element(content: memoryview, offset: int, order: Order, depth: int) -> int:
    if offset + 8 > len(content):
        raise ValueError("an element is truncated")
    kind, length = struct.unpack_from(f"{order}II", content, offset)
    if kind >> 16:  # short: length in the upper half, data in the tag
        kind, length, data_offset, next_offset = kind & 0xFFFF, kind >> 16, offset + 4, offset + 8
        if length > 4:
            raise ValueError("a short element has too many bytes")
    else:
        data_offset = offset + 8
        next_offset = data_offset + length + -length % 8
    if kind not in _KNOWN_TYPES:
        raise ValueError(f"an element is of the unknown type {kind}")
    if data_offset + length > len(content):
        raise ValueError("an element extends past its container")
    if kind == _MATRIX_TYPE and length:
        _require_matrix(content[data_offset : data_offset + length], order, depth + 1)
    return next_offset


def _require_matrix(content: memoryview, order: Order, depth: int) -> None:
    if depth > _MAX_DEPTH:
        raise ValueError("it is nested too deeply")
    if len(content) < 16 or struct.unpack_from(f"{order}II", content) != (_FLAGS_TYPE, 8):
        raise ValueError("a matrix lacks its flags")
    if struct.unpack_from(f"{order}I", content, 8)[0] & 0xFF not in _CLASSES:
        raise ValueError("a matrix has an unknown class")
    offset = 16
    while offset < len(content):
        offset = _require_element(content, offset, order, depth)


def parse(path: Path) -> Iterator[Item]:
    """Yield the arrays of numbers, named as in MATLAB; raises LogError."""
    from scipy.io import loadmat  # slow to import

    with readable(path, "a MATLAB file"):
        try:
            require_sound(path, compute_max_bytes(path))
            content = loadmat(path, simplify_cells=True)
        except OverflowError as error:
            raise LogError(
                f"{path}: claims more data than fits into the file.",
                code="log.too_large",
                where=path,
            ) from error
        columns: list[tuple[str, Array | TextCell]] = []
        for name, value in content.items():
            if not name.startswith("__"):
                columns += list(find_number_arrays(value, name)) or [(name, NO_NUMBERS)]
        yield build_item(columns)
