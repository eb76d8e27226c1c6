"""The C compiler, with cached results."""

import hashlib
import os
import re
import subprocess
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from hesr_model.errors import ExportError
from hesr_model.support.cache import compute_once
from hesr_model.support.cache import folder as cache_folder
from hesr_model.support.files import scratch_folder

PREBUILT = Path(__file__).with_name("binaries")  # kernels of a wheel, named by `digest`


def compile_c(source: Path, flags: Sequence[str], output: Path, last: Sequence[str] = ()) -> None:
    """Compile one source file, or reuse the result for the same texts and flags.

    In the flags `last`, `{compiler}` is replaced by the folder of the compiler. Raises ExportError.
    """
    name = digest(source, flags, output, last)
    prebuilt = PREBUILT / name
    if prebuilt.is_file():
        output.write_bytes(prebuilt.read_bytes())
    else:
        key = f"ziglang {version('ziglang')}", name
        output.write_bytes(
            compute_once("binaries", key, lambda: _run_compiler(source, flags, output, last))
        )
    output.chmod(0o755)


def digest(source: Path, flags: Sequence[str], output: Path, last: Sequence[str] = ()) -> str:
    """Return a hash of all that determines a binary, except for the version of the compiler."""
    named = [source.name, output.name, *(f"flag {flag}" for flag in (*flags, "|", *last))]
    text = "\n".join([*named, *_hash_contents(source, (*flags, *last))])
    return hashlib.sha256(text.encode()).hexdigest()


_INCLUDE = re.compile(rb"^[ \t]*#[ \t]*include[ \t]*[\"<]([^\">]+)", re.MULTILINE)


def _hash_contents(source: Path, flags: Sequence[str]) -> Iterator[str]:
    home = source.parent
    folders = [home / found[1] for flag in flags if (found := re.match("-(?:I|isystem)(.+)", flag))]
    todo = [source, *(home / flag for flag in flags if (home / flag).is_file())]
    visited = set(todo)
    while todo:
        file = todo.pop()
        data = file.read_bytes()
        yield hashlib.sha256(data).hexdigest()
        if file.suffix not in (".c", ".cpp", ".h"):
            continue
        for name in _INCLUDE.findall(data):
            places = (place / name.decode() for place in (file.parent, *folders))
            found = next((place for place in places if place.is_file()), None)
            if found and found not in visited:
                visited.add(found)
                todo.append(found)


def _run_compiler(source: Path, flags: Sequence[str], output: Path, last: Sequence[str]) -> bytes:
    # A linker interprets percent signs in its output path, so the path is relative.
    with scratch_folder() as cache, scratch_folder(source.parent) as folder:
        written = folder / output.name
        relative = f"{written.parent.name}/{output.name}"
        compiler = str(files("ziglang"))
        command = [str(files("ziglang") / "zig"), "cc", *flags, "-o", relative, source.name]
        # The compiler's object cache breaks under concurrency, so each compilation has its own;
        # that of the slow C library is shared.
        shared = str(cache_folder() / "zig")
        caches = {"ZIG_LOCAL_CACHE_DIR": str(cache), "ZIG_GLOBAL_CACHE_DIR": shared}
        try:
            # Run in the source's folder to keep paths of this machine out of the binary.
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
