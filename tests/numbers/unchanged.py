"""Recorded numbers of the models, to detect unintended changes.

Other tests verify that they are right: by closed forms, recovered truths and agreeing engines.
These detect an unnoticed change of a constant or sign. After an intended change, run
`pytest tests/numbers --regen-all` and review the difference.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Protocol

import numpy as np

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
MOST = 8
"""Numbers recorded of each array."""


class Unchanged(Protocol):
    def __call__(self, of: object, *, rtol: float = ..., atol: float = ...) -> None: ...


def summarise(values: np.ndarray) -> np.ndarray:
    """Return a short array, or evenly spaced elements of a long one and two sums over all.

    The sums weight each element differently. Those of positive and of negative elements are
    separate, so that no cancellation enlarges round-off.
    """
    if len(values) <= MOST:
        return values
    weights = np.linspace(1.0, 2.0, len(values))
    positive = np.nansum(weights * np.maximum(values, 0.0))
    negative = np.nansum(weights * np.minimum(values, 0.0))
    spaced = values[np.linspace(0, len(values) - 1, MOST - 2).astype(int)]
    return np.append(spaced, [positive, negative])


def leaves(of: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the numbers and arrays in nested data with their paths."""
    if isinstance(of, bool | np.bool_ | int | float | np.number):
        yield name, [float(of)]
    elif isinstance(of, np.ndarray) and of.dtype.kind in "biuf":
        yield name, summarise(of.astype(float).ravel())
    elif isinstance(of, str):
        yield name, [float(x) for x in NUMBER.findall(of)]
    elif isinstance(of, Mapping):
        for key, value in of.items():
            yield from leaves(value, f"{name}.{key}" if name else str(key))
    elif is_dataclass(of):
        own = [f.name for f in fields(of)]
        yield from leaves({key: getattr(of, key) for key in own}, name)
    elif isinstance(of, Sequence):
        if of and all(isinstance(x, int | float | np.number) for x in of):
            yield name, np.asarray(of, dtype=float)
        else:
            yield from leaves({str(i): x for i, x in enumerate(of)}, name)
