"""An instance of FMI 3.0 behind the methods of one of FMI 2.0."""

from collections.abc import Callable, Sequence
from ctypes import byref, c_bool, c_double, c_size_t, c_void_p
from typing import Any

import numpy as np
from fmpy import fmi3
from fmpy.fmi3 import FMU3Slave

from fmu_src.run.batch import WARNING
from fmu_src.run.instance import Binary, CallError, Instance, renamed
from fmu_src.run.variables import element_of
from hesr_model.support.arrays import Array


def instance_of(
    binary: Binary,
    tell: Callable[[int, str], None],
    failure: Callable[[Exception], Exception] = lambda error: error,
) -> Instance:
    """Return an instance of an FMU's own version of FMI; arguments are those of `Instance`."""
    return (Instance3 if binary.fmi == 3 else Instance)(binary, tell, failure)


class Instance3(Instance):
    """An FMU of FMI 3.0 in this process; see `Instance`.

    Arrays are set as a whole, so what was last set is kept.
    """

    def _make(self, binary: Binary) -> None:
        self._slave = FMU3Slave(
            guid=binary.guid,
            modelIdentifier=binary.identifier,
            unzipDirectory=binary.folder,
            instanceName=binary.name,
        )

    def _begin(self, binary: Binary) -> None:
        self._starts = {array: starts for array, _, _, starts in binary.variables}
        self._types = {array: kind for array, _, kind, _ in binary.variables}
        self._held = {array: list(starts) for array, starts in self._starts.items()}
        self._experiment: tuple[float, ...] = ()
        self._slave.instantiate(logMessage=self._hear)
        self._do_step = self._slave.dll["fmi3DoStep"]
        self._instance = c_void_p(self._slave.component)
        self._from, self._size = c_double(), c_double()
        self._said, self._last = (c_bool(), c_bool(), c_bool()), c_double()

    def _hear(self, _environment: Any, status: int, _kind: bytes, text: bytes) -> None:
        self._tell(status, (text or b"").decode("utf-8", errors="replace"))

    def call(self, function: str, *arguments: float) -> None:
        """Call a function that takes the instance and numbers, by its name in FMI 2.0."""
        if function == "fmi2SetupExperiment":
            self._experiment = arguments
            return
        more: tuple[Any, ...] = arguments
        if function == "fmi2EnterInitializationMode":
            tolerant, tolerance, start, stops, stop = self._experiment
            more = (c_bool(bool(tolerant)), tolerance, start, c_bool(bool(stops)), stop)
        self._do(renamed(function, 3), *more)
        if function == "fmi2Reset":
            self._held = {array: list(starts) for array, starts in self._starts.items()}

    def put(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of a type other than Real, text encoded in UTF-8."""
        for reference, value in zip(references, values, strict=True):
            array, place = element_of(reference)
            own = {"Enumeration": "Int64"}.get(self._types[array], self._types[array])
            held = self._held[array]
            held[place] = value
            make = getattr(fmi3, f"fmi3{own}")
            shown = [v.encode() if kind == "String" else int(v) for v in held]
            self._do(
                f"fmi3Set{own}",
                (fmi3.fmi3ValueReference * 1)(array), 1, (make * len(held))(*shown), len(held),
            )  # fmt: skip

    # Unused are the arguments of an `Instance`, whose method this is.
    def slope(self, references: Sequence[int], slopes: Sequence[float]) -> None:  # noqa: ARG002
        """Refuse slopes of inputs, which FMI 3.0 has not."""
        raise self._failure(CallError("inputs have no derivatives in FMI 3.0"))

    def step(self, time: float, size: float) -> None:
        """Go from a time on by the size of a step [s]."""
        self._from.value, self._size.value = time, size
        event, end, early = self._said
        status = self._do_step(
            self._instance, self._from, self._size, c_bool(True), byref(event), byref(end),
            byref(early), byref(self._last),
        )  # fmt: skip
        if status > WARNING:
            self._fail("fmi3DoStep", status)
        if end.value or early.value:
            how = "asked for the end of the simulation" if end.value else "ended early, unasked"
            raise self._failure(CallError(f"fmi3DoStep {how}"))

    def batch(self, references: Sequence[int], values: Array | None = None) -> Any:
        """Return a buffer of Real variables; see `Instance`."""
        own = np.zeros(len(references)) if values is None else values
        return Batch3(self._slave, self._held, references, own, self._fail)

    def _end(self) -> None:
        self._slave.fmi3Terminate(self._slave.component)

    def _free(self) -> None:
        self._slave.fmi3FreeInstance(self._slave.component)


class Batch3:
    """Values of several Real variables of FMI 3.0 in one buffer; see `fmu_src.run.batch.Batch`.

    Parameters
    ----------
    slave : the FMU.
    held : values that were last set, by value reference; what is written is kept in it.
    references : of the variables, as `fmu_src.run.variables` makes them.
    values : (n,) contiguous, the buffer.
    fail : raises an error, given the name of the function that failed and its status.
    """

    def __init__(
        self,
        slave: Any,
        held: dict[int, list[Any]],
        references: Sequence[int],
        values: Array,
        fail: Callable[[str, int], None],
    ) -> None:
        self.values, self._fail, self._held = values, fail, held
        self._arrays = list(dict.fromkeys(element_of(r)[0] for r in references))
        sizes = [len(held[array]) for array in self._arrays]
        first = dict(zip(self._arrays, np.cumsum([0, *sizes]).tolist(), strict=False))
        places = [first[array] + place for array, place in map(element_of, references)]
        self._places = np.array(places, dtype=np.intp)
        # Where the buffer is all elements of arrays in their order, it needs no other.
        plain = places == list(range(sum(sizes)))
        self._whole: Array = values if plain else np.zeros(sum(sizes))
        self._names = np.array(self._arrays, dtype=np.uint32)
        self._set, self._get = slave.dll["fmi3SetFloat64"], slave.dll["fmi3GetFloat64"]
        self._arguments: tuple[Any, ...] = (
            c_void_p(slave.component),
            c_void_p(self._names.ctypes.data),
            c_size_t(len(self._names)),
            c_void_p(self._whole.ctypes.data),
            c_size_t(self._whole.size),
        )

    def write(self) -> None:
        """Set the variables to `values`, and other elements of their arrays to what they were."""
        if self._whole is not self.values:
            self._whole[:] = [v for array in self._arrays for v in self._held[array]]
            self._whole[self._places] = self.values
        status = self._set(*self._arguments)
        if status > WARNING:
            self._fail("fmi3SetFloat64", status)
        at = 0
        for array in self._arrays:
            held = self._held[array]
            held[:] = self._whole[at : at + len(held)].tolist()
            at += len(held)

    def read(self) -> Array:
        """Read the variables into `values`, (n,) in their units, and return these."""
        status = self._get(*self._arguments)
        if status > WARNING:
            self._fail("fmi3GetFloat64", status)
        if self._whole is not self.values:
            self._whole.take(self._places, out=self.values)
        return self.values
