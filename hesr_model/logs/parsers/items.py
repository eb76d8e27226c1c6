"""Items of log files: JSON data, with arrays as raw bytes after it. Used in a child."""

import importlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hesr_model.errors import LogError
from hesr_model.logs.log_table import TextCell
from hesr_model.support.arrays import Array
from hesr_model.support.child_main import Item


def parse(parser: str, path: str, options: dict[str, Any]) -> Iterator[Item]:
    """Yield the items of a file by "module:function" of this package, or a refusal."""
    module, _, function = parser.partition(":")
    parse_file = getattr(importlib.import_module(f"{__package__}.{module}"), function)
    try:
        yield from parse_file(Path(path), **options)
    except LogError as error:
        yield {"refusal": {"sentence": str(error), "code": error.code, "key": error.key}}, ()


def build_item(columns: Iterable[tuple[str, Array | TextCell]], **more: Any) -> Item:
    """Return an item of named arrays of any shape and of cells of text, and more JSON data."""
    heads: list[dict[str, Any]] = []
    buffers = []
    for name, cells in columns:
        head: dict[str, Any] = {"name": name.encode("utf-8", "replace").decode()}
        if isinstance(cells, TextCell):
            head |= {"row": cells.index, "text": cells.text.encode("utf-8", "replace").decode()}
        else:
            array = np.ascontiguousarray(cells, cells.dtype.newbyteorder("="))
            head |= {"type": array.dtype.str, "shape": np.shape(cells)}
            buffers.append(array.ravel().view(np.uint8))
        heads.append(head)
    return {"columns": heads, **more}, buffers
