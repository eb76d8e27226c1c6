"""The C compiler, with cached results."""

import errno
import hashlib
import json
import os
import re
import shutil
import sys
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

from hesr_model.errors import ExportError
from hesr_model.support.cache import compute_once
from hesr_model.support.cache import folder as cache_folder
from hesr_model.support.files import find_temporary_folder, require_room, room_for, scratch_folder
from hesr_model.support.process import FailedError, python_command, run

MISSING_COMPILER = "compiler.missing"  # code of an error
_SECONDS = 600.0  # of a compilation; the first one also builds the C library
_VARIABLES = ("PATH", "HOME", "SYSTEMROOT", "LOCALAPPDATA", "TEMP", "TMP")
_CONFINED = (
    "import json, sys; sys.path.append(sys.argv[1]); from hesr_model.support.rights import "
    "run_confined; run_confined(*json.loads(sys.argv[2]))"
)
PREBUILT = Path(__file__).with_name("binaries")  # kernels of a wheel, named by `digest`


def compile_c(
    source: Path, flags: Sequence[str], output: Path, last_flags: Sequence[str] = ()
) -> None:
    """Compile one source file, or reuse the result for the same texts and flags.

    In `last_flags`, `{compiler}` is replaced by the folder of the compiler. Raises ExportError, or
    ArtifactError for a folder without room.
    """
    name = digest(source, flags, output, last_flags)
    prebuilt = PREBUILT / name
    with room_for(output):
        if prebuilt.is_file():
            output.write_bytes(prebuilt.read_bytes())
        else:
            key = f"ziglang {version('ziglang')}", name
            output.write_bytes(
                compute_once(
                    "binaries", key, lambda: _run_compiler(source, flags, output, last_flags)
                )
            )
        output.chmod(0o755)


def digest(source: Path, flags: Sequence[str], output: Path, last_flags: Sequence[str] = ()) -> str:
    """Return a hash of all that determines a binary, except for the version of the compiler."""
    labels = [source.name, output.name, *(f"flag {flag}" for flag in (*flags, "|", *last_flags))]
    text = "\n".join([*labels, *_hash_contents(source, (*flags, *last_flags))])
    return hashlib.sha256(text.encode()).hexdigest()


_INCLUDE = re.compile(rb"^[ \t]*#[ \t]*include[ \t]*[\"<]([^\">]+)", re.MULTILINE)


def _hash_contents(source: Path, flags: Sequence[str]) -> Iterator[str]:
    """Yield hashes of a source, of files among the flags, and of all that they include."""
    home = source.parent
    include_flags = [re.match("-(?:I|isystem)(.+)", flag) for flag in flags]
    folders = [home / match[1] for match in include_flags if match]
    pending_files = [source, *(home / flag for flag in flags if (home / flag).is_file())]
    visited = set(pending_files)
    while pending_files:
        file = pending_files.pop()
        data = file.read_bytes()
        yield hashlib.sha256(data).hexdigest()
        if file.suffix not in (".c", ".cpp", ".h"):
            continue
        for name in _INCLUDE.findall(data):
            included = _find_included(name.decode(), [file.parent, *folders])
            if included and included not in visited:
                visited.add(included)
                pending_files.append(included)


def _find_included(name: str, folders: Sequence[Path]) -> Path | None:
    """Return the first file of this name in folders; None for one of the C library."""
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    return None


def _run_compiler(
    source: Path, flags: Sequence[str], output: Path, last_flags: Sequence[str]
) -> bytes:
    # A linker interprets percent signs in its output path, so the path is relative.
    with scratch_folder() as cache, scratch_folder(source.parent) as folder:
        compiled_file = folder / output.name
        relative_path = compiled_file.relative_to(source.parent).as_posix()
        compiler = str(files("ziglang"))
        program = str(files("ziglang") / "zig")
        if shutil.which(program) is None:  # the program that confines it would start
            reason = os.strerror(errno.ENOENT)
            raise ExportError(f"the C compiler cannot be run ({reason}).", code=MISSING_COMPILER)
        command = [program, "cc", *flags, "-o", relative_path, source.name]
        command += [flag.replace("{compiler}", compiler) for flag in last_flags]
        # The compiler's object cache breaks under concurrency, so each compilation has its own;
        # that of the slow C library is shared.
        shared_cache = cache_folder() / "zig"
        shared_cache.mkdir(parents=True, exist_ok=True)
        environment = _select_environment(cache, shared_cache)
        if sys.platform == "linux":
            writable = [str(cache), str(shared_cache), str(source.parent.resolve())]
            command = _confine(command, writable, _list_read_paths(source.parent, command))
        try:
            # Run in the source's folder to keep paths of this machine out of the binary.
            result = run(command, source.parent, _SECONDS, environment, start_new_session=False)
        except FailedError as error:
            raise ExportError(f"the C compiler cannot be run ({error}).") from error
        if not result.returncode:
            return compiled_file.read_bytes()
        # The compiler's own message names none of the folders.
        require_room(folder, find_temporary_folder(), cache_folder())
    lines = [line for line in result.stdout.splitlines() if "error" in line] or ["no message"]
    raise ExportError(f"{output.name}: the C compiler failed: {lines[0].strip()}.")


def _select_environment(cache: Path, shared_cache: Path) -> dict[str, str]:
    """Return the variables of the compiler: none of the user's, such as CPATH, changes a binary."""
    environment = {name: os.environ[name] for name in _VARIABLES if name in os.environ}
    environment["ZIG_LOCAL_CACHE_DIR"] = str(cache)
    environment["ZIG_GLOBAL_CACHE_DIR"] = str(shared_cache)
    environment["TMPDIR"] = str(cache)
    return environment


def _list_read_paths(folder: Path, command: Sequence[str]) -> list[str]:
    """Return the files and folders that the flags of a command name."""
    names = [re.sub("^-(?:I|isystem|L)", "", flag) for flag in command]
    return [str((folder / name).resolve()) for name in names if (folder / name).exists()]


def _confine(command: Sequence[str], writable: list[str], readable: list[str]) -> list[str]:
    """Return a command that runs the compiler with rights to its files only.

    A source cannot include others of the user (`.incbin`, `#embed`), nor be compiled for ever.
    """
    root = str(Path(__file__).parents[2])
    arguments = [command, writable, readable, int(_SECONDS)]
    return python_command("-I", "-c", _CONFINED, root, json.dumps(arguments))
