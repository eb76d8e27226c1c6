"""Real variables of an FMU that are set or read again and again, through one buffer."""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from hesr_model.support.arrays import Array

WARNING = 1
"""Highest status of FMI 2.0 with which a call has done its work."""


class Buffer(Protocol):
    """Values of several Real variables, wherever their FMU runs.

    Attributes
    ----------
    values : (n,) the buffer.
    """

    values: Array

    def write(self) -> None:
        """Set the variables to `values`; where that fails the next call may be the one to say."""

    def read(self) -> Array:
        """Read the variables into `values`, (n,) in their units, and return these."""


class Batch:
    """Values of several Real variables in one buffer; made by `Component.batch`.

    The calls go to the FMU's binary with arguments that were converted once: a co-simulation makes
    tens of thousands of them each second, and FMPy's own layer costs as much as a small FMU.

    Parameters
    ----------
    library : the loaded binary.
    instance : of the FMU.
    references : value references of the variables.
    values : (n,) contiguous, the buffer.
    fail : raises an error, given the name of the function that failed and its status.

    Attributes
    ----------
    values : (n,) the buffer.
    library, instance, references, fail : as given.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        instance: int,
        references: Sequence[int],
        values: Array,
        fail: Callable[[str, int], None],
    ) -> None:
        self.values, self.fail = values, fail
        self.library, self.instance = library, instance
        self.references = np.array(references, dtype=np.uint32)
        # A function that is looked up by index is a new object, whose prototype is ours to leave
        # open: arguments that are C objects already are then passed as they are.
        self._set, self._get = library["fmi2SetReal"], library["fmi2GetReal"]
        self._arguments: tuple[Any, ...] = (
            ctypes.c_void_p(instance),
            ctypes.c_void_p(self.references.ctypes.data),
            ctypes.c_size_t(len(references)),
            ctypes.c_void_p(values.ctypes.data),
        )

    def write(self) -> None:
        """Set the variables to `values`."""
        status = self._set(*self._arguments)
        if status > WARNING:
            self.fail("fmi2SetReal", status)

    def read(self) -> Array:
        """Read the variables into `values`, (n,) in their units, and return these."""
        status = self._get(*self._arguments)
        if status > WARNING:
            self.fail("fmi2GetReal", status)
        return self.values
