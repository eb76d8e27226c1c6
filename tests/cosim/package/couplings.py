"""How engines couple FMUs, each in a few lines, as the reference that they are compared with."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cosim.systems.contents import SystemContents
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.master import Element

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Slaves:
    """The FMUs of a system, loaded."""

    contents: SystemContents
    slaves: dict[str, FmuInstance]

    def start(self, between: Callable[[], None] = lambda: None) -> None:
        """Initialise all; `between` is called in the middle of it."""
        for name, slave in self.slaves.items():
            slave.enter_initialisation(start=self.contents.wiring.start[name])
        between()
        for slave in self.slaves.values():
            slave.exit_initialisation()

    def step(self, k: int) -> None:
        """Step all of them."""
        step = self.contents.spec.step
        for slave in self.slaves.values():
            slave.step(k * step, step)

    def get(self, element: Element) -> float:
        return float(self.slaves[element[0]].get([element[1]])[0])

    def set(self, element: Element, value: float) -> None:
        self.slaves[element[0]].set({element[1]: value})


@contextmanager
def loaded(contents: SystemContents) -> Iterator[Slaves]:
    with ExitStack() as cleanup:
        slaves = {
            c.name: cleanup.enter_context(FmuInstance(c.fmu, name=c.name))
            for c in contents.spec.components
        }
        yield Slaves(contents=contents, slaves=slaves)


def refreshed(contents: SystemContents, observed: list[Element], steps: int) -> Array:
    """Step all, then pass values on in the order in which they become known: FMPy's container.

    What a step gives is read only after all that is passed on before, so an output with direct
    feedthrough is that of the newest inputs. Returns the observed values at each instant.
    """
    sources = contents.wiring.sources
    with loaded(contents) as slaves:

        def pass_on() -> None:
            for element in contents.wiring.order:
                if element in sources:
                    slaves.set(element, slaves.get(sources[element]))

        slaves.start(pass_on)
        rows = [[slaves.get(element) for element in observed]]
        for k in range(steps):
            slaves.step(k)
            pass_on()
            rows.append([slaves.get(element) for element in observed])
    return np.array(rows)


def delayed(contents: SystemContents, observed: list[Element], steps: int) -> Array:
    """Inputs are the outputs of the step before, zero in the first step: FMPy's SSP runner.

    Nothing is passed on in the initialisation. Returns the observed values after each step.
    """
    sources = contents.wiring.sources
    with loaded(contents) as slaves:
        slaves.start()
        inputs = dict.fromkeys(sources, 0.0)
        rows = []
        for k in range(steps):
            for element, value in inputs.items():
                slaves.set(element, value)
            slaves.step(k)
            inputs = {element: slaves.get(source) for element, source in sources.items()}
            rows.append([slaves.get(element) for element in observed])
    return np.array(rows)


def error(found: Array, expected: Array) -> float:
    """Largest difference of a signal, relative to the largest that it is."""
    return float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())
