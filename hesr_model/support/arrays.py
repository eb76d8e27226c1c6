"""Types of arrays; shapes and units are documented with each variable."""

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Integers = NDArray[np.int_]
Record = TypeVar("Record")

# Least part of a column that the columns before it do not explain, of its square: a correlation
# of 0.999. Below it noise would decide the coefficient.
_MIN_INDEPENDENT_SHARE = 2e-3


def get_arrays(record: Any) -> dict[str, Any]:
    """Return the arrays of a data class by name."""
    field_values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: values for name, values in field_values.items() if isinstance(values, np.ndarray)}


def select_rows(record: Record, rows: slice | Mask | Integers) -> Record:
    """Return a data class with some rows of its arrays."""
    original: Any = record
    selected: Record = replace(
        original, **{k: values[rows] for k, values in get_arrays(record).items()}
    )
    return selected


def join_records(records: Sequence[Record]) -> Record:
    """Return the first data class with its arrays followed by those of the others."""
    first: Any = records[0]
    joined: dict[str, Any] = {}
    for name in get_arrays(first):
        joined[name] = np.concatenate([getattr(record, name) for record in records])
    combined: Record = replace(first, **joined)
    return combined


def rms(errors: Array, axis: int | tuple[int, ...] | None = 0) -> Array:
    """Return the root mean square over axes, silently infinite or NaN."""
    with np.errstate(all="ignore"):
        return np.asarray(np.sqrt(np.mean(np.square(errors), axis=axis)))


def find_independent_columns(columns: Array) -> Mask:
    """Return whether each of the columns (N, K) is not explained by those before it, (K,)."""
    independent: list[int] = []
    for k, column in enumerate(columns.T):
        residual = column
        if independent:
            earlier = columns[:, independent]
            residual = column - earlier @ np.linalg.lstsq(earlier, column)[0]
        if residual @ residual > _MIN_INDEPENDENT_SHARE * float(column @ column):
            independent.append(k)
    return np.isin(np.arange(columns.shape[1]), independent)
