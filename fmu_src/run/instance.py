"""One instance of an FMU of FMI 2.0 or 3.0, loaded by FMPy into this process."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import chdir, suppress
from ctypes import POINTER, byref, c_bool, c_double, c_int, c_uint
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, NoReturn, Protocol

import fmpy
import numpy as np
from fmpy import fmi2, fmi3
from fmpy.fmi1 import FMICallException

from fmu_src.run.variables import Declared, split_reference
from hesr_model.support.arrays import Array

PLATFORM: str = fmpy.platform  # in FMI 2.0
SUFFIX: str = fmpy.sharedLibraryExtension
WARNING = 1  # highest status of a call that has succeeded; OK is 0
_DISCARD = 2
_FATAL = 4
_STATUSES = range(6)  # after other values, and 4, an instance must not be called

Call = Callable[..., None]  # calls a function by name with arguments after the instance
Tell = Callable[[int, str], None]  # receives status and text of a message
Failure = Callable[[Exception], Exception]
"""Turns a `CallError` or `DiedError` into the error that is raised."""


class LoadError(Exception):
    """A binary cannot be loaded; the text says why."""


class CallError(Exception):
    """A function of an FMU has failed; without a status, `function` is the message."""

    def __init__(self, function: str, status: int | None = None) -> None:
        text = function
        if status is not None:
            text = str(FMICallException(function=function, status=status))
        super().__init__(text)
        self.function = function
        self.status = status


@dataclass(frozen=True, kw_only=True)
class UnpackedFmu:
    """An FMU in a folder, ready to be loaded."""

    folder: str
    guid: str
    identifier: str
    name: str  # of the instance
    fmi: int = 2  # major version
    variables: Sequence[Declared] = ()  # of FMI 3.0
    exchange: bool = False  # model exchange instead of co-simulation
    states: int = 0
    indicators: int = 0  # numbers of continuous states and event indicators
    completes_steps: bool = False  # whether it asks for completed steps of the integrator
    tolerance: float = 1e-5  # relative, of the solver

    to_json = asdict


_TO_C: Mapping[str, Callable[[Any], Any]] = {"String": str.encode, "Float32": float}
"""Python value of a variable for ctypes, by type; others are integers."""


class Buffer(Protocol):
    """Values (n,) of Real variables of an FMU in any process, in their units."""

    values: Array

    def write(self) -> None:
        """Set the variables; a failure may surface at the next call."""

    def read(self) -> Array:
        """Read and return the variables."""


def _logger(tell: Tell) -> Callable[..., None]:
    def log(*arguments: Any) -> None:
        status, _category, text = arguments[-3:]
        tell(status, (text or b"").decode("utf-8", errors="replace"))

    return log


class _Fmi2:
    """FMI 2.0; `functions` maps each method of `Instance` and `Buffer` to its function."""

    folder = f"binaries/{fmpy.platform}/"
    functions: Mapping[str, str] = {
        "setup": "fmi2SetupExperiment",
        "enter_initialisation": "fmi2EnterInitializationMode",
        "exit_initialisation": "fmi2ExitInitializationMode",
        "reset": "fmi2Reset",
        "write": "fmi2SetReal",
        "read": "fmi2GetReal",
        "set": "fmi2Set",
        "get": "fmi2Get",
        "set_slopes": "fmi2SetRealInputDerivatives",
        "step": "fmi2DoStep",
        "terminate": "fmi2Terminate",
        "free": "fmi2FreeInstance",
    }
    models = fmi2.FMU2Model
    slaves = fmi2.FMU2Slave

    def instantiate(self, slave: Any, tell: Tell, *, logs: bool = False) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_logger(tell))
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        slave.instantiate(callbacks=callbacks, loggingOn=logs)

    def setup(self, call: Call, time: float, stop: float | None) -> None:
        call(self.functions["setup"], False, 0.0, time, stop is not None, stop or 0.0)

    def enter(self, call: Call, _time: float, _stop: float | None) -> None:
        call(self.functions["enter_initialisation"])

    def explain_discard(self, slave: Any) -> str:
        """Return why the simulation must end after a discarded step, or ""."""
        try:
            ended = slave.getBooleanStatus(fmi2.fmi2Terminated)
        except Exception:  # FMPy raises bare exceptions; tools may lack the function
            return ""
        if not ended:
            return ""
        return "fmi2DoStep requested termination"

    def kind(self, kind: str, _declared: str | None) -> tuple[str, Any]:
        """Return suffix of the functions and C type for a type of variable."""
        return kind, {"Boolean": c_int, "Integer": c_int, "String": fmi2.fmi2String}[kind]

    def values(self, pointer: Any, _count: int) -> tuple[Any, ...]:
        """Return the arguments that pass values."""
        return (pointer,)

    def set_slopes(self, call: Call, references: list[int], slopes: list[float]) -> str:
        """Set the slopes of inputs [unit/s]; return why it is impossible, or ""."""
        n = len(references)
        call(
            self.functions["set_slopes"],
            (fmi2.fmi2ValueReference * n)(*references),
            n,
            (fmi2.fmi2Integer * n)(*[1] * n),
            (fmi2.fmi2Real * n)(*slopes),
        )
        return ""

    def step(self, call: Call, time: float, size: float) -> str:
        """Step from a time [s] by a size [s]; return why the simulation must end, or ""."""
        call("fmi2DoStep", time, size, fmi2.fmi2True)
        return ""


class _Fmi3(_Fmi2):
    """FMI 3.0, where it differs; it passes the experiment on entering the initialisation."""

    folder = f"binaries/{fmpy.platform_tuple}/"
    functions = {name: text.replace("fmi2", "fmi3") for name, text in _Fmi2.functions.items()} | {
        "write": "fmi3SetFloat64",
        "read": "fmi3GetFloat64",
    }
    models = fmi3.FMU3Model
    slaves = fmi3.FMU3Slave

    def instantiate(self, slave: Any, tell: Tell, *, logs: bool = False) -> None:
        slave.instantiate(logMessage=_logger(tell), loggingOn=logs)

    def setup(self, call: Call, time: float, stop: float | None) -> None:
        """Do nothing."""

    def enter(self, call: Call, time: float, stop: float | None) -> None:
        experiment = (c_bool(False), 0.0, time, c_bool(stop is not None), stop or 0.0)
        call(self.functions["enter_initialisation"], *experiment)

    def kind(self, kind: str, declared: str | None) -> tuple[str, Any]:
        default = {"Integer": "Int32"}.get(kind, kind)
        type_name = {None: default, "Enumeration": "Int64"}.get(declared, declared)
        return str(type_name), getattr(fmi3, f"fmi3{type_name}")

    def values(self, pointer: Any, count: int) -> tuple[Any, ...]:
        return pointer, count

    def set_slopes(self, _call: Call, _references: list[int], _slopes: list[float]) -> str:
        return "inputs have no derivatives in FMI 3.0"

    def step(self, call: Call, time: float, size: float) -> str:
        event = c_bool()
        end = c_bool()
        early = c_bool()
        last = c_double()
        results = [byref(result) for result in (event, end, early, last)]
        call("fmi3DoStep", time, size, c_bool(True), *results)
        if end.value:
            return "fmi3DoStep requested termination"
        if early.value:
            return "fmi3DoStep returned early"
        return ""


VERSIONS: Mapping[int, _Fmi2] = {2: _Fmi2(), 3: _Fmi3()}


class Instance:
    """An FMU in this process, called through FMPy's class for its version and kind.

    `held` are the last values of FMI 3.0 arrays, which are always set whole, by value reference.
    Raises LoadError if the binary cannot be loaded, and `failure` of a CallError if a call fails.
    """

    has_solver = False  # whether `step` is more than a call of the FMU

    def __init__(
        self, fmu: UnpackedFmu, tell: Tell, failure: Failure = lambda error: error
    ) -> None:
        self._failure = failure
        self.fmi = VERSIONS[fmu.fmi]
        self._starts = {array: list(starts) for array, _, _, starts in fmu.variables}
        self._types = {array: kind for array, _, kind, _ in fmu.variables}
        self.held = {array: list(starts) for array, starts in self._starts.items()}
        self._experiment: tuple[float, float | None] = (0.0, None)
        try:
            load = self.fmi.models if fmu.exchange else self.fmi.slaves
            # FMPy changes the working directory and may not restore it.
            with chdir(fmu.folder):
                self.slave = load(
                    guid=fmu.guid,
                    modelIdentifier=fmu.identifier,
                    unzipDirectory=fmu.folder,
                    instanceName=fmu.name,
                )
        except Exception as error:  # FMPy raises bare exceptions
            raise LoadError(str(error).replace(f"{fmu.folder}/", "")) from error
        self._usable = True
        for name, function in vars(self.slave.dll).items():  # FMPy accepts negative ones
            if name.startswith("fmi") and function.restype is c_int:
                function.errcheck = partial(_require_status, name)
        try:
            self.fmi.instantiate(self.slave, tell)
        except Exception as error:  # FMPy raises bare exceptions
            with suppress(Exception):  # many FMUs give their reason only if logging is on
                self.fmi.instantiate(self.slave, tell, logs=True)
            self.slave.freeLibrary()
            raise failure(CallError(str(error))) from error

    def call(self, function: str, *arguments: Any) -> None:
        """Call a function of the FMU; raise unless its status is OK or warning."""
        try:
            getattr(self.slave, function)(self.slave.component, *arguments)
        except FMICallException as error:
            self.fail(function, error.status)

    def ask(self, method: str, *arguments: Any) -> Any:
        """Call a method of FMPy's instance, such as "getFMUstate", and return its result."""
        try:
            return getattr(self.slave, method)(*arguments)
        except FMICallException as error:
            self.fail(error.function, error.status)

    def fail(self, function: str, status: int) -> NoReturn:
        """Raise the error of a function that returned a status."""
        self._usable = status in _STATUSES and status != _FATAL
        error = CallError(function, status)
        if function == "fmi2DoStep" and status == _DISCARD:
            reason = self.fmi.explain_discard(self.slave)
            if reason:
                error = CallError(reason)
        raise self._failure(error)

    def setup(self, time: float, stop: float | None) -> None:
        """Announce start and end of the experiment [s]."""
        self._experiment = time, stop
        self.fmi.setup(self.call, time, stop)

    def enter_initialisation(self) -> None:
        """Enter the initialisation."""
        self.fmi.enter(self.call, *self._experiment)

    def exit_initialisation(self) -> None:
        """Exit the initialisation."""
        self.call(self.fmi.functions["exit_initialisation"])

    def reset(self) -> None:
        """Return to the state before the initialisation."""
        self.call(self.fmi.functions["reset"])
        self.held.update({array: list(starts) for array, starts in self._starts.items()})

    def set(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of any type but Real, whose elements are "Float64"."""
        for reference, value in zip(references, values, strict=True):
            array, position = split_reference(reference)
            held = self.held.get(array, [value])
            held[position] = value
            name, c_type = self.fmi.kind(kind, self._types.get(array))
            c_values = [_TO_C.get(kind, int)(v) for v in held]
            function = self.fmi.functions["set"] + name
            pointer = (c_type * len(held))(*c_values)
            if kind not in _TO_C and list(pointer) != c_values:
                raise self._failure(CallError(f"{value} does not fit the type {name}"))
            self.call(function, (c_uint * 1)(array), 1, *self.fmi.values(pointer, len(held)))

    def get(self, kind: str, references: Sequence[int]) -> list[Any]:
        """Return variables of any type but Real."""
        read_values = []
        for reference in references:
            array, position = split_reference(reference)
            name, c_type = self.fmi.kind(kind, self._types.get(array))
            pointer = (c_type * len(self.held.get(array, (0,))))()
            function = self.fmi.functions["get"] + name
            self.call(function, (c_uint * 1)(array), 1, *self.fmi.values(pointer, len(pointer)))
            value = pointer[position]
            if kind == "String":
                value = (value or b"").decode(errors="replace")
            read_values.append(value)
        return read_values

    def set_slopes(self, references: Sequence[int], slopes: Sequence[float]) -> None:
        """Set the slopes of Real inputs [unit/s] for the next step."""
        reason = self.fmi.set_slopes(self.call, list(references), list(slopes))
        if reason:
            raise self._failure(CallError(reason))

    def step(self, time: float, size: float) -> None:
        """Step from a time [s] by a size [s]."""
        reason = self.fmi.step(self.call, time, size)
        if reason:
            raise self._failure(CallError(reason))

    def buffer(self, references: Sequence[int], values: Array | None = None) -> "LocalBuffer":
        """Return a buffer of Real variables in `values` (n,), contiguous and new by default."""
        if values is None:
            values = np.zeros(len(references))
        return LocalBuffer(self, references, values)

    def close(self, *, stepping: bool) -> None:
        """Terminate and free the instance, and unload the binary."""
        try:
            if stepping and self._usable:
                with suppress(FMICallException):  # it must be freed anyway
                    getattr(self.slave, self.fmi.functions["terminate"])(self.slave.component)
            if self._usable:
                getattr(self.slave, self.fmi.functions["free"])(self.slave.component)
        finally:
            self.slave.freeLibrary()

    def kill(self) -> None:
        """Free the instance without terminating the simulation."""
        self.close(stepping=False)


def _require_status(name: str, status: int, *_: object) -> int:
    if status not in _STATUSES:
        raise FMICallException(function=name, status=status)
    return status


class LocalBuffer:
    """Values of Real variables of an `Instance`; see `Buffer`.

    Unless `is_plain`, they are elements of the arrays with the value `references` (m,).
    """

    def __init__(self, instance: Instance, references: Sequence[int], values: Array) -> None:
        self.values = values
        self.instance = instance
        elements = [split_reference(reference) for reference in references]
        sizes = {array: len(instance.held.get(array, (0.0,))) for array, _ in elements}
        self._has_arrays = any(size != 1 for size in sizes.values())
        if self._has_arrays:
            self._arrays = list(sizes)
            first = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
            places = [first[array] + position for array, position in elements]
        else:
            self._arrays = [array for array, _ in elements]
            places = list(range(len(elements)))
        count = sum(sizes[array] for array in self._arrays)
        self._places = np.array(places, dtype=np.intp)
        self.is_plain = places == list(range(count))
        self._whole: Array = values if self.is_plain else np.zeros(count)
        self.references = np.array(self._arrays, dtype=np.uint32)
        functions = instance.fmi.functions
        self._write = functions["write"]
        self._read = functions["read"]
        pointer = self._whole.ctypes.data_as(POINTER(c_double))
        self._arguments = (
            self.references.ctypes.data_as(POINTER(c_uint)),
            len(self.references),
            *instance.fmi.values(pointer, self._whole.size),
        )

    def write(self) -> None:
        """Set the variables; other elements of their arrays keep their values."""
        held = self.instance.held
        if not self.is_plain:
            held_values: list[float] = []
            for array in self._arrays:
                held_values += held[array]
            self._whole[:] = held_values
            self._whole[self._places] = self.values
        self.instance.call(self._write, *self._arguments)
        if self._has_arrays:
            offset = 0
            for array in self._arrays:
                size = len(held[array])
                held[array][:] = self._whole[offset : offset + size].tolist()
                offset += size

    def read(self) -> Array:
        """Read and return the variables."""
        self.instance.call(self._read, *self._arguments)
        if not self.is_plain:
            self._whole.take(self._places, out=self.values)
        return self.values
