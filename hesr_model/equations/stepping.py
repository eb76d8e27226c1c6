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
        observed_names = (
            [equation.name for equation in component.outputs]
            if observed is None
            else list(observed)
        )
        self.observed = tuple(observed_names)
        self.component = component
        given_symbols = [quantity.symbol for quantity in component.given]
        states = [element.state for element in component.memory]
        observed_symbols = [sympy.Symbol(name, real=True) for name in observed_names]
        remembered = [equation.symbol for equation in component.remembered]
        previous_symbols = [previous(equation.name) for equation in component.remembered]
        initial_symbols = [program.initial_symbol(element) for element in component.memory]
        moved_symbols = [program.moved_symbol(element) for element in component.memory]
        step_assignments = program.build_step(component) | {EULER: sympy.Integer(0)}
        compile_function = partial(_compile_assignments, lanes=lanes)
        self.settle = compile_function(
            (given_symbols, states), program.build_initial_states(component), (initial_symbols,)
        )
        self.begin = compile_function(
            (given_symbols, states),
            program.first_readings(component),
            (observed_symbols, remembered),
        )
        self.step = compile_function(
            (given_symbols, states, previous_symbols, (DT,)),
            step_assignments,
            (observed_symbols, remembered, moved_symbols),
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
        rows = zip(
            np.diff(t).tolist(),
            *(column[1:].tolist() for column in input_columns.values()),
            strict=True,
        )
        samples = [run.begin(*first_inputs)]
        samples += [run.step(dt, *row) for dt, *row in rows]
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
            # Scalars of NumPy are slow.
            self._values[place] = value if isinstance(value, np.ndarray) else float(value)

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
    lines, names = program.build_straight_line(
        assignments, [target for group in targets for target in group]
    )
    short_symbols = {symbol: sympy.Symbol(name) for symbol, name in names.items()}
    lines = {
        short_symbols.get(symbol, symbol): expression.xreplace(short_symbols)
        for symbol, expression in lines.items()
    }
    target_symbols = [[short_symbols[symbol] for symbol in group] for group in targets]
    return sympy.lambdify(
        [list(group) for group in arguments],
        target_symbols,
        modules=[dict(NUMPY), "numpy"] if lanes else [dict(SCALAR), "math"],
        cse=lambda _: (list(lines.items()), target_symbols),
    )
