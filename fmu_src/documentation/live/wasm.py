"""An FMU as a module of WebAssembly."""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

from fmu_src.package import own_source
from fmu_src.toolchain import build_wasm


def wasm(sources: Mapping[str, str]) -> bytes:
    """Compile the C files of an FMU to a WebAssembly module that imports nothing.

    It exports `live_reset`, `live_set`, `live_initialise`, `live_step`, `live_get` and `live_heard`
    of `c/live.c`, around the FMI functions of the very files that are in the FMU. The same files
    give the same bytes.

    Parameters
    ----------
    sources : texts of all C files by name, as `package.translation_unit` returns them.

    Raises
    ------
    ExportError
        If the compiler fails.
    """
    with TemporaryDirectory(prefix="hesr-") as folder:
        for name, text in (*sources.items(), ("live.c", own_source("live.c"))):
            Path(folder, name).write_text(text, encoding="utf-8")
        return build_wasm(Path(folder, "live.c"))
