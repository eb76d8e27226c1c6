"""A fixed-step master: runs a system of FMUs and keeps the signals that are observed."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from cosim.batch import Array, Buffer
from cosim.slave import Component
from cosim.system import SystemSpec, Value
from cosim.wiring import Element, Wiring
from hesr_model.errors import HesrError, SimulationError
from hesr_model.logs.tables import write_table
from hesr_model.support.files import written_whole
from hesr_model.support.progress import Progress, unheard

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
    failure: HesrError | None = None

    def vector(self, signal: str) -> Array:
        """Return all elements of an observed signal, (N, n) in its unit.

        Raises
        ------
        SimulationError
            If it has not been observed.
        """
        names = [signal] if signal in self.signals else []
        while (name := f"{signal}[{len(names) + 1}]") in self.signals:
            names.append(name)
        if not names:
            raise SimulationError(f"signal '{signal}' has not been observed.")
        return np.column_stack([self.signals[name] for name in names])

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
    """A component at its place in the system.

    Attributes
    ----------
    slave : the component.
    every : its step in communication steps.
    inputs : buffer of its connected inputs.
    sources : (n,) for each of them the place of the output that feeds it.
    outputs : buffer of its outputs, a part of the values of the system.
    """

    slave: Component
    every: int
    inputs: Buffer
    sources: NDArray[np.intp]
    outputs: Buffer

    def set_inputs(self, values: Array) -> None:
        """Set the connected inputs."""
        if self.sources.size:
            # All places are valid; without that promise NumPy would go through a copy.
            values.take(self.sources, out=self.inputs.values, mode="clip")
            self.inputs.write()

    def step(self, k: int, step: float) -> None:
        """Step to the end of communication step k, whose size is `step` [s]."""
        self.slave.step((k + 1 - self.every) * step, self.every * step)

    def read_outputs(self) -> None:
        """Read the outputs."""
        if self.outputs.values.size:
            self.outputs.read()


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
            self._slaves = {
                c.name: cleanup.enter_context(Component(c.fmu, name=c.name))
                for c in self.spec.components
            }
            variables = {name: slave.variables for name, slave in self._slaves.items()}
            self._wiring = Wiring(self.spec, variables, self._path)
            self._build()
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free all FMUs."""
        self._cleanup.__exit__(kind, error, trace)

    def _build(self) -> None:
        """Give every output that is needed a place, those of a component side by side."""
        wiring = self._wiring
        wanted = [*wiring.sources.values(), *wiring.observed, *(e for e, _ in wiring.limited)]
        self._names: list[Element] = [
            element
            for name in self._slaves
            for element in dict.fromkeys(wanted)
            if element[0] == name
        ]
        place = {element: i for i, element in enumerate(self._names)}
        self._values = np.zeros(len(place))
        self._zeros = np.zeros_like(self._values)
        self._stations = []
        for component in self.spec.components:
            slave = self._slaves[component.name]
            own = [element for element in self._names if element[0] == component.name]
            fed = [into for into in wiring.sources if into[0] == component.name]
            start = place[own[0]] if own else 0
            values = self._values[start : start + len(own)]
            self._stations.append(
                _Station(
                    slave=slave,
                    every=self.spec.every(component),
                    inputs=slave.batch([variable for _, variable in fed]),
                    sources=np.array([place[wiring.sources[into]] for into in fed], dtype=np.intp),
                    outputs=slave.batch([variable for _, variable in own], values),
                )
            )
        self._rows = np.array([place[e] for e in wiring.observed], dtype=np.intp)
        self._limited = np.array([place[e] for e, _ in wiring.limited], dtype=np.intp)
        self._low, self._high = np.array([b for _, b in wiring.limited]).reshape(-1, 2).T

    def run(
        self,
        progress: Progress = unheard,
        *,
        start: Mapping[str, Mapping[str, Value]] | None = None,
    ) -> Result:
        """Run the system from its start values; a failure ends the run and stands in the result.

        A system can be run again and again: each run begins with a reset.

        Parameters
        ----------
        progress : told how far the run has come.
        start : start values of components for this run, beside those of the system.
        """
        steps, step, values = self.spec.steps, self.spec.step, self._values
        kept = np.empty((steps + 1, len(self._rows)))
        advance = self._gauss_seidel if self.spec.order == "gauss_seidel" else self._jacobi
        done, failure = 0, None
        try:
            self._initialise(start or {})
            for k in range(steps + 1):
                if k > 0:
                    advance(k - 1)
                if values.dot(self._zeros) != 0.0:  # infinity and NaN times zero are NaN
                    break
                values.take(self._rows, out=kept[k], mode="clip")
                done = k + 1
                if self._limited.size:
                    self._require_limits(k * step)
                if k % _TELL_EVERY == 0:
                    progress(k, steps)
        except SimulationError as error:
            failure = error
        # Where one component gives what is no number, another may be the one that complains.
        failure = self._not_finite(done * step) or failure
        progress(steps, steps)
        signals = {".".join(e): kept[:done, i] for i, e in enumerate(self._wiring.observed)}
        return Result(t=step * np.arange(done, dtype=float), signals=signals, failure=failure)

    def _initialise(self, more: Mapping[str, Mapping[str, Value]]) -> None:
        self._values[:] = 0.0
        for component, station in zip(self.spec.components, self._stations, strict=True):
            if station.slave.used:
                station.slave.reset()
            own = station.slave.variables.expanded(more.get(component.name, {}))
            start = self._wiring.start[component.name] | own
            station.slave.enter_initialisation(time=0.0, stop=self.spec.stop, start=start)
        self._propagate()
        for station in self._stations:
            station.slave.exit_initialisation()
        for station in self._stations:
            station.read_outputs()

    def _propagate(self) -> None:
        """Set each connected input to what feeds it, in the order in which values become known.

        Outputs may depend on more at the start than later; by repetition that settles, too.
        """
        order, sources = self._wiring.order, self._wiring.sources
        feeding = set(sources.values())
        known: dict[Element, float] = {}
        for _ in order:
            before = dict(known)
            for element in order:
                name, variable = element
                if element in sources:
                    self._slaves[name].set({variable: known[sources[element]]})
                elif element in feeding:
                    known[element] = float(self._slaves[name].get([variable])[0])
                    if not np.isfinite(known[element]):
                        raise SimulationError(_not_a_number(element, 0.0))
            if known == before:
                break

    def _gauss_seidel(self, k: int) -> None:
        """Step each component that reaches a communication point of its own at the end of step k.

        It is given the newest outputs of all others.
        """
        values, step = self._values, self.spec.step
        for station in self._stations:
            if (k + 1) % station.every == 0:
                station.set_inputs(values)
                station.step(k, step)
                station.read_outputs()

    def _jacobi(self, k: int) -> None:
        """Do the same with the outputs of the instant at which the component's step begins."""
        values, step = self._values, self.spec.step
        for station in self._stations:
            if k % station.every == 0:
                station.set_inputs(values)
        ending = [s for s in self._stations if (k + 1) % s.every == 0]
        for station in ending:
            station.step(k, step)
        for station in ending:
            station.read_outputs()

    def _not_finite(self, time: float) -> SimulationError | None:
        finite = np.isfinite(self._values)
        if finite.all():
            return None
        return SimulationError(_not_a_number(self._names[int(np.argmin(finite))], time))

    def _require_limits(self, time: float) -> None:
        values = self._values.take(self._limited, mode="clip")
        outside = (values < self._low) | (values > self._high)
        if np.count_nonzero(outside):
            i = int(np.argmax(outside))
            name = ".".join(self._names[self._limited[i]])
            raise SimulationError(
                f"at t = {time:.9g} s {name} is {values[i]:.6g}, outside its limits "
                f"{self._low[i]:.6g} to {self._high[i]:.6g}."
            )


def _not_a_number(element: Element, time: float) -> str:
    return f"at t = {time:.9g} s {'.'.join(element)} is not a finite number."


def simulate(spec: SystemSpec, path: Path, progress: Progress = unheard) -> Result:
    """Load a system, run it once and free it."""
    with Master(spec, path) as master:
        return master.run(progress)
