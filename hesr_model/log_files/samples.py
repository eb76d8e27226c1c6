"""What every kind of log file gives."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """Samples of all joints, in the units of the file.

    Attributes
    ----------
    t
        (N,) [s].
    q, dq
        (N, n); dq is None where the file holds no velocity.
    effort
        (N, n), torque or current.
    is_current
        Whether the effort is current.
    time
        How an error names where the time stands: a column, a topic.
    place
        How an error names the place of sample k: a row, a message.
    """

    t: Array
    q: Array
    dq: Array | None
    effort: Array
    is_current: bool
    time: str
    place: Callable[[int], str]
