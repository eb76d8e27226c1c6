"""Reference couplings of FMUs as engines perform them, each in a few lines."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fmu_src.run.fmu import FmuInstance
from fmu_src.run.master import Element
from hesr.extras.ssp.contents import SystemContents

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Slaves:
    """The FMUs of a system, loaded."""

    contents: SystemContents
    slaves: dict[str, FmuInstance]

    def start(self, between: Callable[[], None] = lambda: None) -> None:
        """Initialise all FMUs; call `between` inside initialisation mode."""
        for name, slave in self.slaves.items():
            slave.enter_initialisation(start=self.contents.wiring.start[name])
        between()
        for slave in self.slaves.values():
            slave.exit_initialisation()

    def step(self, k: int) -> None:
        """Step all FMUs."""
        step = self.contents.system.step
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
            for c in contents.system.components
        }
        yield Slaves(contents=contents, slaves=slaves)


def delayed(contents: SystemContents, observed: list[Element], steps: int) -> Array:
    """Use the outputs of the previous step as inputs, zero in the first: FMPy's SSP runner.

    Nothing is passed on during initialisation. Returns the observed values after each step.
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
    """Largest difference of a signal relative to its largest value."""
    return float((np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)).max())
