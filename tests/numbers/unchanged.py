"""Figures of the science as they were when they were last looked at.

That they are right, other tests show: by closed forms, by truths that are found again, by engines
that agree. These show that they are still the same, so that a constant or a sign cannot change
unseen. After a change that is meant: `pytest tests/numbers --regen-all`, and read the difference.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Protocol

import numpy as np

NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
MOST = 24
"""Elements of an array that are kept, evenly apart."""


class Unchanged(Protocol):
    def __call__(self, of: object, *, rtol: float = ..., atol: float = ...) -> None: ...


def leaves(of: object, name: str = "") -> Iterator[tuple[str, Any]]:
    """Numbers and arrays within nested data, each with its way there."""
    if isinstance(of, bool | np.bool_ | int | float | np.number):
        yield name, [float(of)]
    elif isinstance(of, np.ndarray) and of.dtype.kind in "biuf":
        flat = of.astype(float).ravel()
        yield name, flat[np.linspace(0, len(flat) - 1, min(len(flat), MOST)).astype(int)]
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
