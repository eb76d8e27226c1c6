"""Expressions with memory over whole logs, run by `rows.c`."""

from collections.abc import Mapping, Sequence

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import Element, find_read_symbols
from hesr_model.equations.operations import Graph, build_program, find_fixed_nodes
from hesr_model.equations.program import initial_state, initial_symbol
from hesr_model.equations.rows import BLOCK, ProgramRun
from hesr_model.support.arrays import Array


class Kernel:
    """Programs for `rows.c`: `expressions` in `numbers`, equal for all rows, and `inputs`.

    States and derivatives in `expressions` are those at the end of a step; `names` are intermediate
    values. With `once`, values of inputs alone are not cached between runs.
    """

    def __init__(
        self,
        memory: Sequence[Element],
        numbers: Sequence[sympy.Symbol],
        inputs: Sequence[sympy.Symbol],
        expressions: Sequence[sympy.Expr],
        settling: sympy.Expr = sympy.S.Zero,
        *,
        names: Mapping[sympy.Symbol, sympy.Expr] | None = None,
        once: bool = False,
    ) -> None:
        self.memory = tuple(memory)
        graph = Graph(numbers, inputs)
        graph.move(self.memory)
        graph.assign(names or {})
        results = [graph.find_node(expression) for expression in expressions]
        self.known_nodes: list[int] = []
        if not once:
            self.known_nodes = find_fixed_nodes(graph, results)
        self.fixed_program = build_program(graph, self.known_nodes)
        self.main_program = build_program(graph, results, self.known_nodes)
        graph = Graph((*numbers, *(element.state for element in self.memory)), inputs)
        graph.assign(initial_state(self.memory, settling))
        self.first_program = build_program(
            graph, [graph.find_node(initial_symbol(element)) for element in self.memory]
        )
        self.row_by_row = any(
            element.state in find_read_symbols([element]) for element in self.memory
        )


class KernelRun(ProgramRun):
    """Kernel bound to rows of logs: `inputs` (N,) each, and steps `dt` (N,) [s] ending at each row.

    `firsts` are first rows of records, `start` the states at rest; results are fitted to `target`.
    """

    def __init__(
        self,
        kernel: Kernel,
        inputs: Sequence[Array],
        dt: Array,
        firsts: Sequence[int] | NDArray[np.int64] = (0,),
        *,
        euler: bool = False,
        start: Sequence[float] = (),
        target: Array | None = None,
        output: Array | None = None,
    ) -> None:
        # C does not check lengths.
        arrays = [_to_doubles(np.broadcast_to(column, np.shape(dt))) for column in (dt, *inputs)]
        firsts = np.asarray(firsts, dtype=np.int64)
        state_count = len(kernel.memory)
        self._start = np.array(start or (0.0,) * state_count)
        if kernel.known_nodes:
            fixed_run = ProgramRun(kernel.fixed_program, arrays, firsts)
            fixed_run.run_rows(np.zeros(0))
            arrays += list(fixed_run.results.T)
        if kernel.memory:
            first_inputs = [column[firsts] for column in arrays]
            self._first = ProgramRun(kernel.first_program, first_inputs, np.arange(len(firsts)))
        super().__init__(
            kernel.main_program,
            arrays,
            firsts,
            states=state_count,
            euler=euler,
            block=1 if kernel.row_by_row else BLOCK,
            target=target,
            output=output,
        )

    def begin(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> Array:
        """Set and return initial states (m, records) from states at rest, or the `settled` ones."""
        if settled and start is not None:
            if start.ndim == 1:  # equal for all records
                start = start[:, None]
            self.starts[:] = start
        elif len(self.starts):
            start_at_rest = self._start if start is None else start
            self._first.run_rows(np.concatenate([numbers, start_at_rest]))
            self.starts[:] = self._first.results.T
        return self.starts

    def evaluate(
        self, numbers: Array, start: Array | None = None, *, settled: bool = False
    ) -> Array:
        """Return (N, K) results, valid until the next call; SimulationError if unstable."""
        self.begin(numbers, start, settled=settled)
        self.run_rows(numbers)
        return self.results

    def fit_factors(
        self, numbers: Array, *, non_negative: int, weights: Array | None = None, keep: bool = False
    ) -> tuple[Array, float] | None:
        """Return the factors (K,) of the results that fit the target best, and the squared error.

        The leading `non_negative` factors are at least 0; `weights` (N,) weight the rows. Returns
        None if the factors are ill-conditioned.
        """
        self.begin(numbers)
        self.multiply(numbers, weights, keep=keep)
        return self.solve_factors(non_negative)


def _to_doubles(values: Array) -> Array:
    """Return values as doubles whose stride is a number of doubles, as C expects."""
    doubles = np.asarray(values, dtype=np.float64)
    if doubles.strides[0] % 8 != 0:
        return np.ascontiguousarray(doubles)
    return doubles
