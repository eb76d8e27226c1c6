"""The C compiler: one for all targets, the same bytes on every host."""

import hashlib
import os
import re
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from hesr_model.errors import ExportError
from hesr_model.support.cache import folder as cache_folder
from hesr_model.support.cache import kept
from hesr_model.support.files import scratch_folder

CFLAGS = (
    "-std=c99",
    "-O2",
    # Contracted multiply-adds would make results differ between targets.
    "-ffp-contract=off",
    "-fvisibility=hidden",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Werror",
)
_LINK = ("-shared", "-g0", "-s")


@dataclass(frozen=True, kw_only=True)
class Target:
    """Where a binary runs.

    Attributes
    ----------
    folder : folder under binaries/ in the FMU.
    suffix : suffix of the shared library.
    triples : the compiler's names of the target; several make one universal file.
    flags : flags for this target alone; `{library}` is the name of the library, `{compiler}` the
        folder of the compiler.
    """

    folder: str
    suffix: str
    triples: tuple[str, ...]
    flags: tuple[str, ...] = ()


# glibc 2.17 is that of the oldest systems which tools still support. FMI 2.0 has no folder for
# 64-bit ARM Linux; the one here is FMI 3.0's, which FMI 2.0.5 asks for.
# Nothing unwinds through C there, and the tables are a tenth of a binary.
_ELF = (
    "-fPIC",
    "-Wl,--build-id=none",
    "-Wl,--hash-style=gnu",  # which every loader of these systems reads; the old table is 1 %
    "-lm",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
)
# The compiler's own C library of Windows takes a hundred seconds to build, for a start-up that no
# plain C needs. Without it there are its headers and the system's libraries by their own names.
_PRINTF = ("snprintf", "vsnprintf", "__local_stdio_printf_options")
_PE = (
    "-nostdlib",
    "-Wl,--no-entry",
    "-D_UCRT=",
    "-isystem",
    "{compiler}/lib/libc/include/any-windows-any",
    *(f"-lapi-ms-win-crt-{part}-l1-1-0" for part in ("math", "heap", "stdio", "string", "private")),
    "-lkernel32",
    "-lcompiler_rt",
    *(f"{{compiler}}/lib/libc/mingw/stdio/ucrt_{name}.c" for name in _PRINTF),
    str(files("fmu_src") / "c" / "windows.c"),
)
_MACH_O = ("-fPIC", "-Wl,-install_name,@rpath/{library}")
TARGETS: Mapping[str, Target] = {
    target.folder: target
    for target in (
        Target(folder="linux64", suffix=".so", triples=("x86_64-linux-gnu.2.17",), flags=_ELF),
        Target(folder="win64", suffix=".dll", triples=("x86_64-windows-gnu",), flags=_PE),
        Target(
            folder="darwin64",
            suffix=".dylib",
            triples=("x86_64-macos.11.0", "aarch64-macos.11.0"),
            flags=_MACH_O,
        ),
        Target(
            folder="aarch64-linux", suffix=".so", triples=("aarch64-linux-gnu.2.17",), flags=_ELF
        ),
    )
}


def targets(platforms: Sequence[str]) -> tuple[Target, ...]:
    """Return the targets of these names; "all" stands for every one.

    Raises
    ------
    ExportError
        If a name is unknown or there is none.
    """
    for name in platforms:
        if name not in TARGETS and name != "all":
            raise ExportError(
                f"platform '{name}' is unknown; known are {', '.join(TARGETS)} and 'all'."
            )
    if not platforms:
        raise ExportError(f"no platform is given; known are {', '.join(TARGETS)} and 'all'.")
    return tuple(t for name, t in TARGETS.items() if name in platforms or "all" in platforms)


def build(source: Path, identifier: str, target: Target, flags: Sequence[str] = ()) -> bytes:
    """Compile one translation unit to a shared library and return its bytes.

    Further flags are those of libraries that it is linked to.

    Raises
    ------
    ExportError
        If the compiler fails, with the first line of what it says.
    """
    library = identifier + target.suffix
    with scratch_folder() as folder:
        parts = []
        for triple in target.triples:
            # A folder for each part: the linker writes import libraries and the like beside it.
            output = folder / triple / library
            output.parent.mkdir()
            last = [*(flag.replace("{library}", library) for flag in target.flags), *flags]
            compile_c(source, ("-target", triple, *CFLAGS, *_LINK), output, last)
            parts.append(output.read_bytes())
    return parts[0] if len(parts) == 1 else universal(parts)


# A module that is started by its host and imports nothing: the C library's functions that are used
# need no operating system. Small, because it stands in a page.
_WASM = ("-target", "wasm32-wasi", "-mexec-model=reactor", *CFLAGS, "-Oz", "-g0", "-s")


def build_wasm(source: Path) -> bytes:
    """Compile one translation unit to a WebAssembly module and return its bytes.

    Raises
    ------
    ExportError
        If the compiler fails, with the first line of what it says.
    """
    with scratch_folder() as folder:
        output = folder / f"{source.stem}.wasm"
        compile_c(source, _WASM, output)
        return output.read_bytes()


def compile_c(source: Path, flags: Sequence[str], output: Path, last: Sequence[str] = ()) -> None:
    """Compile one source file, or take what was made of the same texts and flags before.

    Raises
    ------
    ExportError
        If the compiler fails, with the first line of what it says.
    """
    inputs = (
        f"ziglang {version('ziglang')}",
        source.name,
        output.name,
        *(f"flag {flag}" for flag in (*flags, "|", *last)),
        *_contents(source, (*flags, *last)),
    )
    output.write_bytes(kept("binaries", inputs, lambda: _compiled(source, flags, output, last)))
    output.chmod(0o755)


_INCLUDE = re.compile(rb"^[ \t]*#[ \t]*include[ \t]*[\"<]([^\">]+)", re.MULTILINE)


def _contents(source: Path, flags: Sequence[str]) -> Iterator[str]:
    """Yield a hash of each file that goes into a compilation, but for those of the compiler.

    These are the source, what the flags name, and what they include, wherever it is found.
    """
    home = source.parent
    folders = [home / found[1] for flag in flags if (found := re.match("-(?:I|isystem)(.+)", flag))]
    todo = [source, *(home / flag for flag in flags if (home / flag).is_file())]
    seen = set(todo)
    while todo:
        file = todo.pop()
        data = file.read_bytes()
        yield hashlib.sha256(data).hexdigest()
        if file.suffix not in (".c", ".h"):
            continue
        for name in _INCLUDE.findall(data):
            places = (place / name.decode() for place in (file.parent, *folders))
            found = next((place for place in places if place.is_file()), None)
            if found and found not in seen:
                seen.add(found)
                todo.append(found)


def _compiled(source: Path, flags: Sequence[str], output: Path, last: Sequence[str]) -> bytes:
    # A linker takes a percent sign in the name of its output for a place to fill in, and folders of
    # a machine may have one. So it writes into a folder beside the source, named from there.
    with scratch_folder() as cache, scratch_folder(source.parent) as folder:
        written = folder / output.name
        relative = f"{written.parent.name}/{output.name}"
        compiler = str(files("ziglang"))
        command = [sys.executable, "-m", "ziglang", "cc", *flags, "-o", relative, source.name]
        # The compiler's cache of objects gives stale ones when compilations run side by side, so
        # each has its own; that of the C library, which takes long to build, stays shared.
        caches = {
            "ZIG_LOCAL_CACHE_DIR": str(cache),
            "ZIG_GLOBAL_CACHE_DIR": str(cache_folder() / "zig"),
        }
        try:
            # In the sources' own folder, so that no path of this machine gets into the binary.
            result = subprocess.run(
                [*command, *(flag.replace("{compiler}", compiler) for flag in last)],
                cwd=source.parent,
                env=os.environ | caches,
                capture_output=True,
                text=True,
                check=False,
            )
        except OSError as error:
            raise ExportError(f"the C compiler cannot be run ({error.strerror}).") from error
        if not result.returncode:
            return written.read_bytes()
    lines = [line for line in result.stderr.splitlines() if "error" in line] or ["no message"]
    raise ExportError(f"{output.name}: the C compiler failed: {lines[0].strip()}.")


_FAT_MAGIC = 0xCAFEBABE
_MACH_MAGIC_64 = 0xFEEDFACF
_PAGE_BITS = 14  # slices begin at pages of 16 KiB, the larger of the two architectures' pages


def universal(parts: Sequence[bytes]) -> bytes:
    """Join 64-bit Mach-O files of different architectures into one universal file."""
    page = 1 << _PAGE_BITS
    header = struct.pack(">II", _FAT_MAGIC, len(parts))
    offset, body = page, b""
    for part in parts:
        magic, cpu, subtype = struct.unpack_from("<III", part)
        if magic != _MACH_MAGIC_64:
            raise ValueError("not a 64-bit Mach-O file")
        header += struct.pack(">IIIII", cpu, subtype, offset, len(part), _PAGE_BITS)
        padded = part.ljust(-(-len(part) // page) * page, b"\0")
        body += padded
        offset += len(padded)
    return header.ljust(page, b"\0") + body
