"""FMUs that have been exported before: the same file with the same options is a copy."""

import json
import os
from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from pathlib import Path

from fmu_src.export.software import software
from hesr_model.support.cache import kept
from hesr_model.support.files import written_whole
from hesr_model.support.untrusted_text import read_text


def exported(
    model: Path, options: Mapping[str, object], output: Path, write: Callable[[], None]
) -> None:
    """Write an FMU to `output` by `write`, or copy the one that it has written before.

    Parameters
    ----------
    model : file of the friction model.
    options : what else makes the FMU what it is.
    output : where `write` puts it.
    write : reads the model and writes the FMU; what it raises is raised here.

    Raises
    ------
    ArtifactError
        If `output` cannot be written.
    """
    try:
        text = read_text(model)
    except (OSError, ValueError):  # which `write` says in its own words
        text = None
    # Laws of other packages can change while the package says that it is the same.
    if text is None or entry_points(group="hesr.laws"):
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
