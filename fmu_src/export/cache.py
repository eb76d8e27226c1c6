"""Cache of exported FMUs, by model, options and the software that makes them."""

import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

from hesr_model.support import plugins
from hesr_model.support.cache import compute_once, find_result
from hesr_model.support.files import written_whole
from hesr_model.support.text import read_text

_ROOT = Path(__file__).parents[2]
_HASHED_FOLDERS = tuple(_ROOT / folder for folder in ("fmu_src", "hesr_model", "hesr/extras"))


@cache
def software() -> str:
    """Return a hash of HESR's modules below the export, its extras and installed packages."""
    packages: set[str] = set()
    for folder in filter(os.path.isdir, sys.path):
        # Folders of metadata have the versions in their names.
        names = [entry.name for entry in Path(folder).iterdir()]
        packages |= {name for name in names if name.endswith((".dist-info", ".egg-info"))}
    key = hashlib.sha256("\n".join([sys.version, *sorted(packages)]).encode())
    for home in _HASHED_FOLDERS:
        for folder, folders_inside, names in os.walk(home):
            # Python writes there under names that another process sees for a moment only.
            folders_inside[:] = sorted(set(folders_inside) - {"__pycache__"})
            for file in (Path(folder, name) for name in sorted(names)):
                key.update(f"{file.relative_to(home).as_posix()}\n".encode())
                key.update(hashlib.sha256(file.read_bytes()).digest())
    return key.hexdigest()


def _inputs(
    model_path: Path, options: Mapping[str, object], output: Path
) -> tuple[str, ...] | None:
    try:
        text = read_text(model_path)
    except (OSError, ValueError):  # reported by `write`
        return None
    # A law of another package can change without a new version.
    if not all(law.is_built_in for law in plugins.load("hesr.laws").values()):
        return None
    date = os.environ.get("SOURCE_DATE_EPOCH", "")
    return text, json.dumps(options, sort_keys=True), output.suffix, date, software()


def copy_from_cache(model_path: Path, options: Mapping[str, object], output: Path) -> bool:
    """Copy an FMU that was exported with the same options, if there is one."""
    inputs = _inputs(model_path, options, output)
    if inputs is None:
        return False
    data = find_result("fmus", inputs)
    if data is None:
        return False
    with written_whole(output) as temporary:
        temporary.write_bytes(data)
    return True


def export_with_cache(
    model_path: Path, options: Mapping[str, object], output: Path, write: Callable[[], None]
) -> None:
    """Write an FMU to `output`, or copy it from the cache; `options` are all other settings."""
    inputs = _inputs(model_path, options, output)
    if inputs is None:
        write()
        return

    def make() -> bytes:
        write()
        return output.read_bytes()

    data = compute_once("fmus", inputs, make)
    with written_whole(output) as temporary:
        temporary.write_bytes(data)
