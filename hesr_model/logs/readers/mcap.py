"""MCAP files whose recorder was stopped before it wrote their end."""

import logging
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from os import SEEK_END
from pathlib import Path
from struct import pack, unpack
from typing import BinaryIO

from hesr_model.support.files import scratch_folder

_MAGIC = b"\x89MCAP0\r\n"
# An empty section "end of data" and a footer without a summary, so that readers scan the records.
_END = pack("<BQI", 0x0F, 4, 0) + pack("<BQQQI", 0x02, 20, 0, 0, 0) + _MAGIC

_log = logging.getLogger(__name__)


@contextmanager
def complete(path: Path) -> Iterator[Path]:
    """Yield a bag, or a copy of a truncated MCAP file with its complete records."""
    if path.suffix.lower() != ".mcap" or not _truncated(path):
        yield path
        return
    with scratch_folder() as folder:
        copy = folder / path.name
        with path.open("rb") as file, copy.open("wb") as whole:
            size = path.stat().st_size
            end = _last_record(file, len(_MAGIC), size)
            file.seek(end)
            head = file.read(9 + 28 + 4 + 8)
            uncompressed = len(head) == 49 and head[:1] == b"\x06" and not any(head[37:41])
            inner = end + len(head) if uncompressed else end
            last = _last_record(file, inner, size)
            for start, stop, place in ((0, end, 0), (inner, last, end)):
                file.seek(start)
                whole.seek(place)
                shutil.copyfileobj(file, whole)
                whole.truncate(place + stop - start)
            whole.seek(0, SEEK_END)
            whole.write(_END)
        lost = size - max(end, last)
        _log.warning("%s: the recording was cut off; its last %d bytes are ignored.", path, lost)
        yield copy


def _truncated(path: Path) -> bool:
    with path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            return False
        file.seek(-len(_MAGIC), SEEK_END)
        return file.read() != _MAGIC


def _last_record(file: BinaryIO, start: int, size: int) -> int:
    """Return where the last complete record from `start` on ends."""
    end = start
    while end + 9 <= size:
        file.seek(end)
        (length,) = unpack("<xQ", file.read(9))
        if end + 9 + length > size:
            break
        end += 9 + length
    return end
