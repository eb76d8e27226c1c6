"""C compiler: one for all targets, with the same bytes on every host."""

import hashlib
import platform
import struct
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from fmu_src.export.interface import NUMBERS, extract_numbers
from hesr_model.errors import ExportError
from hesr_model.support.compiler import compile_c
from hesr_model.support.files import scratch_folder

# Contracted multiply-adds would make results differ between targets; short vectors of unlike terms
# take longer than the terms.
CFLAGS = (
    *("-std=c99", "-O2", "-ffp-contract=off", "-fno-tree-slp-vectorize", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Wpedantic", "-Werror"),
)
_LINK = ("-shared", "-g0", "-s")


@dataclass(frozen=True)
class Target:
    """Target of a binary: its folder under binaries/ and the suffix of the shared library.

    Several compiler targets (`triples`) make one universal file. In the flags `{library}` is the
    name of the library and `{compiler}` the folder of the compiler.
    """

    folder: str
    suffix: str
    triples: tuple[str, ...]
    flags: tuple[str, ...]


# glibc 2.17 is the oldest one that tools still support. FMI 2.0 has no folder for 64-bit ARM Linux;
# this one is that of FMI 3.0, as FMI 2.0.5 recommends. Unwind tables, a tenth of a binary, old hash
# tables and the slow build of the compiler's runtime library are not needed by plain C.
_ELF = (
    *("-fPIC", "-Wl,--build-id=none", "-Wl,--hash-style=gnu", "-nostdlib", "-lc", "-lm"),
    *("-fno-unwind-tables", "-fno-asynchronous-unwind-tables"),
)
# Building the compiler's own C library for Windows takes 100 s, for start-up code that plain C does
# not need. Its headers and the system's import libraries remain available.
_PRINTF = ("snprintf", "vsnprintf", "__local_stdio_printf_options")
_PE = (
    *("-nostdlib", "-Wl,--no-entry", "-D_UCRT="),
    *("-isystem", "{compiler}/lib/libc/include/any-windows-any"),
    *(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("math", "heap", "stdio", "string", "private")),
    *("-lkernel32", "-lcompiler_rt"),
    *(f"{{compiler}}/lib/libc/mingw/stdio/ucrt_{name}.c" for name in _PRINTF),
    str(files("fmu_src") / "c" / "windows.c"),
)
_MACH_O = ("-fPIC", "-Wl,-install_name,@rpath/{library}")
_MACS = ("x86_64-macos.11.0", "aarch64-macos.11.0")
TARGETS: Mapping[str, Target] = {
    target.folder: target
    for target in (
        Target("linux64", ".so", ("x86_64-linux-gnu.2.17",), _ELF),
        Target("win64", ".dll", ("x86_64-windows-gnu",), _PE),
        Target("darwin64", ".dylib", _MACS, _MACH_O),
        Target("aarch64-linux", ".so", ("aarch64-linux-gnu.2.17",), _ELF),
    )
}

_HOSTS = {
    "linux x86_64": "linux64",
    "linux aarch64": "aarch64-linux",
    "win32 AMD64": "win64",
    "darwin x86_64": "darwin64",
    "darwin arm64": "darwin64",
}


def host_platform() -> str | None:
    """Return the target of this machine, or None if we build nothing for it."""
    return _HOSTS.get(f"{sys.platform} {platform.machine()}")


HOST = (host_platform() or "linux64",)
"""Default of functions that write an FMU."""

# The systems of most importers. Windows takes 1.1 to 1.3 CPU s for each new law, and 35 KB. macOS
# would take as much again, for binaries that our tests cannot run.
DEFAULT_PLATFORMS = tuple(name for name in TARGETS if name in ("linux64", "win64", *HOST))
"""Default of the commands."""


def targets(platforms: Sequence[str]) -> tuple[Target, ...]:
    """Return the targets with these names; "all" selects every one."""
    for name in platforms:
        if name not in TARGETS and name != "all":
            raise ExportError(
                f"platform '{name}' is unknown; known are {', '.join(TARGETS)} and 'all'."
            )
    if not platforms:
        raise ExportError(f"no platform is given; known are {', '.join(TARGETS)} and 'all'.")
    return tuple(t for name, t in TARGETS.items() if name in platforms or "all" in platforms)


def build(source: Path, identifier: str, target: Target, flags: Sequence[str] = ()) -> bytes:
    """Compile one translation unit, with these flags last, to a library and return its bytes.

    Raises ExportError with the compiler's first line.
    """
    library = identifier + target.suffix
    with scratch_folder() as folder:
        parts = []
        for triple in target.triples:
            # One folder per architecture: the linker writes import libraries next to the output.
            output = folder / triple / library
            output.parent.mkdir()
            last_flags = [*(flag.replace("{library}", library) for flag in target.flags), *flags]
            parts.append(
                _compile_library(source, ("-target", triple, *CFLAGS, *_LINK), output, last_flags)
            )
    if len(parts) == 1:
        return parts[0]
    return join_universal_binary(parts)


def _compile_library(
    source: Path, flags: Sequence[str], output: Path, last_flags: Sequence[str]
) -> bytes:
    """Compile without the numbers of an interface.h, so that others compile nothing; add them."""
    header = source.with_name("interface.h")
    if not header.is_file():
        compile_c(source, flags, output, last_flags)
        return output.read_bytes()
    text = header.read_text(encoding="utf-8")
    blank, content = extract_numbers(text)
    header.write_text(blank, encoding="utf-8")
    compile_c(source, flags, output, last_flags)
    header.write_text(text, encoding="utf-8")
    binary = bytearray(output.read_bytes())
    place = binary.index(NUMBERS) + len(NUMBERS)
    binary[place : place + len(content)] = content
    _sign_again(binary)
    return bytes(binary)


_MACH_MAGIC_64 = 0xFEEDFACF
_SIGNATURE = 0x1D
_DIRECTORY = 0xFADE0C02  # load command, and its blob with hashes of pages


def _sign_again(binary: bytearray) -> None:
    """Renew the hashes in the ad-hoc signature of a 64-bit Mach-O file, if it has one."""
    magic, *_, commands = struct.unpack_from("<5I", binary)
    if magic != _MACH_MAGIC_64:
        return
    place = 32  # behind the header
    for _ in range(commands):
        command, size, offset = struct.unpack_from("<3I", binary, place)
        place += size
        if command != _SIGNATURE:
            continue
        (blobs,) = struct.unpack_from(">I", binary, offset + 8)
        for k in range(blobs):
            begin = offset + struct.unpack_from(">I", binary, offset + 16 + 8 * k)[0]
            kind, _, _, _, hashes, _, _, pages, end = struct.unpack_from(">9I", binary, begin)
            if kind != _DIRECTORY:
                continue
            step = 1 << binary[begin + 39]
            for page in range(pages):
                digest = hashlib.sha256(binary[page * step : min((page + 1) * step, end)]).digest()
                digest_start = begin + hashes + page * len(digest)
                binary[digest_start : digest_start + len(digest)] = digest


# A small module without imports, embedded in a page. Building the compiler's own C library takes 15
# s; only its headers and parts of pow() are used, the rest is in `wasm.c`.
_WASM = ("-target", "wasm32-wasi", "-nostdlib", "-Wl,--no-entry", *CFLAGS, "-Oz", "-g0", "-s")
_MUSL = "{compiler}/lib/libc/musl"
_ERRORS = (f"__math_{name}" for name in ("invalid", "oflow", "uflow", "xflow"))
_POW = tuple(f"{_MUSL}/src/math/{n}.c" for n in ("pow", "pow_data", "exp_data", *_ERRORS))
_HEADERS = "{compiler}/lib/libc/include"
_WASM_LAST = (
    *(f"-isystem{_HEADERS}/{name}" for name in ("wasm-wasi-musl", "generic-musl")),
    *(f"-isystem{_MUSL}/{name}" for name in ("src/internal", "arch/generic")),
    "-Dhidden=",
    str(files("fmu_src") / "c" / "wasm.c"),
    "-lcompiler_rt",
)


def build_wasm(source: Path, *, powers: bool) -> bytes:
    """Compile one translation unit, which may call pow(), to WebAssembly and return its bytes."""
    with scratch_folder() as folder:
        output = folder / f"{source.stem}.wasm"
        last_flags = _WASM_LAST
        if powers:
            last_flags = (*_POW, *_WASM_LAST)
        return _compile_library(source, _WASM, output, last_flags)


def get_ready() -> None:
    """Build in advance the compiler parts that the first page needs."""
    with scratch_folder() as folder:
        source = folder / "nothing.c"
        source.write_text("extern int nothing;\n", encoding="utf-8")
        build_wasm(source, powers=False)


_FAT_MAGIC = 0xCAFEBABE
_PAGE_BITS = 14  # slices start at 16 KiB pages, the larger page size of the two architectures


def join_universal_binary(parts: Sequence[bytes]) -> bytes:
    """Join 64-bit Mach-O files of different architectures into one universal file."""
    page = 1 << _PAGE_BITS
    header = struct.pack(">II", _FAT_MAGIC, len(parts))
    offset = page
    body = b""
    for part in parts:
        magic, cpu, subtype = struct.unpack_from("<III", part)
        if magic != _MACH_MAGIC_64:
            raise ValueError("not a 64-bit Mach-O file")
        header += struct.pack(">IIIII", cpu, subtype, offset, len(part), _PAGE_BITS)
        padded = part.ljust(-(-len(part) // page) * page, b"\0")
        body += padded
        offset += len(padded)
    return header.ljust(page, b"\0") + body
