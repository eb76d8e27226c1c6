"""Types of arrays, by what they hold; shapes and units stand with whatever has one."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Numbers."""
Mask = NDArray[np.bool_]
"""Which rows, or which of whatever else."""
Integers = NDArray[np.int_]
"""Labels, counts and places."""

Record = TypeVar("Record")


def some_rows(record: Record, columns: Iterable[str], rows: slice | Mask | Integers) -> Record:
    """Return a data class of arrays (N, ..) with some of their rows, units as they were.

    Parameters
    ----------
    record : the data class.
    columns : names of its arrays; those that are None stay so.
    rows : a slice, a mask (N,), or places (K,).
    """
    whole: Any = record
    found = {name: getattr(record, name) for name in columns}
    some: Record = replace(whole, **{n: v[rows] for n, v in found.items() if v is not None})
    return some
