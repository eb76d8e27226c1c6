"""Communication steps of a system of initialised FMUs.

`fmu_src.run.native` does the same in C, equal bit for bit, for FMUs of FMI 2.0 in this process.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from fmu_src.run.instance import Buffer
from hesr_model.errors import SimulationError
from hesr_model.support.arrays import Array

Places = NDArray[np.intp]

Order = Literal["gauss_seidel", "jacobi"]

Element = tuple[str, str]  # component and variable
Convert = Callable[[float], float]


@dataclass(frozen=True, kw_only=True)
class ExchangeScheme:
    """When the FMUs of a system exchange values.

    Components step in turn with the newest outputs ("gauss_seidel"), or all with those at the start
    of their steps ("jacobi"). The first inputs are "zero" or outputs "propagated" in the
    initialisation. Outputs with direct feedthrough may follow the new inputs of an instant: "none",
    those that are "shown", or "all", including those that are passed on.
    """

    order: Order = "gauss_seidel"
    first: Literal["propagated", "zero"] = "propagated"
    refreshed: Literal["none", "shown", "all"] = "none"


class Slave(Protocol):
    """An initialised FMU; `time` [s] is that reached, or the start of the step that failed."""

    time: float

    def step(self, time: float, step_size: float) -> None:
        """Step from a time [s] by a step [s]."""


@dataclass(kw_only=True, eq=False)
class Station:
    """A component of a system."""

    slave: Slave
    every: int  # its step in communication steps
    inputs: Buffer  # connected ones
    sources: Places  # (n,) indices of the outputs that feed them
    outputs: Buffer  # part of the values of the system
    begin: float = 0.0  # of the run [s]
    conversions: Sequence[tuple[int, Convert]] = ()  # by place of the connected input

    def set_inputs(self, values: Array) -> None:
        """Set the connected inputs from the values of the system."""
        if self.sources.size:
            # All places are valid; without "clip" NumPy would copy.
            values.take(self.sources, out=self.inputs.values, mode="clip")
            for place, convert in self.conversions:
                self.inputs.values[place] = convert(self.inputs.values[place])
            self.inputs.write()

    def step(self, k: int, step_size: float) -> None:
        """Step to the end of communication step k of size `step_size` [s]."""
        self.slave.step(self.start(k, step_size), self.every * step_size)

    def start(self, k: int, step_size: float) -> float:
        """Return the start [s] of its step that ends with communication step k."""
        return self.begin + (k + 1 - self.every) * step_size

    def compute_time(self, steps: int, step_size: float) -> float:
        """Return its time [s] after a number of communication steps."""
        done_steps = steps - steps % self.every
        if not done_steps:
            return self.begin
        return self.start(done_steps - 1, step_size) + self.every * step_size

    def read_outputs(self) -> None:
        """Read the outputs."""
        if self.outputs.values.size:
            self.outputs.read()


@dataclass(frozen=True, kw_only=True, eq=False)
class Link:
    """A connected input or an output that feeds one; `place` is the index of this output."""

    buffer: Buffer
    place: int
    is_input: bool
    convert: Convert | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """A system, prepared for its steps.

    Its values (m,) are all outputs in use, by component; `rows` (n,) are the indices of recorded
    ones, `limited` (l,) of those with limits.
    """

    stations: tuple[Station, ...]  # in stepping order
    links: tuple[Link, ...]  # each after those that its value depends on
    scheme: ExchangeScheme
    begin: float  # of the run [s]
    step: float  # [s]
    values: Array
    names: tuple[Element, ...]
    rows: Places
    limited: Places
    low: Array
    high: Array
    times: Array | None = None  # communication points [s] that are not evenly spaced

    def time(self, k: int) -> float:
        """Return communication point k [s]."""
        if self.times is None:
            return self.begin + k * self.step
        return float(self.times[k])

    def propagate(self, time: float) -> None:
        """Set inputs along direct feedthrough [s]; raise SimulationError if one is not finite."""
        for link in self.links:
            if link.is_input:
                value = self.values[link.place]
                link.buffer.values[0] = link.convert(value) if link.convert else value
                link.buffer.write()
            else:
                self.values[link.place] = link.buffer.read()[0]
                if not np.isfinite(self.values[link.place]):
                    raise self.non_finite_error(link.place, time)

    def non_finite_error(self, place: int, time: float) -> SimulationError:
        """Return the error for a value that is not finite at a time [s]."""
        name = ".".join(self.names[place])
        return SimulationError(f"at t = {time:.9g} s {name} is not a finite number.")

    def require_limits(self, shown: Array, time: float) -> None:
        """Raise SimulationError if a value (m,) at a time [s] is outside its limits."""
        values = shown.take(self.limited, mode="clip")
        outside = (values < self.low) | (values > self.high)
        if np.count_nonzero(outside):
            i = int(np.argmax(outside))
            name = ".".join(self.names[self.limited[i]])
            raise SimulationError(
                f"at t = {time:.9g} s {name} is {values[i]:.6g}, outside its limits "
                f"{self.low[i]:.6g} to {self.high[i]:.6g}."
            )


class PythonStepper:
    """Steps of a system in Python; `done` is the number of recorded rows."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._zeros = np.zeros_like(layout.values)
        self._step = self._jacobi
        if layout.scheme.order == "gauss_seidel":
            self._step = self._gauss_seidel
        self.begin(np.empty((0, len(layout.rows))))

    def begin(self, recorded_rows: Array) -> None:
        """Begin a run that is recorded in an array (steps + 1, n)."""
        self._recorded_rows = recorded_rows
        self.done = 0

    def advance(self, stop: int) -> None:
        """Step until `stop` rows are recorded or a value is not finite.

        Raises SimulationError if a component fails or a value leaves its limits.
        """
        layout = self._layout
        for k in range(self.done, stop):
            if k > 0:
                self._step(k - 1)
            time = layout.time(k)
            shown = self._refresh_outputs(time)
            if shown.dot(self._zeros) != 0.0:  # infinity and NaN times zero are NaN
                layout.values[:] = shown
                break
            shown.take(layout.rows, out=self._recorded_rows[k], mode="clip")
            self.done = k + 1
            if layout.limited.size:
                layout.require_limits(shown, time)

    def _refresh_outputs(self, time: float) -> Array:
        """Return the values at a communication point [s], with outputs refreshed if required."""
        layout = self._layout
        values = self._layout.values
        if layout.scheme.refreshed == "none":
            return values
        passed_on = values.copy()
        if layout.scheme.refreshed == "all":
            layout.propagate(time)
        else:
            for station in layout.stations:
                station.set_inputs(values)
        for station in layout.stations:
            station.read_outputs()
        if layout.scheme.refreshed == "all":
            return values
        shown = values.copy()
        values[:] = passed_on
        return shown

    def _step_station(self, station: Station, k: int) -> None:
        times = self._layout.times
        if times is None:
            station.step(k, self._layout.step)
        else:
            station.slave.step(float(times[k]), float(times[k + 1] - times[k]))

    def _gauss_seidel(self, k: int) -> None:
        values = self._layout.values
        for station in self._layout.stations:
            if (k + 1) % station.every == 0:
                station.set_inputs(values)
                self._step_station(station, k)
                station.read_outputs()

    def _jacobi(self, k: int) -> None:
        values = self._layout.values
        for station in self._layout.stations:
            if k % station.every == 0:
                station.set_inputs(values)
        ending = [s for s in self._layout.stations if (k + 1) % s.every == 0]
        for station in ending:
            self._step_station(station, k)
        for station in ending:
            station.read_outputs()
