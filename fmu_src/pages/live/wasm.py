"""An FMU as a WebAssembly module."""

import base64
import re
import zlib
from collections.abc import Mapping

from fmu_src.export.package import own_source
from fmu_src.export.toolchain import build_wasm
from hesr_model.support.files import scratch_folder


def wasm(sources: Mapping[str, str]) -> bytes:
    """Compile the C files of `package.translation_unit` to a WebAssembly module without imports.

    It exports the functions of `c/live.c` around those of FMI.
    """
    with scratch_folder() as folder:
        for name, text in (*sources.items(), ("live.c", own_source("live.c"))):
            (folder / name).write_text(text, encoding="utf-8")
        powers = any(re.search(r"\bpow\(", text) for text in sources.values())
        return build_wasm(folder / "live.c", powers=powers)


def packed(module: bytes) -> str:
    """Return a module as text for embedding in pages."""
    return base64.b64encode(zlib.compress(module, 9)).decode()
