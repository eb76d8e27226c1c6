"""An FMU as a module of WebAssembly."""

import base64
import re
import zlib
from collections.abc import Mapping

from fmu_src.export.package import own_source
from fmu_src.export.toolchain import build_wasm
from hesr_model.support.files import scratch_folder


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
    with scratch_folder() as folder:
        for name, text in (*sources.items(), ("live.c", own_source("live.c"))):
            (folder / name).write_text(text, encoding="utf-8")
        powers = any(re.search(r"\bpow\(", text) for text in sources.values())
        return build_wasm(folder / "live.c", powers=powers)


def packed(module: bytes) -> str:
    """Return a module as text, as pages carry it."""
    return base64.b64encode(zlib.compress(module, 9)).decode()
