"""Arrays of numbers in nested structures."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hesr_model.support.arrays import Array


def find_number_arrays(value: Any, name: str) -> Iterator[tuple[str, Array]]:
    """Yield the arrays of numbers in nested structures, named as in MATLAB."""
    if isinstance(value, Mapping):
        for field, inner in value.items():
            yield from find_number_arrays(inner, f"{name}.{field}" if name else str(field))
    elif isinstance(value, list):
        for k, inner in enumerate(value, start=1):
            yield from find_number_arrays(inner, f"{name}({k})")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "O":
        yield from find_number_arrays(list(value.ravel()), name)
    elif isinstance(value, np.ndarray) and value.dtype.names:
        yield from find_number_arrays({field: value[field] for field in value.dtype.names}, name)
    elif np.asarray(value).dtype.kind in "fiu":
        yield name, np.asarray(value, dtype=float)
