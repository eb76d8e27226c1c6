"""Damage to files, as from bad disks, cut transfers and malice."""

import gzip
import io
import re
import struct
import zipfile

import numpy as np

_WORD = re.compile(rb"[-+.\w]+")
_HOSTILE = (
    *(b"1e300", b"-1e308", b"1e-300", b"1e999", b"nan", b"inf", b"-1", b"0", b"4294967296"),
    *(b"9" * 400, b"9" * 5000, b"0x" + b"f" * 400, b"1" + b"0" * 309 + b".0"),
    *(b"[" * 2000, b"{" * 2000, b'{"a":' * 5000, b"<a>" * 5000, b"a.b." * 3000),
    *(
        b"",
        b'"',
        b"'",
        b"\0",
        b"\\u0000",
        b"\\ud800",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\r",
        b"\n" * 9,
    ),
    *(b"&x;", b"]]>", b"<!--", b"\xf0\x9f\xa4\x96", b"../../../etc/passwd", b"/dev/zero", b"%s%n"),
)
_PLAIN = (
    *(b"0", b"-1", b"1e-300", b"1e300", b"-1e308", b"5e-324", b"1e20", b"1e9", b"7", b"2000000000"),
    *(b"9999999999999999999999", b"nan", b"inf", b"true", b"null", b'""', b"[]", b"{}", b"x" * 300),
)
"""Texts that can replace a number or name without breaking the syntax."""
_GENTLY = 0.4
"""Share of damage that keeps the syntax valid, so that later code is reached."""
_NUMBERS = (
    *(struct.pack("<I", n) for n in (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)),
    *(struct.pack("<Q", n) for n in (2**31, 2**40, 2**63 - 1, 2**64 - 1)),
    *(struct.pack("<d", x) for x in (1e300, -1e-300, float("nan"), float("inf"))),
)


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with one to four kinds of damage, or with one word replaced."""
    data = bytearray(content)
    if rng.random() < _GENTLY:
        _replace_word(data, rng)
        return bytes(data)
    for _ in range(int(rng.integers(1, 5))):
        _KINDS[rng.integers(len(_KINDS))](data, rng)
    return bytes(data)


def _span(data: bytearray, rng: np.random.Generator) -> slice:
    start = int(rng.integers(len(data) + 1))
    longest = max(1, min(len(data) // 2, 10 ** int(rng.integers(5))))
    return slice(start, start + int(rng.integers(1, longest + 1)))


def _flip(data: bytearray, rng: np.random.Generator) -> None:
    for place in rng.integers(len(data), size=rng.integers(1, 20)) if data else ():
        data[place] ^= 1 << int(rng.integers(8))


def _overwrite(data: bytearray, rng: np.random.Generator) -> None:
    place, number = int(rng.integers(len(data) + 1)), _NUMBERS[rng.integers(len(_NUMBERS))]
    data[place : place + len(number)] = number


def _overwrite_head(data: bytearray, rng: np.random.Generator) -> None:
    place, number = int(rng.integers(300)) & ~3, _NUMBERS[rng.integers(len(_NUMBERS))]
    data[place : place + len(number)] = number


def _truncate(data: bytearray, rng: np.random.Generator) -> None:
    del data[int(rng.integers(len(data) + 1)) :]


def _delete(data: bytearray, rng: np.random.Generator) -> None:
    del data[_span(data, rng)]


def _repeat(data: bytearray, rng: np.random.Generator) -> None:
    span = _span(data, rng)
    data[span.start : span.start] = data[span] * int(rng.integers(1, 4))


def _insert(data: bytearray, rng: np.random.Generator) -> None:
    place = int(rng.integers(len(data) + 1))
    data[place:place] = rng.bytes(int(rng.integers(1, 100)))


def _replace_words(data: bytearray, rng: np.random.Generator) -> None:
    words = [match.span() for match in _WORD.finditer(bytes(data))]
    for _ in range(int(rng.integers(1, 4))):
        if words:
            start, stop = words.pop(int(rng.integers(len(words))))
            data[start:stop] = _HOSTILE[rng.integers(len(_HOSTILE))]
            words = [span for span in words if span[1] <= start]


def _replace_word(data: bytearray, rng: np.random.Generator) -> None:
    words = [match.span() for match in _WORD.finditer(bytes(data))]
    if words:
        start, stop = words[rng.integers(len(words))]
        data[start:stop] = _PLAIN[rng.integers(len(_PLAIN))]


_KINDS = (
    _flip,
    _overwrite,
    _overwrite_head,
    _truncate,
    _delete,
    _repeat,
    _insert,
    _replace_words,
    _replace_words,
)


def damaged_gzip(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a damaged file of gzip, or the damaged content in a correct one."""
    if rng.random() < 1 / 2:
        return damaged(content, rng)
    return gzip.compress(damaged(gzip.decompress(content), rng), compresslevel=1)


_ODD_NAMES = (
    *("../evil", "/evil", "C:/evil", "a\\..\\..\\evil", "x" * 5000),
    *("é/\u202e", "binaries", ".", "a//b"),
)
"""Names that no file in an archive should have."""


def damaged_archive(content: bytes, rng: np.random.Generator) -> bytes:
    """Return a damaged archive, or one with a damaged file and correct checksums."""
    if rng.random() < 1 / 3:
        return damaged(content, rng)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    # Files that are parsed: mainly XML and JSON.
    texts = [name for name in members if name.endswith((".xml", ".ssd", ".ssv", ".json"))]
    victim = str(rng.choice(texts if texts and rng.random() < 3 / 4 else list(members)))
    members[victim] = damaged(members[victim], rng)
    if rng.random() < 0.1:
        members[str(rng.choice(_ODD_NAMES))] = members.pop(str(rng.choice(list(members))))
    file, packing = io.BytesIO(), (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)[rng.integers(2)]
    with zipfile.ZipFile(file, "w", packing) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return file.getvalue()
