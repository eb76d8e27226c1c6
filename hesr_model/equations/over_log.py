"""The states of a component over whole logs at once, in NumPy.

Relaxations compose to relaxations and clips to clips, so a log runs without a Python loop; only a
relaxation whose rate sees its own state goes row by row.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from hesr_model.equations.functions import NUMPY, lowered
from hesr_model.equations.memory import Element, Relaxation, Stop
from hesr_model.errors import SimulationError

Array = NDArray[np.float64]
Discretisation = Literal["exact", "euler"]


class StatesOverLog:
    """The memory of a component, lowered to NumPy.

    Parameters
    ----------
    memory : its elements.
    arguments : symbols of all that they read besides states: numbers, then inputs.
    """

    def __init__(self, memory: Sequence[Element], arguments: Sequence[sympy.Symbol]) -> None:
        self._memory = tuple(memory)
        states = {m.state for m in memory}
        self._alone = [
            i for i, m in enumerate(memory) if not states & sympy.Tuple(*m.parts).free_symbols
        ]
        # Together, since elements share subexpressions.
        self._parts = lowered(
            arguments, [part for i in self._alone for part in self._memory[i].parts]
        )
        self._later = {
            i: lowered((*arguments, *(e.state for e in memory[: i + 1])), m.parts)
            for i, m in enumerate(memory)
            if i not in self._alone
        }
        own = {i: m for i, m in enumerate(memory) if not _plain(m, i in self._alone)}
        self._derivatives = {
            i: lowered((*arguments, *(e.state for e in memory[: i + 1])), [m.continuous()])
            for i, m in own.items()
        }

    def parts(self, values: Sequence[Any], shape: tuple[int, ...]) -> list[tuple[Array, Array]]:
        """Return both parts of each element that sees no state, the second one guarded."""
        found = [np.broadcast_to(e, shape) for e in self._parts(*values)]
        return [(b, NUMPY["positive"](r)) for b, r in zip(found[::2], found[1::2], strict=True)]

    def __call__(
        self,
        values: Sequence[Any],
        dt: Array,
        begins: NDArray[np.bool_],
        start: Sequence[float],
        discretisation: Discretisation,
    ) -> list[Array]:
        """Return each state and its continuous derivative, (N,) each, one after the other.

        Parameters
        ----------
        values : of the arguments: scalars or (N,).
        dt : (N,) step that ends at each row [s].
        begins : (N,) True where a record begins, at whose first row the states have their start.
        start : value of each state there.
        discretisation : exact, or explicit Euler (eq. 10).

        Raises
        ------
        SimulationError
            If rate * step >= 1 for Euler.
        """
        alone = dict(zip(self._alone, self.parts(values, dt.shape), strict=True))
        states: list[Array] = []
        found: list[Array] = []
        for i, (element, x0) in enumerate(zip(self._memory, start, strict=True)):
            x: Array
            if i in alone:
                first, second = alone[i]
                x = run(element, first, second, dt, begins, x0, discretisation)
            elif element.state in sympy.Tuple(*element.parts).free_symbols:
                x = self._row_by_row(i, values, states, dt, begins, x0, discretisation)
            else:
                first, second = self._later_parts(i, values, [*states, np.zeros_like(dt)])
                x = run(element, first, second, dt, begins, x0, discretisation)
            states.append(x)
            if i in self._derivatives:
                dx = np.broadcast_to(self._derivatives[i](*values, *states)[0], dt.shape)
            else:
                dx = alone[i][0] - alone[i][1] * x
            found += [x, dx]
        return found

    def _later_parts(
        self, i: int, values: Sequence[Any], states: Sequence[Any]
    ) -> tuple[Array, Array]:
        first, second = self._later[i](*values, *states)
        shape = np.broadcast_shapes(*(np.shape(v) for v in (*values, *states)))
        return np.broadcast_to(first, shape), NUMPY["positive"](np.broadcast_to(second, shape))

    def _row_by_row(
        self, i: int, values: Sequence[Any], states: Sequence[Array], dt: Array,
        begins: NDArray[np.bool_], x0: float, discretisation: Discretisation,
    ) -> Array:  # fmt: skip
        columns = [np.broadcast_to(v, dt.shape) for v in (*values, *states)]
        rows = np.stack(columns, axis=1) if columns else np.empty((len(dt), 0))
        function = self._later[i]
        x, found = x0, np.empty_like(dt)
        for k, row in enumerate(rows):
            x = x0 if begins[k] else x
            if not begins[k]:
                first, second = function(*row, x)
                guarded = float(second) if second > 0.0 else 0.0
                held = np.array([first]), np.array([guarded]), dt[k : k + 1]
                a, c = step_coefficients(*held, discretisation)
                x = float((a * x + c)[0])
            found[k] = x
        return found


def _plain(element: Element, alone: bool) -> bool:
    """Whether x' follows from the parts that were computed for the step."""
    return alone and isinstance(element, Relaxation)


def run(
    element: Element, first: Array, second: Array, dt: Array, begins: NDArray[np.bool_],
    start: float, discretisation: Discretisation,
) -> Array:  # fmt: skip
    """Return one state over a log, (N,), from its two parts, each (N,); see `StatesOverLog`."""
    if isinstance(element, Stop):
        return clipped(first * dt, np.asarray(second), begins, start)
    a, c = step_coefficients(first, second, dt, discretisation)
    return recurrence(np.where(begins, 0.0, a), np.where(begins, start, c), start)


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
        raise SimulationError(
            f"Euler needs 0 <= rate * step < 1, found {float(z.max()):.3g}; take a smaller step or "
            "the 'exact' discretisation."
        )
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


def clipped(way: Array, bound: Array, begins: NDArray[np.bool_], start: float) -> Array:
    """Solve x[k] = clip(x[k-1] + way[k], -bound[k], bound[k]), x = start where a record begins.

    Parameters
    ----------
    way, bound : (N,) of each step; the bound is not negative.
    begins : (N,) True where a record begins, as the first row does.
    start : value there.

    Returns
    -------
    (N,) array, by a prefix scan: after x -> clip(x + a, l, u) the map x -> clip(x + b, m, v) gives
    clip(x + a + b, clip(l + b, m, v), clip(u + b, m, v)).
    """
    shift = np.where(begins, 0.0, way)
    low, high = np.where(begins, start, -bound), np.where(begins, start, bound)
    distance = 1
    while distance < len(shift):
        b, least, most = shift[distance:], low[distance:], high[distance:]
        low, high = (
            np.concatenate([old[:distance], np.clip(old[:-distance] + b, least, most)])
            for old in (low, high)
        )
        shift = np.concatenate([shift[:distance], shift[:-distance] + b])
        distance *= 2
    # From the first row on, at which both limits are the start, they are one.
    return low
