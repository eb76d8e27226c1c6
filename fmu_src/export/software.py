"""Hash of the software that makes an FMU, part of the key of the cache."""

import hashlib
import sys
from functools import cache
from importlib.metadata import requires, version
from pathlib import Path
from re import match

_ROOT = Path(__file__).parents[2]
_OURS = tuple(_ROOT / folder for folder in ("fmu_src", "hesr_model", "hesr/extras"))


@cache
def software() -> str:
    """Return a hash of HESR's modules below the export, its extras and its dependencies."""
    key = hashlib.sha256(sys.version.encode())
    for requirement in requires("hesr") or ():
        name = match(r"[\w.-]+", requirement)
        if name and "extra ==" not in requirement:
            key.update(f"{name[0]} {version(name[0])}\n".encode())
    for home in _OURS:
        for file in sorted(home.rglob("*")):
            if file.is_file() and file.suffix != ".pyc":
                key.update(f"{file.relative_to(home).as_posix()}\n".encode())
                key.update(hashlib.sha256(file.read_bytes()).digest())
    return key.hexdigest()
