"""The states of a component over whole logs at once, in NumPy.

Relaxations compose to relaxations and clips to clips, so a log runs without a Python loop; only a
relaxation whose rate sees its own state goes row by row, by a scalar function without NumPy.
"""

from collections.abc import Collection, Iterator, Sequence
from typing import Any, Literal

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from hesr_model.equations.functions import NUMPY, SCALAR, lowered, lowered_program, positive
from hesr_model.equations.memory import DT, EULER, Element, Stop
from hesr_model.equations.program import initial_state, initial_symbol
from hesr_model.errors import SimulationError

Array = NDArray[np.float64]
Discretisation = Literal["exact", "euler"]


class StatesOverLog:
    """The memory of a component, lowered to NumPy.

    Parameters
    ----------
    memory : its elements.
    arguments : symbols of all that they read besides states: numbers, then inputs.
    read : symbols that are asked for; a stop's derivative that is not among them is left at 0.
    settling : share of the steady state in where they begin, see `Component.settling`.
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
        # Together, since elements share subexpressions.
        self._parts = lowered(
            arguments, [part for i in self._alone for part in self._memory[i].parts]
        )
        self._groups = tuple(groups_of(self._memory))
        # Stops that read what moves before them go together, too.
        self._later = {
            i: lowered(
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
            i: lowered((*arguments, *(e.state for e in memory[: i + 1])), [m.continuous()])
            for i, m in own.items()
        }

    def beginning(self, values: Sequence[Any], start: Sequence[Any]) -> list[Any]:
        """Return where each state begins for the first inputs among `values`, from its start."""
        found = self._beginning(*values, *start)
        return [found[i] for i in self._begun]

    def parts(self, values: Sequence[Any], shape: tuple[int, ...]) -> list[tuple[Array, Array]]:
        """Return both parts of each element that sees no state, the second one guarded."""
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
        values : of the arguments: scalars or (N,).
        dt : (N,) step that ends at each row [s].
        begins : (N,) True where a record begins, at whose first row the states have their start.
        start : value of each state there, or (N,) of which those of these rows count.
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
        self, i: int, values: Sequence[Any], states: Sequence[Array], dt: Array,
        begins: NDArray[np.bool_], start: float | Array, discretisation: Discretisation,
    ) -> Array:  # fmt: skip
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
        except (ArithmeticError, ValueError, TypeError):  # where NumPy goes on with inf or nan
            return self._in_arrays(i, values, states, dt, begins, start, discretisation)

    def _in_arrays(
        self, i: int, values: Sequence[Any], states: Sequence[Array], dt: Array,
        begins: NDArray[np.bool_], start: float | Array, discretisation: Discretisation,
    ) -> Array:  # fmt: skip
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


def groups_of(memory: Sequence[Element]) -> Iterator[tuple[int, int]]:
    """Yield first and last but one of what moves together: one relaxation, or stops in a row.

    None of the stops reads its own state or that of another one.
    """
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


def _scalar_step(arguments: Sequence[sympy.Symbol], element: Element) -> Any:
    """Return a function of arguments, dt, euler and state: the state after, and rate times dt."""
    first, second = element.parts
    guarded = positive(second)
    return sympy.lambdify(
        [*arguments, DT, EULER, element.state],
        (element.sampled(first, guarded), guarded * DT),
        modules=[dict(SCALAR), "math"],
        cse=True,
    )


def _unstable(z: float) -> SimulationError:
    return SimulationError(
        f"Euler needs 0 <= rate * step < 1, found {z:.3g}; take a smaller step or the 'exact' "
        "discretisation."
    )


def run(
    first: Array, second: Array, dt: Array, begins: NDArray[np.bool_], start: float | Array,
    discretisation: Discretisation,
) -> Array:  # fmt: skip
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
        # exp rather than 1 + expm1, which the share has its own of: fitted laws depend on the bits.
        return np.exp(-z), b * dt * NUMPY["share"](z, np.expm1(-z), False)
    if np.any(z >= 1.0):
        raise _unstable(float(z.max()))
    return 1.0 - z, b * dt


def recurrence(a: Array, c: Array, start: float) -> Array:
    """Solve x[0] = start, x[k] = a[k] x[k-1] + c[k] for a whole log without a Python loop.

    Parameters
    ----------
    a, c : (N,) factors and increments; those of k = 0 are not used.
    start : value at k = 0.

    Returns
    -------
    (N,) array: a unit lower bidiagonal system, solved by LAPACK's banded substitution.
    """
    bands = np.empty((2, len(a)), order="F")
    bands[0] = 1.0
    bands[1, :-1] = -a[1:]
    bands[1, -1] = 0.0
    right = np.array(c, dtype=float)
    right[0] = start
    solution, _ = dtbtrs(bands, right[:, None], uplo="L", diag="U")
    return np.asarray(solution[:, 0])


def clipped(way: Array, bound: Array, begins: NDArray[np.bool_], start: Array) -> Array:
    """Solve x[k] = clip(x[k-1] + way[k], -bound[k], bound[k]), x = start where a record begins.

    Parameters
    ----------
    way, bound : (E, N) of each step of each element; bounds are not negative.
    begins : (N,) True where a record begins, as the first row does.
    start : (E,) values there, or (E, N) of which those of these rows count.

    Returns
    -------
    (E, N) array. Clips compose to clips, so rows go in blocks, all blocks at once.
    """
    at = np.asarray(start, dtype=float).reshape(len(way), -1)
    low, high = np.where(begins, at, -bound), np.where(begins, at, bound)
    return _clips(np.where(begins, 0.0, way), low, high, np.zeros(len(way)))


_BLOCK = 24


def _clips(shift: Array, low: Array, high: Array, x: Array) -> Array:
    """Return x[k] = clip(x[k-1] + shift[k], low[k], high[k]), all (E, N), from x (E,) on.

    After x -> clip(x + a, l, u) the map x -> clip(x + b, m, v) gives
    clip(x + a + b, clip(l + b, m, v), clip(u + b, m, v)); so what a block does is one such map.
    """
    elements, rows = shift.shape
    if rows <= 2 * _BLOCK:
        found = np.empty_like(shift)
        for k in range(rows):
            x = np.minimum(np.maximum(x + shift[:, k], low[:, k]), high[:, k])
            found[:, k] = x
        return found
    blocks = -(-rows // _BLOCK)

    def in_blocks(values: Array, beyond: float) -> Array:
        whole = np.full((elements, blocks * _BLOCK), beyond)
        whole[:, :rows] = values
        return np.ascontiguousarray(whole.reshape(elements, blocks, _BLOCK).transpose(2, 0, 1))

    a, lower, upper = in_blocks(shift, 0.0), in_blocks(low, -np.inf), in_blocks(high, np.inf)
    total, least, most = a[0], lower[0], upper[0]
    for k in range(1, _BLOCK):
        least, most = (np.minimum(np.maximum(e + a[k], lower[k]), upper[k]) for e in (least, most))
        total = total + a[k]
    ends = _clips(total, least, most, x)
    now = np.concatenate([x[:, None], ends[:, :-1]], axis=1)
    found = np.empty_like(a)
    for k in range(_BLOCK):
        np.minimum(np.maximum(now + a[k], lower[k]), upper[k], out=found[k])
        now = found[k]
    return found.transpose(1, 2, 0).reshape(elements, -1)[:, :rows]
