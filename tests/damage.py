"""Damaged files made from real ones, by seeds."""

import io
import random
import zipfile
from pathlib import Path

_ODD = (
    *("../evil", "/evil", "C:/evil", "a\\..\\..\\evil", "x" * 5000),
    *("é/\u202e", "binaries", ".", "a//b"),
)
"""Names that no file should have."""


def damaged(content: bytes, seed: int) -> bytes:
    """Return a file with bytes changed, lost, doubled, moved, or put there by chance."""
    chance = random.Random(seed)
    data = bytearray(content)
    for _ in range(chance.choice((1, 1, 2, 5, 30))):
        first, last = sorted(chance.randrange(len(data) + 1) for _ in range(2))
        short = min(last, first + chance.choice((1, 2, 4, 8, 300)))
        match chance.randrange(7):
            case 0:
                data[first:short] = chance.randbytes(short - first)
            case 1:
                del data[first:short]
            case 2:
                data[first:first] = data[first:short]
            case 3:
                data[first:short] = bytes([chance.choice((0, 255, 127, 10, 60))]) * (short - first)
            case 4:
                del data[last:]
            case 5:
                data[first:short] = data[first:short][::-1]
            case _:
                place = chance.randrange(max(1, len(data)))
                data[place : place + 1] = bytes([chance.randrange(256)])
        if not data:
            return b""
    return bytes(data)


def damaged_archive(path: Path, seed: int) -> bytes:
    """Return an archive that is damaged itself, or holds a file that is, all sums being right."""
    chance = random.Random(seed)
    if chance.randrange(3) == 0:
        return damaged(path.read_bytes(), seed)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    # What is read of it: XML and JSON above all.
    texts = [name for name in members if name.endswith((".xml", ".ssd", ".ssv", ".json"))]
    victim = chance.choice(texts) if chance.randrange(4) else chance.choice(list(members))
    members[victim] = damaged(members[victim], seed)
    if chance.randrange(10) == 0:
        members[chance.choice(_ODD)] = members.pop(chance.choice(list(members)))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", chance.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as z:
        for name, content in members.items():
            z.writestr(name, content)
    return file.getvalue()
