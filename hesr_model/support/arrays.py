"""Types of arrays; shapes and units are documented with each variable."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]
Record = TypeVar("Record")


def some_rows(record: Record, columns: Iterable[str], rows: slice | Mask | Integers) -> Record:
    """Return a data class with some rows of its arrays `columns`."""
    whole: Any = record
    found = {name: getattr(record, name) for name in columns}
    some: Record = replace(whole, **{n: v[rows] for n, v in found.items() if v is not None})
    return some


def joined(records: Sequence[Record], columns: Iterable[str]) -> Record:
    """Return the first data class with its arrays `columns` followed by those of the others."""
    first: Any = records[0]
    parts = {name: [getattr(record, name) for record in records] for name in columns}
    whole: Record = replace(first, **{n: np.concatenate(p) for n, p in parts.items()})
    return whole


def rms(errors: Array, axis: int | tuple[int, ...] | None = 0) -> Array:
    """Return the root mean square over axes, silently infinite or NaN."""
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=axis)))
