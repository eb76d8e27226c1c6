"""A kind of file to damage, and its reader."""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

TESTS = Path(__file__).parents[1]
sys.path += [str(TESTS), str(TESTS / "unit"), str(TESTS / "cosim")]

from damage import damaged  # noqa: E402

from hesr_model.support.files import models_folder  # noqa: E402

UF850 = models_folder() / "uf850"


@dataclass(frozen=True, kw_only=True)
class Reader:
    """A kind of file.

    Attributes
    ----------
    suffix : file suffix.
    write : write a valid file.
    read : read it, or raise a `HesrError`.
    damage : return a damaged copy of a file's content.
    """

    suffix: str
    write: Callable[[Path], object]
    read: Callable[[Path], object]
    damage: Callable[[bytes, np.random.Generator], bytes] = damaged


def copy_of(source: Path) -> Callable[[Path], object]:
    return lambda path: shutil.copy(source, path)


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content, encoding="utf-8")


def toml(module: str, name: str) -> Callable[[Path], object]:
    """Read a file by a schema."""

    def read(path: Path) -> object:
        schema: Any = getattr(import_module(module), name)
        return schema.read(path)

    return read
