"""Steps of a system in C (`fmu_src/c/master.c`), for FMUs in this process."""

import ctypes
import logging
from collections.abc import Sequence
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from fmu_src.export.package import own_source
from fmu_src.export.toolchain import TARGETS, build
from fmu_src.run.fmi import VERSIONS
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.instance import PLATFORM, Buffer, LocalBuffer
from fmu_src.run.master import Layout
from hesr_model.errors import ExportError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

_log = logging.getLogger(__name__)


class _End(IntEnum):
    """Reasons for the end of the steps, in the order of master.c."""

    DONE, NOT_FINITE, OUTSIDE, SET_FAILED, STEP_FAILED, GET_FAILED = range(6)


_FUNCTIONS = {
    _End.SET_FAILED: "fmi2SetReal",
    _End.STEP_FAILED: "fmi2DoStep",
    _End.GET_FAILED: "fmi2GetReal",
}


class _Station(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("component", "set", "get", "step")),
        *((name, ctypes.c_int64) for name in ("every", "inputs", "outputs")),
        *((name, ctypes.c_void_p) for name in ("input_references", "output_references")),
        *((name, ctypes.c_void_p) for name in ("sources", "input_values", "output_values")),
    )


class _System(ctypes.Structure):
    _fields_ = (
        ("stations", ctypes.POINTER(_Station)),
        ("count", ctypes.c_int64),
        ("jacobi", ctypes.c_bool),
        ("step", ctypes.c_double),
        ("values", ctypes.c_void_p),
        ("size", ctypes.c_int64),
        ("rows", ctypes.c_void_p),
        ("width", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("limited", "low", "high")),
        ("limits", ctypes.c_int64),
        ("kept", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("done", "failed")),
        ("status", ctypes.c_int),
    )


def native_stepper(layout: Layout) -> "NativeStepper | None":
    """Return the steps in C; None for foreign FMUs or refreshed outputs, or without compiler."""
    converting = any(station.conversions for station in layout.stations)
    if layout.scheme.refreshed != "none" or layout.begin or converting:
        return None
    buffers = [b for station in layout.stations for b in (station.inputs, station.outputs)]
    own = [buffer for buffer in buffers if _is_native(buffer)]
    library = _library() if len(own) == len(buffers) else None
    return NativeStepper(layout, own[::2], own[1::2], library) if library else None


def _is_native(buffer: Buffer) -> TypeGuard[LocalBuffer]:
    return isinstance(buffer, LocalBuffer) and buffer.instance.fmi is VERSIONS[2]


class NativeStepper:
    """Steps in C with the compiled master.c and the buffers of the components."""

    def __init__(
        self,
        layout: Layout,
        inputs: Sequence[LocalBuffer],
        outputs: Sequence[LocalBuffer],
        library: ctypes.CDLL,
    ) -> None:
        self._layout, self._fail = layout, [buffer.instance.fail for buffer in inputs]
        self._advance = library["advance"]
        stations = (_Station * len(inputs))()
        self._held: list[Any] = [stations]  # keeps alive what C points to
        for at, into, out, station in zip(stations, inputs, outputs, layout.stations, strict=True):
            self._held += _connect(at, into, out)
            at.every = station.every
            at.sources = self._address(station.sources.astype(np.int64))
            at.input_values = self._address(into.values)
            at.output_values = self._address(out.values)
        self._system = _System(
            stations=ctypes.cast(stations, ctypes.POINTER(_Station)),
            count=len(stations),
            jacobi=layout.scheme.order == "jacobi",
            step=layout.step,
            values=self._address(layout.values),
            size=layout.values.size,
            rows=self._address(layout.rows.astype(np.int64)),
            width=layout.rows.size,
            limited=self._address(layout.limited.astype(np.int64)),
            low=self._address(np.ascontiguousarray(layout.low)),
            high=self._address(np.ascontiguousarray(layout.high)),
            limits=layout.limited.size,
        )

    def _address(self, array: Any) -> int:
        self._held.append(array)
        return int(array.ctypes.data)

    @property
    def done(self) -> int:
        """Number of recorded rows."""
        return int(self._system.done)

    def begin(self, kept: Array) -> None:
        """See `PythonStepper`."""
        self._kept = kept
        self._system.kept, self._system.done = kept.ctypes.data, 0

    def advance(self, stop: int) -> None:
        """See `PythonStepper`."""
        layout, system = self._layout, self._system
        end = _End(self._advance(ctypes.byref(system), ctypes.c_int64(stop)))
        failing = int(system.failed) if end in _FUNCTIONS else -1
        for i, station in enumerate(layout.stations):
            steps = max(self.done - 1, 0) + (end is _End.NOT_FINITE)
            station.slave.time = station.reached(steps, layout.step)
            if i == failing and end is _End.STEP_FAILED:
                station.slave.time = station.start(self.done - 1, layout.step)
            elif i == failing and end is _End.GET_FAILED:
                station.slave.time = station.reached(self.done, layout.step)
        if end is _End.OUTSIDE:
            layout.require_limits(layout.values, (self.done - 1) * layout.step)
        if failing >= 0:
            self._fail[failing](_FUNCTIONS[end], int(system.status))


def _connect(at: _Station, into: LocalBuffer, out: LocalBuffer) -> tuple[LocalBuffer, LocalBuffer]:
    slave = into.instance.slave
    at.component = slave.component
    at.set, at.get, at.step = (
        ctypes.cast(slave.dll[name], ctypes.c_void_p).value
        for name in ("fmi2SetReal", "fmi2GetReal", "fmi2DoStep")
    )
    at.inputs, at.outputs = into.values.size, out.values.size
    at.input_references = into.references.ctypes.data
    at.output_references = out.references.ctypes.data
    return into, out


_AT_ONCE = 1 << 16  # rows between which Python handles signals


def through(
    component: FmuInstance, inputs: Buffer, outputs: Buffer, times: Array, sizes: Array, rows: Array
) -> Array:
    """Set inputs (K, m), step from `times` by `sizes` (K,) [s], and return the outputs (K, n).

    FMUs in this process run in C, with the same results. Raises SimulationError if the FMU fails.
    """
    found = np.empty((len(rows), outputs.values.size))
    if _is_native(inputs) and _is_native(outputs) and (library := _library()):
        at, done, status = _Station(), ctypes.c_int64(0), ctypes.c_int(0)
        _connect(at, inputs, outputs)
        arrays = [np.ascontiguousarray(part, dtype=float) for part in (times, sizes, rows)]
        places = [ctypes.c_void_p(part.ctypes.data) for part in (*arrays, found)]
        while done.value < len(rows):
            stop = ctypes.c_int64(min(done.value + _AT_ONCE, len(rows)))
            results = ctypes.byref(done), ctypes.byref(status)
            end = _End(library["through"](ctypes.byref(at), *places, stop, *results))
            k = done.value - (end is _End.DONE)
            over = end in (_End.DONE, _End.GET_FAILED)
            component.time = float(times[k] + sizes[k]) if over else float(times[k])
            if end is not _End.DONE:
                inputs.instance.fail(_FUNCTIONS[end], status.value)
        return found
    for k, (time, size) in enumerate(zip(times.tolist(), sizes.tolist(), strict=True)):
        inputs.values[:] = rows[k]
        inputs.write()
        component.step(time, size)
        found[k] = outputs.read()
    return found


@cache
def _library() -> ctypes.CDLL | None:
    target = TARGETS.get(PLATFORM)
    if target is None:
        return None
    try:
        with scratch_folder() as folder:
            for name in ("master.c", "fmi2.h"):
                Path(folder, name).write_text(own_source(name), encoding="utf-8")
            file = Path(folder, f"master{target.suffix}")
            file.write_bytes(build(Path(folder, "master.c"), "master", target))
            return ctypes.CDLL(str(file))
    except (ExportError, OSError) as error:
        _log.info("systems are stepped in Python (%s).", error)
        return None
