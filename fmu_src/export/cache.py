"""Cache of exported FMUs, by model and options."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from fmu_src.export.software import software
from hesr_model.support import plugins
from hesr_model.support.cache import kept
from hesr_model.support.files import written_whole
from hesr_model.support.untrusted_text import read_text


def exported(
    model: Path, options: Mapping[str, object], output: Path, write: Callable[[], None]
) -> None:
    """Write an FMU to `output`, or copy it from the cache.

    `options` are all other settings that the FMU depends on. `write` reads the model and writes
    `output`; its errors are raised here.
    """
    try:
        text = read_text(model)
    except (OSError, ValueError):  # reported by `write`
        text = None
    # A law of another package can change without a new version of the package.
    if text is None or not all(law.own for law in plugins.load("hesr.laws").values()):
        write()
        return

    def make() -> bytes:
        write()
        return output.read_bytes()

    date = os.environ.get("SOURCE_DATE_EPOCH", "")
    inputs = (text, json.dumps(options, sort_keys=True), output.suffix, date, software())
    data = kept("fmus", inputs, make)
    with written_whole(output) as temporary:
        temporary.write_bytes(data)
