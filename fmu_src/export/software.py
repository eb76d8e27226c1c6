"""Which software makes an FMU: part of the key of what is kept of one."""

import hashlib
import sys
from functools import cache
from importlib.metadata import requires, version
from pathlib import Path
from re import match

import hesr_model

_OURS = (Path(__file__).parents[1], Path(str(hesr_model.__file__)).parent)


@cache
def software() -> str:
    """Return a hash of all of ours that exports a model, and the versions of what it stands on."""
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
