"""Steps of a system in C (`fmu_src/c/master.c`), for FMUs in this process."""

import ctypes
import logging
from collections.abc import Sequence
from enum import IntEnum
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from fmu_src.run.instance import PLATFORM, VERSIONS, Buffer, LocalBuffer
from fmu_src.run.master import Layout, Slave
from hesr_model.errors import ExportError
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder

_log = logging.getLogger(__name__)


class End(IntEnum):
    """Reasons for the end of the steps, in the order of master.c."""

    DONE, NOT_FINITE, OUTSIDE, SET_FAILED, STEP_FAILED, GET_FAILED = range(6)


FUNCTIONS = {
    End.SET_FAILED: "fmi2SetReal",
    End.STEP_FAILED: "fmi2DoStep",
    End.GET_FAILED: "fmi2GetReal",
}


class _Station(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("component", "set", "get", "step")),
        *((name, ctypes.c_int64) for name in ("every", "inputs", "outputs")),
        *((name, ctypes.c_void_p) for name in ("input_references", "output_references")),
        *((name, ctypes.c_void_p) for name in ("sources", "input_values", "output_values")),
    )


class StepRecord(ctypes.Structure):
    """Number of recorded rows, and the last call: index of a station, and `End`."""

    _fields_ = tuple((name, ctypes.c_int64) for name in ("done", "station", "call"))


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
        ("progress", ctypes.POINTER(StepRecord)),
        ("status", ctypes.c_int),
    )


def native_stepper(
    layout: Layout, library: ctypes.CDLL | None = None, progress: StepRecord | None = None
) -> "NativeStepper | None":
    """Return the steps in C; None for foreign FMUs or refreshed outputs, or without compiler."""
    if not _is_supported(layout):
        return None
    inputs = []
    outputs = []
    for station in layout.stations:
        if not (_is_native(station.inputs) and _is_native(station.outputs)):
            return None
        inputs.append(station.inputs)
        outputs.append(station.outputs)
    library = library or _library()
    if library is None:
        return None
    return NativeStepper(layout, inputs, outputs, library, progress or StepRecord())


def _is_supported(layout: Layout) -> bool:
    """Return whether master.c can step a system: at even steps from 0 s, in the same units."""
    if layout.scheme.refreshed != "none" or layout.begin or layout.times is not None:
        return False
    return not any(station.conversions for station in layout.stations)


def _is_native(buffer: Buffer) -> TypeGuard[LocalBuffer]:
    if not isinstance(buffer, LocalBuffer):
        return False
    return buffer.instance.fmi is VERSIONS[2] and not buffer.instance.has_solver


class NativeStepper:
    """Steps in C with the compiled master.c and the buffers of the components."""

    def __init__(
        self,
        layout: Layout,
        inputs: Sequence[LocalBuffer],
        outputs: Sequence[LocalBuffer],
        library: ctypes.CDLL,
        progress: StepRecord,
    ) -> None:
        self._layout = layout
        self._fail = [buffer.instance.fail for buffer in inputs]
        self._advance = library["advance"]
        self._progress = progress
        stations = (_Station * len(inputs))()
        self._held: list[Any] = [stations]  # keeps alive what C points to
        for c_station, input_buffer, output_buffer, station in zip(
            stations, inputs, outputs, layout.stations, strict=True
        ):
            self._held += _connect(c_station, input_buffer, output_buffer)
            c_station.every = station.every
            c_station.sources = self._address(station.sources.astype(np.int64))
            c_station.input_values = self._address(input_buffer.values)
            c_station.output_values = self._address(output_buffer.values)
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
            progress=ctypes.pointer(progress),
        )

    def _address(self, array: Any) -> int:
        self._held.append(array)
        return int(array.ctypes.data)

    @property
    def done(self) -> int:
        """Number of recorded rows."""
        return int(self._progress.done)

    def begin(self, recorded_rows: Array) -> None:
        """See `PythonStepper`."""
        self._recorded_rows = recorded_rows
        self._system.kept = recorded_rows.ctypes.data
        self._progress.done = 0

    def advance(self, stop: int) -> None:
        """See `PythonStepper`."""
        layout = self._layout
        system = self._system
        end = End(self._advance(ctypes.byref(system), ctypes.c_int64(stop)))
        failing = -1
        if end in FUNCTIONS:
            failing = int(self._progress.station)
        set_times(layout, self.done, end, failing)
        if end is End.OUTSIDE:
            layout.require_limits(layout.values, (self.done - 1) * layout.step)
        if failing >= 0:
            self._fail[failing](FUNCTIONS[end], int(system.status))


def set_times(layout: Layout, done: int, end: End, failing: int) -> None:
    """Set the times reached by the components, after `done` recorded rows."""
    for i, station in enumerate(layout.stations):
        steps = max(done - 1, 0) + (end is End.NOT_FINITE)
        station.slave.time = station.compute_time(steps, layout.step)
        if i == failing and end is End.STEP_FAILED:
            station.slave.time = station.start(done - 1, layout.step)
        elif i == failing and end is End.GET_FAILED:
            station.slave.time = station.compute_time(done, layout.step)


def _connect(
    c_station: _Station, input_buffer: LocalBuffer, output_buffer: LocalBuffer
) -> tuple[LocalBuffer, LocalBuffer]:
    slave = input_buffer.instance.slave
    c_station.component = slave.component
    c_station.set = ctypes.cast(slave.dll["fmi2SetReal"], ctypes.c_void_p).value
    c_station.get = ctypes.cast(slave.dll["fmi2GetReal"], ctypes.c_void_p).value
    c_station.step = ctypes.cast(slave.dll["fmi2DoStep"], ctypes.c_void_p).value
    c_station.inputs = input_buffer.values.size
    c_station.outputs = output_buffer.values.size
    c_station.input_references = input_buffer.references.ctypes.data
    c_station.output_references = output_buffer.references.ctypes.data
    return input_buffer, output_buffer


_ROWS_PER_CALL = 1 << 16  # rows between which Python handles signals


def step_rows(
    component: Slave,
    inputs: Buffer,
    outputs: Buffer,
    times: Array,
    sizes: Array,
    rows: Array,
) -> Array:
    """Set inputs (K, m), step from `times` by `sizes` (K,) [s], and return the outputs (K, n).

    FMUs in this process run in C, with the same results. Raises SimulationError if the FMU fails.
    """
    output_rows = np.empty((len(rows), outputs.values.size))
    if _is_native(inputs) and _is_native(outputs) and (library := _library()):
        c_station = _Station()
        done = ctypes.c_int64(0)
        status = ctypes.c_int(0)
        _connect(c_station, inputs, outputs)
        arrays = [np.ascontiguousarray(part, dtype=float) for part in (times, sizes, rows)]
        places = [ctypes.c_void_p(part.ctypes.data) for part in (*arrays, output_rows)]
        while done.value < len(rows):
            stop = ctypes.c_int64(min(done.value + _ROWS_PER_CALL, len(rows)))
            results = ctypes.byref(done), ctypes.byref(status)
            end = End(library["through"](ctypes.byref(c_station), *places, stop, *results))
            k = done.value - (end is End.DONE)
            component.time = float(times[k])
            if end in (End.DONE, End.GET_FAILED):  # the step itself has succeeded
                component.time = float(times[k] + sizes[k])
            if end is not End.DONE:
                inputs.instance.fail(FUNCTIONS[end], status.value)
        return output_rows
    for k, (time, size) in enumerate(zip(times.tolist(), sizes.tolist(), strict=True)):
        inputs.values[:] = rows[k]
        inputs.write()
        component.step(time, size)
        output_rows[k] = outputs.read()
    return output_rows


@cache
def _library() -> ctypes.CDLL | None:
    with scratch_folder() as folder:
        file = write_library(folder)
        if file is None:
            return None
        return ctypes.CDLL(str(file))


def write_library(folder: Path) -> Path | None:
    """Write the compiled master.c into a folder; return None without a compiler."""
    from fmu_src.export.toolchain import TARGETS, build  # not used in a sandbox

    target = TARGETS.get(PLATFORM)
    if target is None:
        return None
    try:
        for name in ("master.c", "fmi2.h"):
            Path(folder, name).write_bytes((files("fmu_src") / "c" / name).read_bytes())
        file = Path(folder, f"master{target.suffix}")
        file.write_bytes(build(Path(folder, "master.c"), "master", target))
    except (ExportError, OSError) as error:
        _log.info("systems are stepped in Python (%s).", error)
        return None
    return file
