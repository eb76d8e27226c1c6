"""Fixed-step master of a system of FMUs, and systems read from their files."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import KW_ONLY, dataclass
from functools import partial, reduce
from pathlib import Path
from typing import Any, Self
from weakref import finalize

import numpy as np

from cosim.systems.sampled_inputs import SampledInputs
from cosim.systems.signals import Signals
from cosim.systems.system import ComponentSpec, SystemSpec, Value, open_system
from cosim.systems.wiring import Wiring
from fmu_src.arm.clock import stop_clock
from fmu_src.run.fmu import SECONDS, FmuInstance, FmuPool, build_mixed_buffer, text_from_number
from fmu_src.run.instance import Buffer
from fmu_src.run.master import (
    Convert,
    Element,
    ExchangeScheme,
    Layout,
    Link,
    PythonStepper,
    Station,
)
from fmu_src.run.native import NativeStepper, native_stepper
from fmu_src.run.sandbox import SandboxStepper, SystemSandbox, sandbox_stepper
from hesr_model.errors import ConfigError, SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.files import PathArg, to_path
from hesr_model.support.progress import Progress, silent


@dataclass(frozen=True, repr=False)
class System:
    """A system of FMUs: components, start values, connections and steps.

    Examples
    --------
    >>> import hesr
    >>> system = hesr.System.read("loop.toml")
    >>> float(system.run().t[0])
    0.0
    """

    spec: SystemSpec  #: content of the file
    path: Path  #: file of the system, for messages

    @classmethod
    def read(cls, path: PathArg) -> Self:
        """Read a system from TOML or SSP; FMUs of an SSP stay unpacked while the system exists.

        Parameters
        ----------
        path : path
            System (.toml) or SSP (.ssp) of any tool.

        Raises
        ------
        ArtifactError
            If an SSP cannot be read, or is not safe to unpack.
        ConfigError
            If the system is invalid or not supported, naming the file and the
            key or element.
        SimulationError
            If an FMU in an SSP cannot be read and its units are needed.
        """
        file = to_path(path, "a system")
        with ExitStack() as opened:
            system = cls(opened.enter_context(open_system(file)), file)
            finalize(system, opened.pop_all().close)
        return system

    def __repr__(self) -> str:
        system = self.spec
        return (
            f"System('{system.name}', {len(system.components)} components, {system.stop:g} s in "
            f"steps of {system.step:g} s)"
        )

    def run(self, progress: Progress = silent) -> Signals:
        """Load the FMUs, run the system once and free them.

        Parameters
        ----------
        progress : callable, optional
            Called with steps done and steps in total.

        Returns
        -------
        Signals
            Observed signals over time [s].

        Raises
        ------
        ConfigError
            If the system does not fit its FMUs.
        SimulationError
            If an FMU cannot be loaded or fails.
        """
        with Master(self.spec, self.path) as master:
            return master.run(progress).require_success()


_REPORT_EVERY = 200  # steps between reports of progress


@dataclass(eq=False)
class Master:
    """A loaded and checked system; a context manager that frees all FMUs.

    All untrusted FMUs share a sandbox, or have one each if `isolate` is true. It steps in C if all
    FMUs are in one process and `native` is true; the results are equal. Entering raises ConfigError
    (see `Wiring`).
    """

    system: SystemSpec
    path: Path = Path("system")  # for messages
    _: KW_ONLY
    native: bool = True
    isolate: bool = False
    loaded: FmuPool | None = None
    scheme: ExchangeScheme | None = None  # default: that of the system
    source: SampledInputs | None = None  # gives inputs; it is a component of the system
    times: Array | None = None  # (steps + 1,) [s] communication points that are not evenly spaced
    exchange: bool = False  # whether FMUs for model exchange alone get a solver
    single: bool = False  # whether signals are named as in their only FMU

    def __post_init__(self) -> None:
        self._scheme = self.scheme or ExchangeScheme(order=self.system.order)
        self._cleanup = ExitStack()

    def __enter__(self) -> "Master":
        with ExitStack() as cleanup:
            lend: Callable[..., AbstractContextManager[FmuInstance]]
            lend = partial(FmuInstance, exchange=self.exchange)
            if self.loaded:
                lend = self.loaded.lend
            sandbox = None
            if not self.isolate:
                sandbox = cleanup.enter_context(SystemSandbox(SECONDS))
            self._slaves = {
                component.name: cleanup.enter_context(
                    lend(component.fmu, name=component.name, system=sandbox)
                )
                for component in self.system.components
            }
            variables = {name: instance.variables for name, instance in self._slaves.items()}
            if self.source:
                variables[self.source.name] = self.source.variables
            self._wiring = Wiring(self.system, variables, self.path)
            self._build()
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(self, *ended: Any) -> None:
        self._cleanup.__exit__(*ended)

    def _build(self) -> None:
        wiring = self._wiring
        layout_elements = [
            *wiring.sources.values(),
            *wiring.observed,
            *(element for element, _ in wiring.limited),
        ]
        order = [*self._slaves]
        if self.source:
            order.append(self.source.name)
        names = sorted(dict.fromkeys(layout_elements), key=lambda element: order.index(element[0]))
        indices = {element: i for i, element in enumerate(names)}
        values = np.zeros(len(indices))
        stations = [
            self._component_station(component, indices, values)
            for component in self.system.components
        ]
        if self.source:
            stations.append(self._source_station(self.source, names, values))
        lower, upper = np.array([bounds for _, bounds in wiring.limited]).reshape(-1, 2).T
        self._layout = Layout(
            stations=tuple(stations),
            links=tuple(self._build_links(indices)),
            scheme=self._scheme,
            begin=self.system.begin,
            step=self.system.step,
            values=values,
            names=tuple(names),
            rows=np.array([indices[e] for e in wiring.observed], dtype=np.intp),
            limited=np.array([indices[e] for e, _ in wiring.limited], dtype=np.intp),
            low=lower,
            high=upper,
            times=self.times,
        )
        layout = self._layout
        native = None
        if self.native:
            native = native_stepper(layout) or sandbox_stepper(layout)
        self._stepper: PythonStepper | NativeStepper | SandboxStepper
        self._stepper = native or PythonStepper(layout)

    def _component_station(
        self, component: ComponentSpec, indices: Mapping[Element, int], values: Array
    ) -> Station:
        """Return the station of an FMU, whose outputs are next to each other in `values` (n,)."""
        instance = self._slaves[component.name]
        output_names = [variable for name, variable in indices if name == component.name]
        output_values = values[:0]
        if output_names:
            start = indices[component.name, output_names[0]]
            output_values = values[start : start + len(output_names)]
        input_names: list[str] = []
        source_indices = []
        conversions = []
        for target, source in self._wiring.sources.items():
            if target[0] != component.name:
                continue
            convert = self._build_conversion(target)
            if convert is not None:
                conversions.append((len(input_names), convert))
            input_names.append(target[1])
            source_indices.append(indices[source])
        return Station(
            slave=instance,
            every=self.system.find_step_multiple(component),
            inputs=build_mixed_buffer(instance, input_names),
            sources=np.array(source_indices, dtype=np.intp),
            outputs=build_mixed_buffer(instance, output_names, output_values),
            begin=self.system.begin,
            conversions=conversions,
        )

    def _source_station(
        self, source: SampledInputs, names: Sequence[Element], values: Array
    ) -> Station:
        """Return the last station, so that the FMUs step with the inputs of a step's beginning."""
        places = [i for i, (name, _) in enumerate(names) if name == source.name]
        part = values[:0]
        if places:
            part = values[places[0] : places[-1] + 1]
        return Station(
            slave=source,
            every=1,
            inputs=source.buffer([], np.zeros(0)),
            sources=np.array([], dtype=np.intp),
            outputs=source.buffer([names[i][1] for i in places], part),
            begin=self.system.begin,
        )

    def _buffer(self, name: str, variables: Sequence[str]) -> Buffer:
        if self.source and name == self.source.name:
            return self.source.buffer(variables, np.zeros(len(variables)))
        return build_mixed_buffer(self._slaves[name], variables)

    def _build_conversion(self, target: Element) -> Convert | None:
        steps = self.system.conversions.get(".".join(target), ())
        if not steps:
            return None
        return partial(reduce, lambda value, step: step(value), steps)

    def _build_links(self, indices: Mapping[Element, int]) -> Iterator[Link]:
        sources = self._wiring.sources
        feeding = set(sources.values())
        for element in self._wiring.order:
            if element in sources or element in feeding:
                name, variable = element
                yield Link(
                    buffer=self._buffer(name, [variable]),
                    place=indices[sources.get(element, element)],
                    is_input=element in sources,
                    convert=self._build_conversion(element),
                )

    def run(
        self, progress: Progress = silent, *, start: Mapping[str, Mapping[str, Value]] | None = None
    ) -> Signals:
        """Run the system after a reset; a failure ends the run and is part of the result.

        `start` adds start values of components to those of the system.
        """
        steps = self.system.steps
        step_size = self.system.step
        stepper = self._stepper
        recorded = np.empty((steps + 1, len(self._layout.rows)))
        failure = None
        stepper.begin(recorded)
        try:
            self._initialise(start or {})
            with stop_clock():
                for k in range(0, steps + 1, _REPORT_EVERY):
                    progress(k, steps)
                    stepper.advance(stop := min(k + _REPORT_EVERY, steps + 1))
                    if stepper.done < stop:
                        break
        except SimulationError as error:
            failure = error
        done = stepper.done
        finite = np.isfinite(self._layout.values)
        if not finite.all():
            # a NaN may make another component fail
            end_time = self._layout.time(min(done, steps))
            failure = self._layout.non_finite_error(int(np.argmin(finite)), end_time)
        progress(steps, steps)
        signals = {
            self._signal_name(e): self._convert_type(e, recorded[:done, i])
            for i, e in enumerate(self._wiring.observed)
        }
        for name, output in self.system.outputs.items():
            values = signals[output.signal]
            for convert in output.conversions:
                values = np.array([convert(value) for value in values.tolist()])
            signals.setdefault(name, values)
        if self.times is None:
            t = self.system.begin + step_size * np.arange(done, dtype=float)
        else:
            t = self.times[:done]
        return Signals(t=t, signals=signals, failure=failure)

    def _signal_name(self, element: Element) -> str:
        if self.single:
            return element[1]
        return ".".join(element)

    def _convert_type(self, element: Element, values: Array) -> Array:
        kind = self._slaves[element[0]].variables[element[1]].type
        if kind == "String":
            return np.array([text_from_number(value) for value in values])
        if kind in ("Real", "Float32"):
            return values
        if kind == "Boolean":
            return values.astype(bool)
        return values.astype(np.int64)

    def require_start(self, start: Mapping[str, Mapping[str, Value]], path: Path) -> None:
        """Raise ConfigError, naming `path`, if start values do not fit the system."""
        try:
            self._wiring.merge_start_values(start)
        except ConfigError as error:
            raise error.add_place(path) from error
        for name, values in start.items():
            variables = self._slaves[name].variables
            for variable in variables.expand_values(values):
                if variables[variable].causality in ("output", "local", "independent"):
                    raise ConfigError(
                        f"{path}: '{name}.{variable}' cannot be varied: its FMU calculates it.",
                        code="system.calculated",
                        where=path,
                        key=f"{name}.{variable}",
                    )

    def require_same_size(self, measured: str, reference: str, path: Path) -> None:
        """Raise ConfigError, naming `path`, if two signals differ in size."""
        counts = [len(self._wiring.elements(signal)) for signal in (measured, reference)]
        if counts[0] != counts[1]:
            raise ConfigError(
                f"{path}: '{measured}' has {counts[0]} elements and its reference '{reference}' "
                f"{counts[1]}.",
                code="system.reference",
                where=path,
                key=measured,
            )

    def _initialise(self, extra_start: Mapping[str, Mapping[str, Value]]) -> None:
        self._layout.values[:] = 0.0
        if self.source:
            self.source.begin(self._slaves)
        for name, instance in self._slaves.items():
            if instance.used:
                instance.reset()
            start = self._wiring.start[name] | instance.variables.expand_values(
                extra_start.get(name, {})
            )
            instance.enter_initialisation(
                time=self.system.begin, stop=self.system.stop, start=start
            )
        if self._scheme.first == "propagated":
            previous_values = None
            for _ in self._wiring.order:
                self._layout.propagate(self.system.begin)
                if previous_values is not None and np.array_equal(
                    previous_values, self._layout.values
                ):
                    break
                previous_values = self._layout.values.copy()
        for instance in self._slaves.values():
            instance.exit_initialisation()
        for station in self._layout.stations:
            station.read_outputs()
        if self._scheme.first == "zero":
            self._layout.values.fill(0.0)
