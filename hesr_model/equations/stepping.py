"""Components with previous values, run step by step in Python in the order of `c/equations.c`."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import sympy
from numpy.typing import ArrayLike

from hesr_model.equations import program
from hesr_model.equations.component import Component, previous
from hesr_model.equations.functions import NUMPY, SCALAR
from hesr_model.equations.memory import DT, EULER
from hesr_model.support.arrays import Array


class Steps:
    """Functions of numbers, or of arrays of parallel runs (`lanes`), that step a component."""

    def __init__(
        self, component: Component, observed: Sequence[str] | None = None, *, lanes: bool = False
    ) -> None:
        own = (
            [equation.name for equation in component.outputs]
            if observed is None
            else list(observed)
        )
        self.observed = tuple(own)
        self.component = component
        given = [quantity.symbol for quantity in component.given]
        states = [element.state for element in component.memory]
        seen = [sympy.Symbol(name, real=True) for name in own]
        remembered = [equation.symbol for equation in component.remembered]
        before = [previous(equation.name) for equation in component.remembered]
        begun = [program.initial_symbol(element) for element in component.memory]
        moved = [program.moved(element) for element in component.memory]
        sampled = program.sampled(component) | {EULER: sympy.Integer(0)}
        lowered = partial(_function, lanes=lanes)
        self.settle = lowered((given, states), program.beginning(component), (begun,))
        self.begin = lowered((given, states), program.first_readings(component), (seen, remembered))
        self.step = lowered((given, states, before, (DT,)), sampled, (seen, remembered, moved))

    def run(
        self, values: Mapping[str, float], start: Sequence[float], inputs: Sequence[str]
    ) -> "ComponentRun":
        """Return a run with values of parameters and constant inputs, and each state's start."""
        return ComponentRun(self, values, start, inputs)

    def over(
        self,
        t: Array,
        columns: Mapping[str, Array],
        values: Mapping[str, float],
        start: Sequence[float],
        *,
        settled: bool = True,
    ) -> Array:
        """Return the observed equations (observed, N); if `settled`, row 0 settles the states."""
        used = {
            quantity.name: columns[quantity.name]
            for quantity in self.component.inputs
            if quantity.name in columns
        }
        run = self.run(values, start, list(used))
        first = [float(c[0]) for c in used.values()]
        if settled:
            run.settle(*first)
        rows = zip(np.diff(t).tolist(), *(c[1:].tolist() for c in used.values()), strict=True)
        found = [run.begin(*first)]
        found += [run.step(dt, *row) for dt, *row in rows]
        return np.array(found).T


class ComponentRun:
    """Running component with memory `states` and `remembered`."""

    def __init__(
        self,
        steps: Steps,
        values: Mapping[str, float],
        states: Sequence[float],
        inputs: Sequence[str],
    ) -> None:
        names = [quantity.name for quantity in steps.component.given]
        self._steps = steps
        self._given: list[Any] = [float(values.get(name, 0.0)) for name in names]
        self._places = [names.index(name) for name in inputs]
        self.states: Sequence[float] = list(states)
        self.remembered: Sequence[float] = []

    def _set(self, inputs: Sequence[float]) -> None:
        for place, value in zip(self._places, inputs, strict=True):
            # Scalars of NumPy are slow.
            self._given[place] = value if isinstance(value, np.ndarray) else float(value)

    def settle(self, *inputs: float) -> None:
        """Settle the initial states for the first inputs."""
        self._set(inputs)
        [self.states] = self._steps.settle(self._given, self.states)

    def begin(self, *inputs: float) -> Sequence[float]:
        """Return the observed equations before the first step."""
        self._set(inputs)
        seen, self.remembered = self._steps.begin(self._given, self.states)
        return seen  # type: ignore[no-any-return]

    def step(self, dt: float, *inputs: float) -> Sequence[float]:
        """Hold the inputs over dt [s] and return the observed equations at its end."""
        self._set(inputs)
        seen, self.remembered, self.states = self._steps.step(
            self._given, self.states, self.remembered, (float(dt),)
        )
        return seen  # type: ignore[no-any-return]


def numpy_function(
    arguments: Sequence[sympy.Symbol],
    assignments: program.Assignments,
    targets: Sequence[sympy.Symbol],
) -> Callable[..., Sequence[Array]]:
    """Return a NumPy function of `arguments` for the targets of a program.

    It keeps the assignments as statements, hence their order of operations.
    """
    evaluate = _function([arguments], assignments, [targets], lanes=True)

    def evaluate_targets(*values: ArrayLike) -> Sequence[Array]:
        [results] = evaluate(values)
        return results  # type: ignore[no-any-return]

    return evaluate_targets


def _function(
    arguments: Sequence[Sequence[sympy.Symbol]],
    assignments: program.Assignments,
    targets: Sequence[Sequence[sympy.Symbol]],
    *,
    lanes: bool,
) -> Any:
    lines, names = program.straight_line(assignments, [s for group in targets for s in group])
    short = {symbol: sympy.Symbol(name) for symbol, name in names.items()}
    lines = {short.get(symbol, symbol): e.xreplace(short) for symbol, e in lines.items()}
    wanted = [[short[symbol] for symbol in group] for group in targets]
    return sympy.lambdify(
        [list(group) for group in arguments],
        wanted,
        modules=[dict(NUMPY), "numpy"] if lanes else [dict(SCALAR), "math"],
        cse=lambda _: (list(lines.items()), wanted),
    )
