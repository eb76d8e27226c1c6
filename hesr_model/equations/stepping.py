"""Components with previous values, run step by step in Python in the order of `c/equations.c`."""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
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
        if observed is None:
            observed = [equation.name for equation in component.outputs]
        self.observed = tuple(observed)
        self.component = component
        given_symbols = [quantity.symbol for quantity in component.given]
        states = [element.state for element in component.memory]
        observed_symbols = [sympy.Symbol(name, real=True) for name in self.observed]
        remembered = [equation.symbol for equation in component.remembered]
        previous_symbols = [previous(equation.name) for equation in component.remembered]
        initial_symbols = [program.initial_symbol(element) for element in component.memory]
        moved_symbols = [program.moved_symbol(element) for element in component.memory]
        step_assignments = program.build_step(component) | {EULER: sympy.Integer(0)}
        self.settle = _compile_assignments(
            (given_symbols, states),
            program.build_initial_states(component),
            (initial_symbols,),
            lanes=lanes,
        )
        self.begin = _compile_assignments(
            (given_symbols, states),
            program.first_readings(component),
            (observed_symbols, remembered),
            lanes=lanes,
        )
        self.step = _compile_assignments(
            (given_symbols, states, previous_symbols, (DT,)),
            step_assignments,
            (observed_symbols, remembered, moved_symbols),
            lanes=lanes,
        )

    def run(
        self, values: Mapping[str, float], start: Sequence[float], inputs: Sequence[str]
    ) -> "ComponentRun":
        """Return a run with values of parameters and constant inputs, and each state's start."""
        return ComponentRun(self, values, start, inputs)

    def simulate(
        self,
        t: Array,
        columns: Mapping[str, Array],
        values: Mapping[str, float],
        start: Sequence[float],
        *,
        settled: bool = True,
    ) -> Array:
        """Return the observed equations (observed, N); if `settled`, row 0 settles the states."""
        input_columns = {
            quantity.name: columns[quantity.name]
            for quantity in self.component.inputs
            if quantity.name in columns
        }
        run = self.run(values, start, list(input_columns))
        first_inputs = [float(column[0]) for column in input_columns.values()]
        if settled:
            run.settle(*first_inputs)
        steps = np.diff(t).tolist()
        later_inputs = [column[1:].tolist() for column in input_columns.values()]
        samples = [run.begin(*first_inputs)]
        for dt, *inputs in zip(steps, *later_inputs, strict=True):
            samples.append(run.step(dt, *inputs))
        return np.array(samples).T


class ComponentRun:
    """Running component with memory `states` and `remembered`."""

    def __init__(
        self,
        steps: Steps,
        values: Mapping[str, float],
        start: Sequence[float],
        inputs: Sequence[str],
    ) -> None:
        names = [quantity.name for quantity in steps.component.given]
        self._steps = steps
        self._values: list[Any] = [float(values.get(name, 0.0)) for name in names]
        self._input_indices = [names.index(name) for name in inputs]
        self.states: Sequence[float] = list(start)
        self.remembered: Sequence[float] = []

    def _set_inputs(self, inputs: Sequence[float]) -> None:
        for place, value in zip(self._input_indices, inputs, strict=True):
            if isinstance(value, np.ndarray):
                self._values[place] = value
            else:
                self._values[place] = float(value)  # scalars of NumPy are slow

    def settle(self, *inputs: float) -> None:
        """Settle the initial states for the first inputs."""
        self._set_inputs(inputs)
        [self.states] = self._steps.settle(self._values, self.states)

    def begin(self, *inputs: float) -> Sequence[float]:
        """Return the observed equations before the first step."""
        self._set_inputs(inputs)
        observed_values: Sequence[float]
        observed_values, self.remembered = self._steps.begin(self._values, self.states)
        return observed_values

    def step(self, dt: float, *inputs: float) -> Sequence[float]:
        """Hold the inputs over dt [s] and return the observed equations at its end."""
        self._set_inputs(inputs)
        observed_values: Sequence[float]
        observed_values, self.remembered, self.states = self._steps.step(
            self._values, self.states, self.remembered, (float(dt),)
        )
        return observed_values


def numpy_function(
    arguments: Sequence[sympy.Symbol],
    assignments: program.Assignments,
    targets: Sequence[sympy.Symbol],
) -> Callable[..., Sequence[Array]]:
    """Return a NumPy function of `arguments` for the targets of a program.

    It keeps the assignments as statements, hence their order of operations.
    """
    evaluate = _compile_assignments([arguments], assignments, [targets], lanes=True)

    def evaluate_targets(*values: ArrayLike) -> Sequence[Array]:
        results: Sequence[Array]
        [results] = evaluate(values)
        return results

    return evaluate_targets


def _compile_assignments(
    arguments: Sequence[Sequence[sympy.Symbol]],
    assignments: program.Assignments,
    targets: Sequence[Sequence[sympy.Symbol]],
    *,
    lanes: bool,
) -> Any:
    """Return a function of groups of arguments that returns groups of targets."""
    lines, names = program.build_straight_line(assignments, list(chain.from_iterable(targets)))
    short_symbols = {symbol: sympy.Symbol(name) for symbol, name in names.items()}
    lines = {
        short_symbols.get(symbol, symbol): expression.xreplace(short_symbols)
        for symbol, expression in lines.items()
    }

    def shorten(symbols: Sequence[sympy.Symbol]) -> list[sympy.Symbol]:
        return [short_symbols[symbol] for symbol in symbols]

    target_symbols = list(map(shorten, targets))
    modules: list[Any] = [dict(SCALAR), "math"]
    if lanes:
        modules = [dict(NUMPY), "numpy"]
    return sympy.lambdify(
        [list(group) for group in arguments],
        target_symbols,
        modules=modules,
        cse=lambda _: (list(lines.items()), target_symbols),
    )
