"""What an engine should give: the same FMUs, run by us in the engine's way of coupling."""

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from cosim.interop.case import Alone, Together
from cosim.systems.wiring import Element, Wiring
from fmu_src.run.fmu import Component
from fmu_src.run.native import through
from hesr_model.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """How an engine passes values on.

    All engines here step all FMUs with inputs of the instant at which the step begins (Jacobi).

    Attributes
    ----------
    first : inputs of the first step: outputs that were "propagated" while the FMUs were
        initialised, or "zero".
    refreshed : which outputs, where they depend on inputs directly, follow the new inputs of an
        instant: "none", those that are "shown", or those that are passed on, too ("all").
    """

    first: Literal["propagated", "zero"] = "propagated"
    refreshed: Literal["none", "shown", "all"] = "none"

    def __str__(self) -> str:
        """For tables."""
        parts = ["Jacobi"]
        if self.first == "zero":
            parts.append("first inputs zero")
        if self.refreshed != "none":
            parts.append("outputs of new inputs" + " shown" * (self.refreshed == "shown"))
        return ", ".join(parts)


def alone(case: Alone) -> dict[str, Array]:
    """Return the outputs of one FMU, (steps + 1,) each in its unit."""
    found = np.empty((case.steps + 1, len(case.outputs)))
    with Component(case.fmu) as component:
        inputs, outputs = component.batch(list(case.inputs)), component.batch(list(case.outputs))
        rows = np.column_stack([*case.inputs.values(), np.zeros(case.steps + 1)])[:, :-1]
        inputs.values[:] = rows[0]
        component.initialise(stop=case.stop, start=case.start, inputs=inputs)
        found[0] = outputs.read()
        times, sizes = case.times[:-1], np.full(case.steps, case.step)
        found[1:] = through(component, inputs, outputs, times, sizes, rows[:-1])
    return dict(zip(case.outputs, found.T, strict=True))


def together(case: Together, coupling: Coupling) -> dict[str, Array]:
    """Return the signals of a system, (steps + 1,) each in its unit."""
    with ExitStack() as cleanup:
        slaves = {
            c.name: cleanup.enter_context(Component(c.fmu, name=c.name))
            for c in case.spec.components
        }
        return _System(case, coupling, slaves).run()


class _System:
    """The FMUs of a case, coupled."""

    def __init__(self, case: Together, coupling: Coupling, slaves: Mapping[str, Component]) -> None:
        self._case, self._coupling, self._slaves = case, coupling, slaves
        parts = (signal.partition(".") for signal in case.signals)
        self._signals: list[Element] = [(name, variable) for name, _, variable in parts]
        self._values: dict[Element, float] = {}
        variables = {name: slave.variables for name, slave in slaves.items()}
        self._wiring = Wiring(case.spec, variables, Path(case.spec.name))

    def run(self) -> dict[str, Array]:
        """Return the signals, one value more than there are steps."""
        spec, shown = self._case.spec, [self._initialise()]
        for k in range(spec.steps):
            for name, slave in self._slaves.items():
                self._feed(name)
                slave.step(k * spec.step, spec.step)
            for name in self._slaves:
                self._read(name)
            shown.append(self._refresh())
        return dict(zip(self._case.signals, np.array(shown).T, strict=True))

    def _initialise(self) -> list[float]:
        spec, wiring = self._case.spec, self._wiring
        for name, slave in self._slaves.items():
            slave.enter_initialisation(stop=spec.stop, start=wiring.start[name])
        propagated = self._coupling.first == "propagated"
        if propagated:
            for _ in self._slaves:
                self._pass_on()
        for name, slave in self._slaves.items():
            slave.exit_initialisation()
            self._read(name)
        if not propagated:
            self._values = dict.fromkeys(self._values, 0.0)
        return self._refresh()

    def _outputs(self, name: str) -> list[str]:
        wanted = (*self._wiring.sources.values(), *self._signals)
        return [variable for owner, variable in dict.fromkeys(wanted) if owner == name]

    def _read(self, name: str) -> None:
        outputs = self._outputs(name)
        for variable, value in zip(outputs, self._slaves[name].get(outputs), strict=True):
            self._values[name, variable] = float(value)

    def _feed(self, name: str) -> None:
        sources: Mapping[Element, Element] = self._wiring.sources
        fed = {v: self._values[out] for (owner, v), out in sources.items() if owner == name}
        self._slaves[name].set(fed)

    def _pass_on(self) -> None:
        """Set inputs and read outputs in the order in which values become known."""
        sources = self._wiring.sources
        for element in self._wiring.order:
            name, variable = element
            if element in sources:
                self._slaves[name].set({variable: self._values[sources[element]]})
            elif variable in self._outputs(name):
                self._values[element] = float(self._slaves[name].get([variable])[0])

    def _refresh(self) -> list[float]:
        """Return the signals as the engine shows them now."""
        if self._coupling.refreshed == "all":
            self._pass_on()
        values = dict(self._values)
        if self._coupling.refreshed == "shown":
            for name in self._slaves:
                self._feed(name)
            for name in self._slaves:
                self._read(name)
            values, self._values = self._values, values
        return [values[signal] for signal in self._signals]
