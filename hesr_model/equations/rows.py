"""The compiled `rows.c`, and runs of programs on arrays."""

import ctypes
import platform
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hesr_model.equations.operations import NAMES, Program
from hesr_model.errors import ExportError, SimulationError
from hesr_model.support.arrays import Array
from hesr_model.support.compiler import MISSING_COMPILER, compile_c
from hesr_model.support.files import scratch_folder

BLOCK = 128
_LANES = 8  # as in rows.c
_BYTES = 8  # of a number

HOSTS = {
    ("linux", "x86_64"): ("x86_64-linux-gnu.2.17", ".so"),
    ("linux", "aarch64"): ("aarch64-linux-gnu.2.17", ".so"),
    ("darwin", "x86_64"): ("x86_64-macos.11.0", ".dylib"),
    ("darwin", "arm64"): ("aarch64-macos.11.0", ".dylib"),
    ("win32", "AMD64"): ("x86_64-windows-gnu", ".dll"),
}  # compiler target and library suffix of each machine
_FLAGS = (
    *("-std=c99", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden"),
    *("-Wall", "-Wextra", "-Werror", "-shared", "-nostdlib", "-g0", "-s"),
)
_LIBRARIES: Mapping[str, tuple[str, ...]] = {
    ".so": ("-lm",),
    ".dylib": ("-lc", "-Wl,-install_name,@rpath/rows.dylib"),  # not the path of the build
    # Headers and system library suffice; building the C library of Windows takes minutes.
    ".dll": (
        "-Wl,--no-entry",
        "-D_UCRT=",
        "-isystem",
        "{compiler}/lib/libc/include/any-windows-any",
        "-lapi-ms-win-crt-math-l1-1-0",
        "-lcompiler_rt",
    ),
}
_SOURCES = ("rows.c", "law_math.h")


_ADDRESSES = (
    *("operations", "inputs", "strides", "given", "firsts", "start", "carried", "places"),
    *("work", "results", "out", "target", "weights", "gram", "lanes", "columns"),
)
_NUMBERS = (
    *("uniform", "count", "input_count", "given_count", "first_count", "result_count"),
    *("lane_count", "registers", "uniform_count", "coming", "first", "stop", "block", "out_stride"),
)


class _ProgramStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in _ADDRESSES),
        *((name, ctypes.c_int64) for name in _NUMBERS),
        *((name, ctypes.c_double) for name in ("euler", "unstable")),
    )


def compile_rows(folder: Path, host: tuple[str, str]) -> Path:
    """Compile `rows.c` in a folder for a machine and return the library."""
    triple, suffix = HOSTS[host]
    for name in _SOURCES:
        Path(folder, name).write_bytes(Path(__file__).with_name(name).read_bytes())
    flags = ["-target", triple, *_FLAGS]
    if suffix != ".dll":
        flags.append("-fPIC")
    flags += [f"-D{name}={i}" for i, name in enumerate(NAMES)]
    file = Path(folder, f"rows{suffix}")
    compile_c(Path(folder, "rows.c"), tuple(flags), file, _LIBRARIES[suffix])
    return file


@cache
def library() -> ctypes.CDLL:
    """Return the compiled `rows.c`; raise ExportError if machine or compiler do not support it."""
    host = sys.platform, platform.machine()
    if host not in HOSTS:
        raise ExportError(
            f"laws cannot be run on {' '.join(host)}; supported are "
            f"{', '.join(map(' '.join, HOSTS))}."
        )
    try:
        with scratch_folder() as folder:
            rows_library = ctypes.CDLL(str(compile_rows(Path(folder), host)))
    except OSError as error:
        raise ExportError(
            f"the compiled laws cannot be loaded ({str(error).rstrip('.')}); set TMPDIR to a "
            "folder whose files may be executed."
        ) from error
    except (ExportError, ImportError) as error:
        if isinstance(error, ExportError) and error.code != MISSING_COMPILER:
            raise
        raise ExportError(
            f"the C compiler of the package 'ziglang' is missing: {str(error).rstrip('.')}; "
            "reinstall it.",
            code=MISSING_COMPILER,
        ) from error
    address = ctypes.c_void_p
    number = ctypes.c_int64
    rows_library.solve.argtypes = address, number, number, address, address, address
    rows_library.solve.restype = ctypes.c_bool
    return rows_library


@cache
def vectors() -> int:
    """Return the widest vectors of this machine, as numbered in `rows.c`."""
    return int(library().widest())


class _Buffer:
    """Arrays of numbers of 8 bytes in one allocation: each look-up of an address is slow."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        numbers = np.zeros(sum(sizes.values()))
        first_address = _address(numbers)
        self.views: dict[str, Array] = {}
        self.addresses: dict[str, int] = {}
        start = 0
        for name, size in sizes.items():
            self.views[name] = numbers[start : start + size]
            self.addresses[name] = first_address + _BYTES * start
            start += size

    def write_integers(self, name: str, values: Sequence[int]) -> None:
        """Write integers or addresses, which C reads as such, into an array."""
        self.views[name].view(np.int64)[:] = values


class ProgramRun:
    """Program bound to arrays (N,), with `results` (N, K) and initial states `starts`."""

    def __init__(
        self,
        program: Program,
        arrays: Sequence[Array],
        firsts: NDArray[np.int64],
        *,
        states: int = 0,
        euler: bool = False,
        block: int = BLOCK,
        target: Array | None = None,
        output: Array | None = None,
    ) -> None:
        self._rows = len(arrays[0])
        result_count = len(program.results)
        if output is None:
            output = np.empty((result_count, self._rows)).T
        self.results = output
        target_column = None if target is None else self._column(target)
        input_arrays = [arrays[i] for i in program.inputs]
        sizes = _measure_arrays(program, len(input_arrays), states, len(firsts))
        buffer = _Buffer(sizes)
        self._addresses = buffer.addresses
        self._constants = buffer.views["given"]
        self._constants[:] = program.constants
        self._numbers = program.numbers
        self.starts = buffer.views["start"].reshape(states, len(firsts))
        self.gram = buffer.views["gram"]
        self._x = buffer.views["x"]
        self._squares = buffer.views["squares"]
        buffer.write_integers("inputs", [_address(array) for array in input_arrays])
        buffer.write_integers("strides", [array.strides[0] // _BYTES for array in input_arrays])
        column_stride = self.results.strides[1]
        first_column = _address(self.results)
        buffer.write_integers(
            "out", [first_column + i * column_stride for i in range(result_count)]
        )
        self._keep_alive = (program, input_arrays, firsts, target_column)  # C uses their addresses
        operations_address, results_address = program.addresses
        self._struct = _ProgramStruct(
            **{name: buffer.addresses[name] for name in sizes if name in _ADDRESSES},
            operations=operations_address,
            uniform=program.uniform,
            count=len(program.operations),
            input_count=len(input_arrays),
            given_count=len(program.constants),
            uniform_count=program.uniform_count,
            registers=program.registers,
            euler=float(euler),
            firsts=_address(firsts),
            first_count=len(firsts),
            block=block,
            results=results_address,
            result_count=result_count,
            out_stride=self.results.strides[0] // _BYTES,
            lane_count=sizes["lanes"],
        )
        if target_column is not None:
            self._struct.target = _address(target_column)
        self._reference = ctypes.byref(self._struct)

    def _column(self, values: Array) -> Array:
        return np.ascontiguousarray(np.broadcast_to(values, (self._rows,)), dtype=np.float64)

    def run_rows(self, numbers: Array, first: int = 0, stop: int | None = None) -> None:
        """Write rows of the results, after all earlier rows."""
        if stop is None:
            stop = self._rows
        struct = self._struct
        struct.first = first
        struct.stop = stop
        struct.weights = None
        struct.gram = None
        struct.out = self._addresses["out"]
        self._run(numbers)

    def solve_factors(self, non_negative: int) -> tuple[Array, float] | None:
        """Return the factors from the last `multiply`; see `KernelRun.fit_factors`."""
        addresses = self._addresses
        is_determined = library().solve(
            addresses["gram"],
            len(self._x),
            non_negative,
            addresses["factors"],
            addresses["x"],
            addresses["squares"],
        )
        if not is_determined:
            return None
        return self._x.copy(), float(self._squares[0])

    def multiply(self, numbers: Array, weights: Array | None, *, keep: bool = False) -> Array:
        """Return the upper triangle (K + 1, K + 1) of products of results and target, last.

        `keep` also writes the results.
        """
        struct = self._struct
        addresses = self._addresses
        struct.first = 0
        struct.stop = self._rows
        struct.weights = None
        if weights is not None:
            column = self._column(weights)  # a name keeps it until C has read it
            struct.weights = _address(column)
        struct.gram = addresses["gram"]
        struct.out = None
        if keep:
            struct.out = addresses["out"]
        self._run(numbers)
        return self.gram.reshape(len(self._x) + 1, -1)

    def _run(self, numbers: Array) -> None:
        self._constants[self._numbers[0]] = numbers[self._numbers[1]]
        struct = self._struct
        if library().run(self._reference, vectors()):
            raise SimulationError(
                f"Euler needs 0 <= rate * step < 1, found {struct.unstable:.3g}; take a "
                "smaller step or the 'exact' discretisation."
            )


def _measure_arrays(
    program: Program, input_count: int, state_count: int, first_count: int
) -> dict[str, int]:
    """Return how many numbers of 8 bytes each array of a run has that `rows.c` reads or writes."""
    result_count = len(program.results)
    # Products of a result with all up to itself and with the target, four at a time.
    lane_groups = sum(-(-width // 4) for width in range(1, result_count + 2))
    return {
        "work": (program.registers + result_count + 11) * BLOCK,
        "lanes": 4 * _LANES * lane_groups,
        "gram": (result_count + 1) ** 2,
        "x": result_count,
        "squares": 1,
        "factors": result_count * (result_count + 3),
        "given": len(program.constants),
        "start": state_count * first_count,
        "carried": state_count,
        "inputs": input_count,
        "strides": input_count,
        "out": result_count,
        "places": program.registers,
        "columns": result_count + 4,
    }


def _address(array: NDArray[np.generic]) -> int:
    return int(array.ctypes.data)
