"""Memory and expressions over whole logs in C (`rows.c`), as quick as the processor's vectors are.

There is one binary for all equations, compiled once for a user. `over_log.py` is the same in NumPy:
the oracle, and what remains where there is no compiler, where an expression has something in it
that `rows.c` does not know, or where numbers are outside of what it takes.
"""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from ctypes import CDLL

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import Element
from hesr_model.equations.operations import Graph, UnsupportedError, fixed_nodes
from hesr_model.equations.operations import program_of as program
from hesr_model.equations.program import beginning, begun
from hesr_model.equations.rows import BLOCK, Array, OutsideError, Run, library

_log = logging.getLogger(__name__)

_only_numpy = False


@contextmanager
def in_numpy() -> Iterator[None]:
    """Run everything in NumPy for a while, as where there is no compiler."""
    global _only_numpy
    before, _only_numpy = _only_numpy, True
    try:
        yield
    finally:
        _only_numpy = before


class Kernel:
    """Expressions of states and inputs, as programs for `rows.c`.

    Parameters
    ----------
    memory : elements.
    numbers : symbols of what is the same for all rows.
    inputs : symbols of what differs from row to row, besides `dt`.
    wanted : expressions; of states and their derivatives as they are at the end of a step.
    settling : as in `StatesOverLog`.
    once : whether rows are run over once: then what inputs alone decide is not computed before.

    Raises
    ------
    UnsupportedError
        If `rows.c` does not know a part of an expression.
    """

    def __init__(
        self,
        memory: Sequence[Element],
        numbers: Sequence[sympy.Symbol],
        inputs: Sequence[sympy.Symbol],
        wanted: Sequence[sympy.Expr],
        settling: sympy.Expr = sympy.S.Zero,
        *,
        once: bool = False,
    ) -> None:
        self.memory, self.numbers, self.inputs = tuple(memory), tuple(numbers), tuple(inputs)
        graph = Graph(numbers, inputs)
        graph.move(self.memory)
        results = [graph.of(e) for e in wanted]
        self.known = [] if once else fixed_nodes(graph, results)
        self.fixed = program(graph, self.known)
        self.main = program(graph, results, self.known)
        starts = tuple(m.state for m in self.memory)
        graph = Graph((*numbers, *starts), inputs)
        graph.assign(beginning(self.memory, settling))
        self.first = program(graph, [graph.of(begun(m)) for m in self.memory])
        self.row_by_row = any(m.state in sympy.Tuple(*m.parts).free_symbols for m in self.memory)

    def over(
        self,
        inputs: Sequence[Array],
        dt: Array,
        firsts: Sequence[int] | NDArray[np.int64],
        *,
        euler: bool = False,
        start: Sequence[float] = (),
        target: Array | None = None,
        found: Array | None = None,
    ) -> "Rows | None":
        """Return the kernel on rows, None where only NumPy is to be had; see `Rows`."""
        loaded = None if _only_numpy else library()
        if loaded is None:
            return None
        try:
            return Rows(
                loaded, self, inputs, dt, firsts,
                euler=euler, start=start, target=target, found=found,
            )  # fmt: skip
        except OutsideError:
            return None


def _whole(values: Array, rows: int) -> Array:
    return np.ascontiguousarray(np.broadcast_to(values, (rows,)), dtype=np.float64)


def _in_numbers(values: Array) -> Array:
    """Return an array of floats; a column of a table stays where it is."""
    found = np.asarray(values, dtype=np.float64)
    return found if found.strides[0] % 8 == 0 else np.ascontiguousarray(found)


class Rows:
    """A kernel on the rows of logs.

    Parameters
    ----------
    loaded : the library.
    kernel : the expressions.
    inputs : (N,) of each input.
    dt : (N,) step that ends at each row [s].
    firsts : rows at which records begin, in rising order, 0 before all.
    euler : whether relaxations move by Euler's step.
    start : of each state at rest, 0 where not given.
    target : (N,) what results are fitted to.
    found : (N, K) for the results; one of its own where not given.
    """

    def __init__(
        self,
        loaded: CDLL,
        kernel: Kernel,
        inputs: Sequence[Array],
        dt: Array,
        firsts: Sequence[int] | NDArray[np.int64],
        *,
        euler: bool = False,
        start: Sequence[float] = (),
        target: Array | None = None,
        found: Array | None = None,
    ) -> None:
        # Of the same length, all of them: C does not ask.
        arrays = [_in_numbers(np.broadcast_to(a, np.shape(dt))) for a in (dt, *inputs)]
        firsts, self._states = np.asarray(firsts, dtype=np.int64), len(kernel.memory)
        self._start = np.array(start or (0.0,) * self._states)
        if kernel.known:
            fixed = Run(loaded, kernel.fixed, arrays, firsts)
            fixed(np.zeros(0))
            arrays += list(fixed.found.T)
        if kernel.memory:
            at_firsts = [a[firsts] for a in arrays]
            self._first = Run(loaded, kernel.first, at_firsts, np.arange(len(firsts)))
        self._run = Run(
            loaded, kernel.main, arrays, firsts, states=self._states, euler=euler,
            block=1 if kernel.row_by_row else BLOCK,
            target=None if target is None else _whole(target, len(arrays[0])),
            found=found,
        )  # fmt: skip

    def begin(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> None:
        """Put the states where they begin for the first rows.

        Parameters
        ----------
        numbers : those of the kernel, in their units.
        start : of each state, from which it begins, (m,) or (m, records); where not given, at rest.
        settled : whether states begin at that start itself, wherever their inputs would have them.

        Raises
        ------
        OutsideError
            If a number is outside of what can be had here.
        """
        if settled and start is not None:
            self._run.starts[:] = start if start.ndim > 1 else start[:, None]
        elif self._states:
            at_rest = self._start if start is None else start
            self._first(np.concatenate([numbers, at_rest]))
            self._run.starts[:] = self._first.found.T

    def at(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> Array:
        """Return the (N, K) results for numbers, which stand there until the next call.

        Parameters and errors are those of `begin`.
        """
        self.begin(numbers, start, settled=settled)
        self._run(numbers)
        return self._run.found

    def on(self, numbers: Array, first: int, stop: int) -> None:
        """Put the results of rows into `found`, after `begin` and after those before them.

        Parameters
        ----------
        numbers : those of the kernel, in their units.
        first, stop : rows.

        Raises
        ------
        OutsideError
            If a number is outside of what can be had here.
        """
        self._run.on(numbers, first, stop)

    def solved(
        self, numbers: Array, *, non_negative: int, weights: Array | None = None, keep: bool = False
    ) -> tuple[Array, float] | None:
        """Return the (K,) factors of the results that fit the target best, and the squares left.

        Parameters
        ----------
        numbers : those of the kernel, in their units.
        non_negative : how many factors, from the first, must not be negative.
        weights : (N,) of the rows.
        keep : whether the results shall stand in `found`.

        Returns
        -------
        None where the factors are hardly determined.

        Raises
        ------
        OutsideError
            If a number is outside of what can be had here.
        """
        self.begin(numbers)
        by = None if weights is None else _whole(weights, len(self._run.found))
        return self._run.solved(numbers, non_negative, by, keep=keep)

    @property
    def found(self) -> Array:
        """(N, K) results of the last call."""
        return self._run.found


def kernel_of(
    memory: Sequence[Element],
    numbers: Sequence[sympy.Symbol],
    inputs: Sequence[sympy.Symbol],
    wanted: Sequence[sympy.Expr],
    settling: sympy.Expr,
    *,
    once: bool = False,
) -> Kernel | None:
    """Return the kernel of expressions, None where they have something in them that C has not."""
    try:
        return Kernel(memory, numbers, inputs, wanted, settling, once=once)
    except UnsupportedError as reason:
        _log.info("a law is run over logs in NumPy (%s).", reason)
        return None
