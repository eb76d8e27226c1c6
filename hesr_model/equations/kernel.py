"""Memory and expressions over whole logs, run by `rows.c` with the processor's vectors.

One binary serves all equations; it is compiled once per user.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import Element
from hesr_model.equations.operations import Graph, fixed_nodes, program_of
from hesr_model.equations.program import initial_state, initial_symbol
from hesr_model.equations.rows import BLOCK, ProgramRun
from hesr_model.support.arrays import Array


class Kernel:
    """Expressions of states and inputs as programs for `rows.c`.

    Parameters
    ----------
    memory : elements.
    numbers : symbols of values that are the same for all rows.
    inputs : symbols of values that differ between rows, without `dt`.
    wanted : expressions; states and their derivatives are those at the end of a step.
    settling : share of the steady state in the initial state, see `Component.settling`.
    names : expressions of intermediate values by their symbols, each using only earlier ones.
    once : True if the rows are run only once; subexpressions of inputs alone are then not cached.

    Raises
    ------
    ArtifactError
        If an expression contains a function that `rows.c` does not have.
    """

    def __init__(
        self,
        memory: Sequence[Element],
        numbers: Sequence[sympy.Symbol],
        inputs: Sequence[sympy.Symbol],
        wanted: Sequence[sympy.Expr],
        settling: sympy.Expr = sympy.S.Zero,
        *,
        names: Mapping[sympy.Symbol, sympy.Expr] | None = None,
        once: bool = False,
    ) -> None:
        self.memory = tuple(memory)
        graph = Graph(numbers, inputs)
        graph.move(self.memory)
        graph.assign(names or {})
        results = [graph.of(e) for e in wanted]
        self.known = [] if once else fixed_nodes(graph, results)
        self.fixed = program_of(graph, self.known)
        self.main = program_of(graph, results, self.known)
        graph = Graph((*numbers, *(m.state for m in self.memory)), inputs)
        graph.assign(initial_state(self.memory, settling))
        self.first = program_of(graph, [graph.of(initial_symbol(m)) for m in self.memory])
        self.row_by_row = any(m.state in sympy.Tuple(*m.parts).free_symbols for m in self.memory)

    def over(
        self,
        inputs: Sequence[Array],
        dt: Array,
        firsts: Sequence[int] | NDArray[np.int64] = (0,),
        *,
        euler: bool = False,
        start: Sequence[float] = (),
        target: Array | None = None,
        found: Array | None = None,
    ) -> "KernelRun":
        """Return the kernel bound to rows; see `KernelRun` for parameters and errors."""
        return KernelRun(
            self, inputs, dt, firsts, euler=euler, start=start, target=target, found=found
        )

    def at(self, numbers: Iterable[float], *inputs: float) -> tuple[float, ...]:
        """Return the results of a kernel without memory for one row of inputs."""
        row = self.over([np.array([u]) for u in inputs], np.zeros(1))
        return tuple(row.at(np.array(list(numbers)))[0].tolist())


def _whole(values: Array, rows: int) -> Array:
    return np.ascontiguousarray(np.broadcast_to(values, (rows,)), dtype=np.float64)


def _in_doubles(values: Array) -> Array:
    """Return an array of doubles; columns of a table are not copied."""
    found = np.asarray(values, dtype=np.float64)
    return found if found.strides[0] % 8 == 0 else np.ascontiguousarray(found)


class KernelRun:
    """A kernel bound to the rows of logs.

    Parameters
    ----------
    kernel : the expressions.
    inputs : (N,) values of each input.
    dt : (N,) step that ends at each row [s].
    firsts : first row of each record, increasing from 0.
    euler : True if relaxations move by Euler's step.
    start : value of each state at rest; 0 by default.
    target : (N,) values that the results are fitted to.
    found : (N, K) array for the results; a new one by default.

    Raises
    ------
    ExportError
        If `rows.c` cannot be compiled.
    """

    def __init__(
        self,
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
        # C does not check lengths, so all arrays are broadcast to one.
        arrays = [_in_doubles(np.broadcast_to(a, np.shape(dt))) for a in (dt, *inputs)]
        firsts, self._states = np.asarray(firsts, dtype=np.int64), len(kernel.memory)
        self._start = np.array(start or (0.0,) * self._states)
        if kernel.known:
            fixed = ProgramRun(kernel.fixed, arrays, firsts)
            fixed(np.zeros(0))
            arrays += list(fixed.found.T)
        if kernel.memory:
            at_firsts = [a[firsts] for a in arrays]
            self._first = ProgramRun(kernel.first, at_firsts, np.arange(len(firsts)))
        self._run = ProgramRun(
            kernel.main,
            arrays,
            firsts,
            states=self._states,
            euler=euler,
            block=1 if kernel.row_by_row else BLOCK,
            target=None if target is None else _whole(target, len(arrays[0])),
            found=found,
        )

    def begin(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> Array:
        """Set the initial states of all records and return them, (m, records).

        Parameters
        ----------
        numbers : values of the kernel's numbers, in their units.
        start : value of each state at rest, (m,) or (m, records); `start` of the run by default.
        settled : True if `start` itself is the initial state, whatever the first inputs are.
        """
        if settled and start is not None:
            self._run.starts[:] = start if start.ndim > 1 else start[:, None]
        elif self._states:
            at_rest = self._start if start is None else start
            self._first(np.concatenate([numbers, at_rest]))
            self._run.starts[:] = self._first.found.T
        return self._run.starts

    def at(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> Array:
        """Return the (N, K) results for numbers, valid until the next call.

        Parameters are those of `begin`.

        Raises
        ------
        SimulationError
            If Euler's step is unstable.
        """
        self.begin(numbers, start, settled=settled)
        self._run(numbers)
        return self._run.found

    def on(self, numbers: Array, first: int, stop: int) -> None:
        """Write the results of some rows into `found`, after `begin` and all earlier rows.

        Parameters
        ----------
        numbers : values of the kernel's numbers, in their units.
        first, stop : rows.

        Raises
        ------
        SimulationError
            If Euler's step is unstable.
        """
        self._run.on(numbers, first, stop)

    def solved(
        self, numbers: Array, *, non_negative: int, weights: Array | None = None, keep: bool = False
    ) -> tuple[Array, float] | None:
        """Solve for the factors of the results that fit the target best.

        Parameters
        ----------
        numbers : values of the kernel's numbers, in their units.
        non_negative : number of leading factors that must not be negative.
        weights : (N,) weights of the rows.
        keep : True if the results are written into `found`.

        Returns
        -------
        (K,) factors and the sum of squared residuals, or None if the factors are ill-conditioned.

        Raises
        ------
        SimulationError
            If Euler's step is unstable.
        """
        self.begin(numbers)
        by = None if weights is None else _whole(weights, len(self._run.found))
        return self._run.solved(numbers, non_negative, by, keep=keep)

    @property
    def found(self) -> Array:
        """(N, K) results of the last call."""
        return self._run.found
