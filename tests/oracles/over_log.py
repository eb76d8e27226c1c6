"""Laws over logs in NumPy: reference for `rows.c`.

Relaxations compose to relaxations, so a log runs without a Python loop. Only a relaxation whose
rate depends on its own state runs row by row, in a scalar function without NumPy.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.functions import NUMPY, SCALAR, positive, to_numpy_function
from hesr_model.equations.memory import DT, EULER, Discretisation, Element, Stop
from hesr_model.equations.program import initial_state, initial_symbol
from hesr_model.equations.recurrence import recurrence
from hesr_model.errors import SimulationError
from hesr_model.fitting.separable import Separable
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.predict import coefficient_array
from hesr_model.support.arrays import Array


class StatesOverLog:
    """The memory of a component, lowered to NumPy.

    Parameters
    ----------
    memory : its elements.
    arguments : symbols of all inputs other than states: numbers, then inputs.
    read : requested symbols; the derivative of a stop not among them stays 0.
    settling : weight of the steady state in the initial state, see `Component.settling`.
    """

    def __init__(
        self,
        memory: Sequence[Element],
        arguments: Sequence[sympy.Symbol],
        read: Collection[sympy.Symbol],
        settling: sympy.Expr = sympy.S.Zero,
    ) -> None:
        lines = initial_state(memory, settling)
        self._beginning = lowered_program((*arguments, *(m.state for m in memory)), lines)
        self._begun = [list(lines).index(initial_symbol(m)) for m in memory]
        self._memory = tuple(memory)
        states = {m.state for m in memory}
        self._alone = [
            i for i, m in enumerate(memory) if not states & sympy.Tuple(*m.parts).free_symbols
        ]
        # Lowered together, because elements share subexpressions.
        self._parts = to_numpy_function(
            arguments, [part for i in self._alone for part in self._memory[i].parts]
        )
        self._groups = tuple(groups_of(self._memory))
        # Stops that depend on earlier elements are also lowered together.
        self._later = {
            i: to_numpy_function(
                (*arguments, *(e.state for e in memory[: i + 1])),
                [part for m in memory[i:end] for part in m.parts],
            )
            for i, end in self._groups
            if any(k not in self._alone for k in range(i, end))
        }
        own = {
            i: m
            for i, m in enumerate(memory)
            if (m.derivative in read if isinstance(m, Stop) else i not in self._alone)
        }
        self._steps = {
            i: _scalar_step((*arguments, *(e.state for e in memory[:i])), m)
            for i, m in enumerate(memory)
            if m.state in sympy.Tuple(*m.parts).free_symbols
        }
        self._derivatives = {
            i: to_numpy_function(
                (*arguments, *(e.state for e in memory[: i + 1])), [m.express_derivative()]
            )
            for i, m in own.items()
        }

    def beginning(self, values: Sequence[Any], start: Sequence[Any]) -> list[Any]:
        """Return the initial states for the first inputs among `values`, given the start values."""
        found = self._beginning(*values, *start)
        return [found[i] for i in self._begun]

    def parts(self, values: Sequence[Any], shape: tuple[int, ...]) -> list[tuple[Array, Array]]:
        """Return both parts of each element independent of states, the second one guarded."""
        found = [np.broadcast_to(e, shape) for e in self._parts(*values)]
        return [(b, NUMPY["positive"](r)) for b, r in zip(found[::2], found[1::2], strict=True)]

    def __call__(
        self,
        values: Sequence[Any],
        dt: Array,
        begins: NDArray[np.bool_],
        start: Sequence[float | Array],
        discretisation: Discretisation,
    ) -> list[Array]:
        """Return each state and its continuous derivative, (N,) each, one after the other.

        Parameters
        ----------
        values : values of the arguments: scalars or (N,).
        dt : (N,) step that ends at each row [s].
        begins : (N,) True if a record begins; the states have their start values at its first row.
        start : start value of each state, or (N,) with the values at these rows.
        discretisation : exact, or explicit Euler (eq. 10).

        Raises
        ------
        SimulationError
            If rate * step >= 1 for Euler.
        """
        alone = dict(zip(self._alone, self.parts(values, dt.shape), strict=True))
        states: list[Array] = []
        for i, end in self._groups:
            element, x0 = self._memory[i], start[i]
            if i in self._steps:
                states.append(self._row_by_row(i, values, states, dt, begins, x0, discretisation))
                continue
            parts = (
                self._later_parts(i, values, [*states, np.zeros_like(dt)])
                if i in self._later
                else [alone[k] for k in range(i, end)]
            )
            if isinstance(element, Stop):
                way, bound = (np.stack(columns) for columns in zip(*parts, strict=True))
                states += list(clipped(way * dt, bound, begins, np.array(start[i:end])))
            else:
                states.append(run(*parts[0], dt, begins, x0, discretisation))
        found: list[Array] = []
        for i, x in enumerate(states):
            element = self._memory[i]
            if i in self._derivatives:
                own = self._derivatives[i](*values, *states[: i + 1])[0]
                dx = np.broadcast_to(own, dt.shape)
            elif isinstance(element, Stop):
                dx = np.zeros_like(dt)
            else:
                dx = alone[i][0] - alone[i][1] * x
            found += [x, dx]
        return found

    def _later_parts(
        self, i: int, values: Sequence[Any], states: Sequence[Any]
    ) -> list[tuple[Array, Array]]:
        shape = np.broadcast_shapes(*(np.shape(v) for v in (*values, *states)))
        found = [np.broadcast_to(e, shape) for e in self._later[i](*values, *states)]
        return [(b, NUMPY["positive"](r)) for b, r in zip(found[::2], found[1::2], strict=True)]

    def _row_by_row(
        self,
        i: int,
        values: Sequence[Any],
        states: Sequence[Array],
        dt: Array,
        begins: NDArray[np.bool_],
        start: float | Array,
        discretisation: Discretisation,
    ) -> Array:
        columns = [np.broadcast_to(v, dt.shape).tolist() for v in (*values, *states, dt)]
        function, euler = self._steps[i], float(discretisation == "euler")
        starts = np.broadcast_to(start, dt.shape).tolist()
        x, z, found = starts[0], 0.0, []
        try:
            for first, begin, *row in zip(starts, begins.tolist(), *columns, strict=True):
                x, z = (first, 0.0) if begin else function(*row, euler, x)
                if euler and z >= 1.0:
                    raise _unstable(z)
                found.append(x)
            return np.array(found, dtype=float)
        except (ArithmeticError, ValueError, TypeError):  # NumPy would continue with inf or nan
            return self._in_arrays(i, values, states, dt, begins, start, discretisation)

    def _in_arrays(
        self,
        i: int,
        values: Sequence[Any],
        states: Sequence[Array],
        dt: Array,
        begins: NDArray[np.bool_],
        start: float | Array,
        discretisation: Discretisation,
    ) -> Array:
        columns = [np.broadcast_to(v, dt.shape) for v in (*values, *states)]
        rows = np.stack(columns, axis=1)
        function = self._later[i]
        starts = np.broadcast_to(start, dt.shape)
        x, found = float(starts[0]), np.empty_like(dt)
        for k, row in enumerate(rows):
            x = float(starts[k]) if begins[k] else x
            if not begins[k]:
                first, second = function(*row, x)
                guarded = float(second) if second > 0.0 else 0.0
                held = np.array([first]), np.array([guarded]), dt[k : k + 1]
                a, c = step_coefficients(*held, discretisation)
                x = float((a * x + c)[0])
            found[k] = x
        return found


def _scalar_step(arguments: Sequence[sympy.Symbol], element: Element) -> Any:
    """Return a function of arguments, dt, euler and state: the next state, and rate times dt."""
    first, second = element.parts
    guarded = positive(second)
    return sympy.lambdify(
        [*arguments, DT, EULER, element.state],
        (element.advance(first, guarded), guarded * DT),
        modules=[dict(SCALAR), "math"],
        cse=True,
    )


def _unstable(z: float) -> SimulationError:
    return SimulationError(f"rate * step < 1, found {z:.3g}")


def run(
    first: Array,
    second: Array,
    dt: Array,
    begins: NDArray[np.bool_],
    start: float | Array,
    discretisation: Discretisation,
) -> Array:
    """Return a relaxation's state over a log, (N,), from its drive and rate, each (N,)."""
    a, c = step_coefficients(first, second, dt, discretisation)
    c = np.where(begins, start, c)
    return recurrence(np.where(begins, 0.0, a), c, float(c[0]))


def step_coefficients(
    b: Array, r: Array, dt: Array, discretisation: Discretisation
) -> tuple[Array, Array]:
    """Return (a, c) of one step x+ = a x + c of x' = b - r x with b and r held over dt.

    Parameters
    ----------
    b, r, dt : (N,) drive [unit of x per s], rate >= 0 [1/s] and step [s].
    discretisation : exact, or explicit Euler (eq. 10).

    Raises
    ------
    SimulationError
        If r dt >= 1 for Euler.
    """
    z = r * dt
    if discretisation == "exact":
        # exp instead of 1 + expm1, as used for the share: fitted laws depend on every bit.
        return np.exp(-z), b * dt * NUMPY["share"](z, np.expm1(-z), False)
    if np.any(z >= 1.0):
        raise _unstable(float(z.max()))
    return 1.0 - z, b * dt


def clipped(way: Array, bound: Array, begins: NDArray[np.bool_], start: Array) -> Array:
    """Solve x[k] = clip(x[k-1] + way[k], -bound[k], bound[k]), all (E, N), from `start`."""
    at = np.broadcast_to(np.asarray(start, dtype=float).reshape(len(way), -1), way.shape)
    x, found = at[:, 0], np.empty_like(way)
    for k in range(way.shape[1]):
        moved = np.minimum(np.maximum(x + way[:, k], -bound[:, k]), bound[:, k])
        found[:, k] = x = at[:, k] if begins[k] else moved
    return found


def groups_of(memory: Sequence[Element]) -> Iterator[tuple[int, int]]:
    """Yield start and end of elements that move together: one relaxation, or independent stops."""
    i = 0
    while i < len(memory):
        end, states = i + 1, {memory[i].state}
        while end < len(memory) and all(isinstance(memory[k], Stop) for k in (i, end)):
            states.add(memory[end].state)
            read = sympy.Tuple(*(part for m in memory[i : end + 1] for part in m.parts))
            if states & read.free_symbols:
                break
            end += 1
        yield i, end
        i = end


def lowered_program(
    arguments: Sequence[sympy.Symbol], program: Mapping[sympy.Symbol, sympy.Expr]
) -> Any:
    """Return a NumPy function of `arguments` for the assignments of a program, in its order."""
    lines = list(program.items())
    return sympy.lambdify(
        list(arguments),
        list(program),
        modules=[dict(NUMPY), "numpy"],
        cse=lambda targets: (lines, targets),
    )


def over_rows(
    memory: Sequence[Element],
    outputs: Sequence[sympy.Expr],
    symbols: Sequence[sympy.Symbol],
    values: Sequence[Any],
    dt: Array,
    begins: NDArray[np.bool_],
    start: Sequence[Any],
    discretisation: Discretisation = "exact",
    settling: sympy.Expr | None = None,
) -> list[Array]:
    """Return outputs of symbols, states, derivatives and DT over rows, (N,) each.

    Records begin at `start`, or at the settled state given by `settling`.
    """
    states = tuple(s for m in memory for s in (m.state, m.derivative))
    read = set().union(*(e.free_symbols for e in outputs))
    own = StatesOverLog(memory, symbols, read, settling or sympy.S.Zero)
    at = [np.broadcast_to(x, dt.shape).copy() for x in start]
    if settling is not None and memory:
        firsts = [v[begins] if np.ndim(v) else v for v in values]
        for of_state, first in zip(at, own.beginning(firsts, [x[begins] for x in at]), strict=True):
            of_state[begins] = first
    found = own(values, dt, begins, at, discretisation)
    columns = to_numpy_function((*symbols, *states, DT), outputs)(*values, *found, dt)
    return [np.array(np.broadcast_to(column, dt.shape)) for column in columns]


def predicted(law: FrictionLaw, t: Array, dq: Array, q: Array, tau_load: Array) -> Array:
    """Return the torque of a law over a log, as `predict` does."""
    form = law.form
    symbols = (*(c.symbol for c in form.coefficients), *INPUTS)
    values = (*coefficient_array(law), dq, q, tau_load)
    dt, begins = np.diff(t, prepend=t[0]), np.arange(len(t)) == 0
    [torque] = over_rows(
        form.memory,
        (form.output,),
        symbols,
        values,
        dt,
        begins,
        law.start,
        law.discretisation,
        form.component.settling,
    )
    return torque


def stepped(
    law: FrictionLaw, values: Array, dt: Array, inputs: Sequence[Array], x: Array
) -> tuple[Array, Array]:
    """Return torque (W,) and states (m, W) after one step of W motions, as `LawStepper` does."""
    form, motions = law.form, len(dt)
    symbols = (*(c.symbol for c in form.coefficients), *INPUTS)
    rows = [np.repeat(np.broadcast_to(v, motions), 2) for v in (*values, *inputs)]
    outputs = (form.output, *(m.state for m in form.memory))
    begins = np.arange(2 * motions) % 2 == 0
    found = over_rows(
        form.memory,
        outputs,
        symbols,
        rows,
        np.repeat(dt, 2),
        begins,
        np.repeat(x, 2, axis=1),
        law.discretisation,
    )
    torque, *states = (column[1::2] for column in found)
    return torque, np.array(states).reshape(len(x), motions)


def columns(problem: Separable, point: Array) -> Array:
    """Return the columns of a least-squares problem at a point, (N, K)."""
    s, form = problem.rows, problem.form
    replaced = {sympy.Symbol(name, real=True): e for name, e in problem.space.values}
    memory = [m.subs(replaced) for m in form.memory]
    output = sympy.expand_mul(form.output.xreplace(replaced))
    wanted = [output.diff(sympy.Symbol(name, real=True)) for name in problem.space.linear]
    symbols = (*(sympy.Symbol(name, real=True) for name in problem.space.names), *INPUTS)
    values = (*problem.numbers(point), s.dq, s.q, s.tau_load)
    return np.column_stack(
        over_rows(
            memory,
            wanted,
            symbols,
            values,
            s.dt,
            s.begins,
            problem.start,
            problem.discretisation,
            form.component.settling,
        )
    )
