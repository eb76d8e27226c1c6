"""Memory and expressions over whole logs in C (`rows.c`), as quick as the processor's vectors are.

There is one binary for all equations, compiled once for a user. `over_log.py` is the same in NumPy:
the oracle, and what remains where there is no compiler, where an expression has something in it
that `rows.c` does not know, or where numbers are outside of what it takes.
"""

import ctypes
import logging
import platform
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import numpy as np
import sympy
from numpy.typing import NDArray

from hesr_model.equations.memory import Element
from hesr_model.equations.operations import NAMES, Graph, Program, UnsupportedError, fixed_nodes
from hesr_model.equations.operations import program_of as program
from hesr_model.equations.program import beginning, begun
from hesr_model.errors import ExportError
from hesr_model.support.compiler import compile_c

Array = NDArray[np.float64]

_log = logging.getLogger(__name__)
_BLOCK, _LANES = 128, 8  # as in rows.c

RUNS: Counter[str] = Counter()
"""How many runs over rows were in C and how many in NumPy, for whoever asks what was used."""

_HOSTS = {
    ("linux", "x86_64"): ("x86_64-linux-gnu.2.17", ".so"),
    ("linux", "aarch64"): ("aarch64-linux-gnu.2.17", ".so"),
    ("darwin", "x86_64"): ("x86_64-macos.11.0", ".dylib"),
    ("darwin", "arm64"): ("aarch64-macos.11.0", ".dylib"),
    ("win32", "AMD64"): ("x86_64-windows-gnu", ".dll"),
}
"""The compiler's name of this machine, and how its libraries end."""
_FLAGS = ("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden",
          "-fPIC", "-shared", "-nostdlib", "-g0", "-s")  # fmt: skip
_SOURCES = ("rows.c", "elementary.h")


class _Program(ctypes.Structure):
    _fields_ = (
        ("operations", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("uniform", "count")),
        *((name, ctypes.c_void_p) for name in ("inputs", "strides")),
        ("input_count", ctypes.c_int64),
        ("given", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("given_count", "uniform_count", "registers")),
        ("euler", ctypes.c_double),
        ("firsts", ctypes.c_void_p),
        *((name, ctypes.c_int64) for name in ("first_count", "coming")),
        *((name, ctypes.c_void_p) for name in ("start", "carried")),
        *((name, ctypes.c_int64) for name in ("rows", "block")),
        *((name, ctypes.c_void_p) for name in ("places", "work", "results")),
        ("result_count", ctypes.c_int64),
        ("out", ctypes.c_void_p),
        ("out_stride", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("target", "weights", "gram", "lanes")),
        ("lane_count", ctypes.c_int64),
        ("columns", ctypes.c_void_p),
    )


class OutsideError(Exception):
    """Numbers are outside of what `rows.c` takes; NumPy goes on."""


@cache
def _library() -> ctypes.CDLL | None:
    """Return the compiled `rows.c`, None where it cannot be had."""
    triple, suffix = _HOSTS.get((sys.platform, platform.machine()), ("", ""))
    if not triple:
        return None
    numbers = [f"-D{name}={i}" for i, name in enumerate(NAMES)]
    try:
        with tempfile.TemporaryDirectory(prefix="hesr-", ignore_cleanup_errors=True) as folder:
            for name in _SOURCES:
                text = Path(__file__).with_name(name).read_bytes()
                Path(folder, name).write_bytes(text)
            file = Path(folder, f"rows{suffix}")
            compile_c(Path(folder, "rows.c"), ("-target", triple, *_FLAGS, *numbers), file)
            library = ctypes.CDLL(str(file))
    except (ExportError, OSError) as error:
        _log.info("laws are run over logs in NumPy (%s).", error)
        return None
    library.solve.restype = ctypes.c_bool
    return library


@cache
def _vectors() -> int:
    """Return how wide vectors are on this machine, as `rows.c` numbers them."""
    library = _library()
    return 0 if library is None else int(library.widest())


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
        target: Array | None = None,
        found: Array | None = None,
    ) -> "Rows | None":
        """Return the kernel on rows, None where only NumPy is to be had; see `Rows`."""
        library = None if _only_numpy else _library()
        if library is None:
            return None
        try:
            return Rows(library, self, inputs, dt, firsts, euler=euler, target=target, found=found)
        except OutsideError:
            return None


class _Run:
    """A program on arrays, with all that it works on."""

    def __init__(
        self,
        library: ctypes.CDLL,
        own: Program,
        arrays: Sequence[Array],
        firsts: NDArray[np.int64],
        *,
        states: int = 0,
        euler: bool = False,
        block: int = _BLOCK,
        target: Array | None = None,
        found: Array | None = None,
    ) -> None:
        self._run, self._solve = library["run"], library["solve"]
        rows, count = len(arrays[0]), len(own.results)
        self.found = np.empty((count, rows)).T if found is None else found
        self.starts = np.zeros((states, len(firsts)))
        self._given, self._numbers = own.given.copy(), own.numbers
        self._gram = np.zeros((count + 1, count + 1))
        self._room = np.empty(count * (count + 3))
        self._x, self._squares = np.empty(count), ctypes.c_double()
        self._out = _addresses(self.found.T)
        inputs = _addresses([arrays[i] for i in own.inputs])
        strides = np.array([arrays[i].strides[0] // 8 for i in own.inputs])
        carried, places = np.zeros(states), np.empty(own.registers, dtype=np.uintp)
        work = np.empty((own.registers + count + 11) * _BLOCK)
        lanes = np.empty(sum(4 * _LANES * -(-left // 4) for left in range(1, count + 2)))
        columns = np.empty(count + 4, dtype=np.uintp)
        # As long as addresses of them are in use.
        self._held = (own, arrays, firsts, target, inputs, strides, carried, places, work, lanes,
                      columns)  # fmt: skip
        self._program = _Program(
            operations=own.operations.ctypes.data, uniform=own.uniform, count=len(own.operations),
            inputs=inputs.ctypes.data, strides=strides.ctypes.data, input_count=len(own.inputs),
            given=self._given.ctypes.data, given_count=len(own.given),
            uniform_count=own.uniform_count, registers=own.registers, euler=float(euler),
            firsts=firsts.ctypes.data, first_count=len(firsts),
            start=self.starts.ctypes.data, carried=carried.ctypes.data,
            rows=rows, block=block, places=places.ctypes.data, work=work.ctypes.data,
            results=own.results.ctypes.data, result_count=count,
            out_stride=self.found.strides[0] // 8,
            target=None if target is None else target.ctypes.data,
            lanes=lanes.ctypes.data, lane_count=lanes.size, columns=columns.ctypes.data,
        )  # fmt: skip
        self._reference = ctypes.byref(self._program)

    def __call__(self, numbers: Array) -> None:
        """Put the results into `found`."""
        self._started(numbers, weights=None, gram=False, keep=True)

    def solved(
        self, numbers: Array, non_negative: int, weights: Array | None, *, keep: bool
    ) -> tuple[Array, float] | None:
        """See `Rows`."""
        self._started(numbers, weights, gram=True, keep=keep)
        count = len(self._x)
        determined = self._solve(
            ctypes.c_void_p(self._gram.ctypes.data), ctypes.c_int64(count),
            ctypes.c_int64(non_negative), ctypes.c_void_p(self._room.ctypes.data),
            ctypes.c_void_p(self._x.ctypes.data), ctypes.byref(self._squares),
        )  # fmt: skip
        return (self._x.copy(), self._squares.value) if determined else None

    def _started(self, numbers: Array, weights: Array | None, *, gram: bool, keep: bool) -> None:
        self._given[self._numbers[0]] = numbers[self._numbers[1]]
        own = self._program
        own.weights = None if weights is None else weights.ctypes.data
        own.gram = self._gram.ctypes.data if gram else None
        own.out = self._out.ctypes.data if keep else None
        if self._run(self._reference, _vectors()):
            raise OutsideError
        RUNS["C"] += 1


def _in_numbers(values: Array) -> Array:
    """Return an array of floats; a column of a table stays where it is."""
    found = np.asarray(values, dtype=np.float64)
    return found if found.strides[0] % 8 == 0 else np.ascontiguousarray(found)


def _addresses(arrays: Iterable[Array]) -> NDArray[np.uintp]:
    return np.array([a.ctypes.data for a in arrays], dtype=np.uintp)


class Rows:
    """A kernel on the rows of logs.

    Parameters
    ----------
    library : that holds `rows.c`.
    kernel : the expressions.
    inputs : (N,) of each input.
    dt : (N,) step that ends at each row [s].
    firsts : rows at which records begin, in rising order, 0 before all.
    euler : whether relaxations move by Euler's step.
    target : (N,) what results are fitted to.
    found : (N, K) for the results; one of its own where not given.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        kernel: Kernel,
        inputs: Sequence[Array],
        dt: Array,
        firsts: Sequence[int] | NDArray[np.int64],
        *,
        euler: bool = False,
        target: Array | None = None,
        found: Array | None = None,
    ) -> None:
        arrays = [_in_numbers(a) for a in (dt, *inputs)]
        firsts, self._states = np.asarray(firsts, dtype=np.int64), len(kernel.memory)
        if kernel.known:
            fixed = _Run(library, kernel.fixed, arrays, firsts)
            fixed(np.zeros(0))
            arrays += list(fixed.found.T)
        if kernel.memory:
            at_firsts = [a[firsts] for a in arrays]
            self._first = _Run(library, kernel.first, at_firsts, np.arange(len(firsts)))
        self._run = _Run(
            library, kernel.main, arrays, firsts, states=self._states, euler=euler,
            block=1 if kernel.row_by_row else _BLOCK,
            target=None if target is None else np.ascontiguousarray(target, dtype=np.float64),
            found=found,
        )  # fmt: skip

    def _begin(self, numbers: Array, start: Array | None) -> None:
        """Put states where they begin for the first rows, from their start at rest (0 if None)."""
        if self._states:
            at_rest = np.zeros(self._states) if start is None else start
            self._first(np.concatenate([numbers, at_rest]))
            self._run.starts[:] = self._first.found.T

    def at(self, numbers: Array, start: Array | None = None, *, settled: bool = False) -> Array:
        """Return the (N, K) results for numbers, which stand there until the next call.

        Parameters
        ----------
        numbers : those of the kernel, in their units.
        start : of each state, from which it begins; 0 where not given.
        settled : whether states begin at that start itself, wherever their inputs would have them.

        Raises
        ------
        OutsideError
            If a number is outside of what can be had here.
        """
        if settled and start is not None:
            self._run.starts[:] = start[:, None]
        else:
            self._begin(numbers, start)
        self._run(numbers)
        return self._run.found

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
        self._begin(numbers, None)
        return self._run.solved(numbers, non_negative, weights, keep=keep)

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
