"""Hostile archives, made of the members of a valid one, as bytes that no library would write."""

import io
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace

Members = Mapping[str, bytes]

_LOCAL = struct.Struct("<4s5H3L2H")
_CENTRAL = struct.Struct("<4s6H3L5H2L")
_END = struct.Struct("<4s4H2LH")
_END_64 = struct.Struct("<4sQ2H2L4Q")
_LOCATOR_64 = struct.Struct("<4sLQL")
_UTF8 = 0x800
_UNIX = 3 << 8


@dataclass(frozen=True, kw_only=True)
class Entry:
    """An entry whose headers claim what they want.

    `size`, `packed_size` and `crc` are those of the headers, by default the true ones; an `offset`
    shares the data of an earlier entry.
    """

    name: bytes
    data: bytes = b""
    packed: bytes | None = None
    method: int = zipfile.ZIP_STORED
    flags: int = _UTF8
    mode: int = 0
    extra: bytes = b""
    comment: bytes = b""
    local_name: bytes | None = None
    size: int | None = None
    packed_size: int | None = None
    crc: int | None = None
    offset: int | None = None


def entry(name: str, data: bytes = b"x", **changes: object) -> Entry:
    # Attacks set fields to values of any type.
    return replace(Entry(name=name.encode(), data=data), **changes)  # type: ignore[arg-type]


@dataclass
class Archive:
    """A ZIP archive that is written entry by entry."""

    file: io.BytesIO = field(default_factory=io.BytesIO)
    directory: list[bytes] = field(default_factory=list)

    def add(self, item: Entry) -> int:
        """Add an entry; return the offset of its local header."""
        packed = item.data if item.packed is None else item.packed
        size = len(item.data) if item.size is None else item.size
        packed_size = len(packed) if item.packed_size is None else item.packed_size
        crc = zlib.crc32(item.data) if item.crc is None else item.crc
        offset = self.file.tell() if item.offset is None else item.offset
        numbers = (item.flags, item.method, 0, 33, crc, packed_size, size)
        if item.offset is None:
            name = item.name if item.local_name is None else item.local_name
            self.file.write(_LOCAL.pack(b"PK\3\4", 20, *numbers, len(name), 0) + name + packed)
        lengths = (len(item.name), len(item.extra), len(item.comment))
        head = _CENTRAL.pack(
            b"PK\1\2", _UNIX | 20, 20, *numbers, *lengths, 0, 0, item.mode << 16, offset
        )
        self.directory.append(head + item.name + item.extra + item.comment)
        return offset

    def finish(self, *, count: int | None = None, size: int | None = None) -> bytes:
        """Return the bytes; the end claims `count` entries and a directory of `size` bytes."""
        directory = b"".join(self.directory)
        begin = self.file.tell()
        count = len(self.directory) if count is None else count
        size = len(directory) if size is None else size
        end = b""
        if count > 0xFFFE or size > 0xFFFFFFFE:
            end = _END_64.pack(b"PK\6\6", 44, 45, 45, 0, 0, count, count, size, begin)
            end += _LOCATOR_64.pack(b"PK\6\7", 0, begin + len(directory), 1)
        short_count = min(count, 0xFFFF)
        short_size = min(size, 0xFFFFFFFF)
        end += _END.pack(b"PK\5\6", 0, 0, short_count, short_count, short_size, begin, 0)
        return self.file.getvalue() + directory + end


def pack(members: Members, *further: Entry) -> bytes:
    """Return an archive of members, with further entries behind them."""
    archive = Archive()
    for item in (*(entry(name, data) for name, data in members.items()), *further):
        archive.add(item)
    return archive.finish()


def with_entries(*further: Entry) -> Callable[[Members], bytes]:
    return lambda members: pack(members, *further)


def with_names(names: Iterable[str]) -> dict[str, Callable[[Members], bytes]]:
    return {f"the name {name[:30]!a}": with_entries(entry(name)) for name in names}


def change_first(members: Members, **changes: object) -> bytes:
    """Return an archive whose first entry has other headers."""
    (name, data), *others = members.items()
    archive = Archive()
    archive.add(entry(name, data, **changes))
    for other, content in others:
        archive.add(entry(other, content))
    return archive.finish()


def with_first(**changes: object) -> Callable[[Members], bytes]:
    return lambda members: change_first(members, **changes)


def deflate_zeros(count: int) -> bytes:
    """Deflate `count` MiB of zeros."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return b"".join([*(packer.compress(bytes(1 << 20)) for _ in range(count)), packer.flush()])


def bomb(*, claimed: int | None = None) -> Callable[[Members], bytes]:
    """One entry of 600 MiB of zeros; the headers claim as many bytes, or another number."""
    size = 600 << 20

    def make(members: Members) -> bytes:
        item = entry("resources/zeros", b"", packed=deflate_zeros(600), method=8)
        return pack(members, replace(item, size=size if claimed is None else claimed))

    return make


def overlap(members: Members) -> bytes:
    """Return an archive with 2,000 entries of 9 MiB that share their data, as in zip bombs."""
    archive = Archive()
    for name, data in members.items():
        archive.add(entry(name, data))
    zeros = entry("resources/0", b"", packed=deflate_zeros(9), method=8, size=9 << 20)
    zeros = replace(zeros, crc=zlib.crc32(bytes(9 << 20)))
    offset = archive.add(zeros)
    for number in range(1, 2000):
        archive.add(replace(zeros, name=f"resources/{number}".encode(), offset=offset))
    return archive.finish()


def many_entries(members: Members) -> bytes:
    """Return an archive with 30,000 empty entries."""
    return pack(members, *(entry(f"resources/{number}", b"") for number in range(30_000)))


def long_comments(members: Members) -> bytes:
    """Return an archive whose table of contents has 26 MB of comments and extra fields."""
    filler = bytes(65_000)
    items = [entry(f"resources/{k}", b"", comment=filler, extra=filler) for k in range(200)]
    return pack(members, *items)


def end_that_claims(**claims: int) -> Callable[[Members], bytes]:
    def make(members: Members) -> bytes:
        archive = Archive()
        for name, data in members.items():
            archive.add(entry(name, data))
        return archive.finish(**claims)

    return make


def nest(members: Members) -> bytes:
    """Return an archive within an archive, ten deep; the innermost one is a bomb."""
    inner = bomb()(members)
    for _ in range(10):
        inner = pack({"inner.zip": inner})
    return inner


def size_in_64_bits(members: Members) -> bytes:
    """Return an archive with an entry of 2^62 bytes."""
    numbers = struct.pack("<2H2Q", 1, 16, 1 << 62, 1)
    item = entry("resources/huge", b"x", size=0xFFFFFFFF, packed_size=0xFFFFFFFF, extra=numbers)
    return pack(members, item)


ESCAPES = (
    *("../evil", "a/../../evil", "/tmp/evil", "//host/share/evil", "..", "a/..", "../"),
    *("C:evil", "C:\\evil", "a\\..\\..\\evil", "..\\evil", "\\evil", "\\\\host\\share\\evil"),
    *("a\0/../../evil", "a\nb", "a\x1b[2J", "a\u202efmu.exe", ""),
)
"""Names that lead out of a folder on some system, or hide what they are."""

SECOND_NAMES = ("RESOURCES/A", "resources/a", "re\u017fources/a")
"""Names of the file `resources/a` where case does not count; the long s folds to s."""

KINDS = {
    "link": stat.S_IFLNK,
    "pipe": stat.S_IFIFO,
    "socket": stat.S_IFSOCK,
    "character device": stat.S_IFCHR,
    "block device": stat.S_IFBLK,
    "unknown kind": 0o170000,
}

ATTACKS: dict[str, Callable[[Members], bytes]] = {
    **with_names(ESCAPES),
    "two descriptions": lambda members: pack(
        members, *(entry(name, data) for name, data in members.items())
    ),
    "descriptions in two cases": lambda members: pack(
        members, *(entry(name.upper(), data) for name, data in members.items())
    ),
    **{
        f"second name {name!a}": with_entries(entry("resources/a"), entry(name))
        for name in SECOND_NAMES
    },
    **{
        f"a {kind}": with_entries(entry("resources/a", b"/etc/passwd", mode=mode | 0o777))
        for kind, mode in KINDS.items()
    },
    "a file as a folder": with_entries(entry("resources/a"), entry("resources/a/b")),
    "a bomb": bomb(),
    "a bomb that claims the limit": bomb(claimed=512 << 20),
    "entries that share data": overlap,
    "a bomb in archives": nest,
    "many entries": many_entries,
    "long comments": long_comments,
    "a directory too large": end_that_claims(size=1 << 50),
    "a size of 2^62": size_in_64_bits,
    "an encrypted entry": with_first(flags=_UTF8 | 0x1),
    "a masked entry": with_first(flags=_UTF8 | 0x2041),
    "too large a size": with_first(size=1 << 28),
    "bzip2": with_first(method=12),
    "lzma": with_first(method=14),
    "zstandard": with_first(method=93),
    "an unknown method": with_first(method=77),
}
"""Each is refused when it is opened, as an FMU and as an SSP."""

DAMAGE: dict[str, Callable[[Members], bytes]] = {
    "a bomb that claims less": bomb(claimed=100),
    "another local name": with_first(local_name=b"../../evil"),
    "too small a size": with_first(size=10),
    "too large a packed size": with_first(packed_size=1 << 28),
    "a wrong checksum": with_first(crc=1),
}
"""Each is refused when the damaged entry, the first or a large one, is read."""

ODD: dict[str, Callable[[Members], bytes]] = {
    "a count too large": end_that_claims(count=1 << 40),
    "a long name": with_entries(entry("r" * 60_000)),
    "a deep folder": with_entries(entry("d/" * 20_000 + "f")),
    "a name of a device": with_entries(entry("resources/CON"), entry("resources/aux.txt")),
    "a stream": with_entries(entry("resources/a:b")),
    "a trailing dot": with_entries(entry("resources/a. ")),
    "a program before the archive": lambda members: b"MZ" + bytes(4096) + pack(members),
    "set-user bits": with_entries(entry("resources/a", mode=stat.S_IFREG | 0o6777)),
    "names that are not UTF-8": with_entries(
        Entry(name=b"resources/\xff\xfe", data=b"x", flags=_UTF8)
    ),
}
"""Each may be read, or is refused."""
