"""A fixed-step master: runs a system of FMUs and keeps the signals that are observed."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.component import Array, Batch, Component
from cosim.system import ComponentSpec, SystemSpec, Wiring
from hesr_model.errors import SimulationError
from hesr_model.files import written_whole
from hesr_model.tables import write_table

Progress = Callable[[int, int], None]
"""Called with how many steps are done and how many there are."""

_TELL_EVERY = 200  # steps


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """What a run gave, up to its end or to where it failed.

    Attributes
    ----------
    t : (N,) communication points [s].
    signals : (N,) values of every observed scalar, by `component.variable`.
    failure : why the run ended early, None if it did not.
    """

    t: Array
    signals: dict[str, Array]
    failure: SimulationError | None = None

    def vector(self, signal: str) -> Array:
        """Return all elements of a signal, (N, n)."""
        names = [f"{signal}[{i}]" for i in range(1, len(self.signals) + 1)]
        return np.column_stack([self.signals[name] for name in names if name in self.signals])

    def require_success(self) -> "Result":
        """Return itself, or raise what ended the run early."""
        if self.failure:
            raise self.failure
        return self

    def write(self, path: Path) -> None:
        """Write time and signals as CSV, or Parquet where the name ends so."""
        with written_whole(path) as temporary:
            write_table(temporary, {"t": self.t} | self.signals)


@dataclass(kw_only=True, eq=False)
class _Station:
    """A component with the places of its signals among the outputs of the system."""

    spec: ComponentSpec
    slave: Component
    every: int
    """Its step in communication steps."""
    inputs: Batch
    sources: np.ndarray
    outputs: Batch
    place: slice
    step: float

    def read_into(self, values: Array) -> None:
        values[self.place] = self.outputs.read()

    def take(self, values: Array) -> None:
        if len(self.sources):
            values.take(self.sources, out=self.inputs.values)
            self.inputs.write()


class Master:
    """A system that is loaded and checked; a context manager that frees every FMU on any way out.

    Parameters
    ----------
    spec : the system.
    path : its file, for messages.

    Raises
    ------
    ConfigError
        On entering, if the system does not fit its FMUs; see `Wiring`.
    SimulationError
        On entering, if an FMU cannot be loaded.
    """

    def __init__(self, spec: SystemSpec, path: Path = Path("system")) -> None:
        self.spec, self._path = spec, path
        self._cleanup = ExitStack()

    def __enter__(self) -> "Master":
        """Load all FMUs and check the wiring."""
        with ExitStack() as cleanup:
            slaves = {
                c.name: cleanup.enter_context(Component(c.fmu, name=c.name))
                for c in self.spec.components
            }
            wiring = Wiring(self.spec, slaves, self._path)
            self._build(slaves, wiring)
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Free all FMUs."""
        self._cleanup.close()

    def _build(self, slaves: dict[str, Component], wiring: Wiring) -> None:
        spec = self.spec
        observed = [e for signal in spec.observe for e in wiring.elements(signal)]
        limited = [(e, bounds) for signal, bounds in spec.limits.items()
                   for e, bounds in _paired(wiring.elements(signal), bounds, signal)]  # fmt: skip
        wanted = [*wiring.sources.values(), *observed, *(e for e, _ in limited)]
        self._places: dict[tuple[str, str], int] = {}
        self._stations: list[_Station] = []
        for component in spec.components:
            names = list(dict.fromkeys(v for c, v in wanted if c == component.name))
            start = len(self._places)
            self._places |= {(component.name, v): start + i for i, v in enumerate(names)}
            slave = slaves[component.name]
            fed = [v for c, v in wiring.sources if c == component.name]
            every = round((component.step or spec.step) / spec.step)
            self._stations.append(
                _Station(
                    spec=component,
                    slave=slave,
                    every=every,
                    inputs=slave.batch(fed),
                    sources=np.empty(0, dtype=int),
                    outputs=slave.batch(names),
                    place=slice(start, start + len(names)),
                    step=every * spec.step,
                )
            )
        for station in self._stations:
            own = station.spec.name
            places = [self._places[out] for (c, _), out in wiring.sources.items() if c == own]
            station.sources = np.array(places, dtype=int)
        self._observed = {f"{c}.{v}": self._places[c, v] for c, v in observed}
        self._rows = np.array(list(self._observed.values()), dtype=int)
        self._limited = np.array([self._places[e] for e, _ in limited], dtype=int)
        self._low, self._high = np.array([b for _, b in limited]).reshape(-1, 2).T
        self._values = np.zeros(len(self._places))

    def run(self, progress: Progress | None = None) -> Result:
        """Run the system from its start values; a failure ends the run and stands in the result.

        Components can be run again and again: each run begins with a reset.
        """
        steps = self.spec.steps
        kept = np.empty((steps + 1, len(self._rows)))
        done, failure = 0, None
        try:
            self._initialise()
            kept[0] = self._values[self._rows]
            done = 1
            self._require_sane(0.0)
            for k in range(steps):
                self._step(k)
                kept[k + 1] = self._values[self._rows]
                done = k + 2
                self._require_sane((k + 1) * self.spec.step)
                if progress and k % _TELL_EVERY == 0:
                    progress(k, steps)
        except SimulationError as error:
            failure = error
        if progress:
            progress(steps, steps)
        t = self.spec.step * np.arange(done)
        signals = {name: kept[:done, i] for i, name in enumerate(self._observed)}
        return Result(t=t, signals=signals, failure=failure)

    def _initialise(self) -> None:
        values, stations = self._values, self._stations
        for station in stations:
            slave = station.slave
            if slave.used:
                slave.reset()
            start = slave.expanded(station.spec.start)
            slave.enter_initialisation(time=0.0, stop=self.spec.stop, start=start)
        # One pass for each component: however they feed each other, without a loop that suffices.
        for _ in stations:
            for station in stations:
                station.take(values)
                station.read_into(values)
        for station in stations:
            station.slave.exit_initialisation()
        for station in stations:
            station.read_into(values)

    def _step(self, k: int) -> None:
        """Step all components that reach a communication point of theirs at the end of step k."""
        values = self._values
        stations = [s for s in self._stations if (k + 1) % s.every == 0]
        if self.spec.order == "jacobi":
            for station in stations:
                station.take(values)
            for station in stations:
                station.slave.step((k + 1 - station.every) * self.spec.step, station.step)
            for station in stations:
                station.read_into(values)
            return
        for station in stations:
            station.take(values)
            station.slave.step((k + 1 - station.every) * self.spec.step, station.step)
            station.read_into(values)

    def _require_sane(self, time: float) -> None:
        """Check that all outputs are finite and the limited ones within their limits."""
        values = self._values
        if not np.isfinite(values.sum()):
            name = self._name(int(np.argmin(np.isfinite(values))))
            raise SimulationError(f"at t = {time:.9g} s {name} is not a finite number.")
        if len(self._limited):
            limited = values[self._limited]
            inside = (limited >= self._low) & (limited <= self._high)
            if not inside.all():
                i = int(np.argmin(inside))
                raise SimulationError(
                    f"at t = {time:.9g} s {self._name(int(self._limited[i]))} is {limited[i]:.6g}, "
                    f"outside its limits {self._low[i]:.6g} to {self._high[i]:.6g}."
                )

    def _name(self, place: int) -> str:
        return next(".".join(e) for e, i in self._places.items() if i == place)


def _paired(elements: list[tuple[str, str]], bounds: object, signal: str) -> Iterator:  # type: ignore[type-arg]
    """Bounds of each element: one pair for all of them, or one for each."""
    pairs = np.array(bounds, dtype=float).reshape(-1, 2)
    if len(pairs) not in (1, len(elements)):
        raise SimulationError(
            f"limits of '{signal}': {len(pairs)} pairs for {len(elements)} elements."
        )
    for i, element in enumerate(elements):
        yield element, tuple(pairs[i % len(pairs)])


def simulate(spec: SystemSpec, path: Path, progress: Progress | None = None) -> Result:
    """Load a system, run it once and free it."""
    with Master(spec, path) as master:
        return master.run(progress)
