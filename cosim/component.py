"""One FMU as a co-simulation slave, run by FMPy: values by name, always freed."""

import ctypes
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, chdir, suppress
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Integer,
    fmi2Real,
    fmi2ValueReference,
)
from fmpy.model_description import ModelDescription, ScalarVariable, read_model_description
from numpy.typing import NDArray

from hesr_model.errors import SimulationError

Array = NDArray[np.float64]
Value = float | int | str | Sequence[float]
"""A start value: a number, a list for all elements of a vector, or the name of a choice."""


class Component:
    """A slave; a context manager that frees the instance and its files on every way out.

    Parameters
    ----------
    fmu : the FMU, FMI 2.0 for co-simulation.
    name : name of the instance; the file's stem where not given.

    Raises
    ------
    SimulationError
        By every method: naming the FMU, the time, and the variable where it is one's fault.

    Examples
    --------
    >>> with Component(Path("Friction.fmu")) as friction:
    ...     friction.initialise(start={"dq[1]": 0.2})
    ...     friction.step(0.0, 0.005)
    ...     friction.get(["tau[1]"])
    """

    description: ModelDescription

    def __init__(self, fmu: Path, *, name: str | None = None) -> None:
        self.fmu = fmu
        self.name = name or fmu.stem
        self.time = 0.0
        self.messages: list[str] = []
        self._stepping = False
        self.used = False
        """Whether an initialisation has begun, so that a reset is needed before another one."""
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        """Extract, load and instantiate."""
        with ExitStack() as cleanup:
            folder = cleanup.enter_context(TemporaryDirectory(prefix="hesr-"))
            binaries = f"binaries/{fmpy.platform}/"
            try:
                self.description = read_model_description(self.fmu, validate=False)
                fmpy.extract(
                    self.fmu, folder, lambda name: name.startswith((binaries, "resources/"))
                )
            except Exception as error:  # FMPy raises bare exceptions
                raise SimulationError(f"{self.fmu}: not a readable FMU ({error}).") from error
            self._variables = {v.name: v for v in self.description.modelVariables}
            self._slave = self._loaded(Path(folder))
            cleanup.callback(self._slave.freeLibrary)
            self._instantiate()
            cleanup.callback(self._free)
            self._cleanup = cleanup.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Free the instance, unload the library and remove the extracted files."""
        self._cleanup.close()

    def _loaded(self, folder: Path) -> FMU2Slave:
        about = self.description
        if about.fmiVersion != "2.0" or about.coSimulation is None:
            raise SimulationError(f"{self.fmu}: not an FMU of FMI 2.0 for co-simulation.")
        identifier = about.coSimulation.modelIdentifier
        library = f"binaries/{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"
        if not (folder / library).is_file():
            raise SimulationError(
                f"{self.fmu}: has no binary for this platform; needed is {library}."
            )
        try:
            # FMPy changes the working directory and, if loading fails, does not change it back.
            with chdir(folder):
                return FMU2Slave(
                    guid=about.guid,
                    modelIdentifier=identifier,
                    unzipDirectory=str(folder),
                    instanceName=self.name,
                )
        except Exception as error:  # FMPy raises bare exceptions
            raise SimulationError(f"{self.fmu}: its binary cannot be loaded ({error}).") from error

    def _instantiate(self) -> None:
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(self._log)
        try:
            self._slave.instantiate(callbacks=callbacks)
        except Exception as error:  # FMPy raises bare exceptions
            raise self._failure(error) from error

    def _free(self) -> None:
        if self._stepping:
            # A slave that refuses to end has to be freed all the same.
            with suppress(FMICallException):
                self._slave.fmi2Terminate(self._slave.component)
        self._slave.fmi2FreeInstance(self._slave.component)

    def _log(self, _environment: Any, _name: bytes, status: int, _kind: bytes, text: bytes) -> None:
        del status
        self.messages.append(text.decode("utf-8", errors="replace"))

    def _failure(self, error: Exception) -> SimulationError:
        self._stepping = False
        reason = self.messages[-1] if self.messages else str(error)
        return SimulationError(
            f"{self.fmu.name} ('{self.name}') at t = {self.time:.9g} s: {reason}"
        )

    def _call(self, function: Any, *arguments: Any) -> None:
        try:
            function(self._slave.component, *arguments)
        except FMICallException as error:
            raise self._failure(error) from error

    def variable(self, name: str) -> ScalarVariable:
        """Return the description of a variable."""
        try:
            return self._variables[name]
        except KeyError:
            near = get_close_matches(name, self._variables, n=3)
            known = f"; did you mean {', '.join(near)}" if near else ""
            raise SimulationError(f"{self.fmu}: there is no variable '{name}'{known}.") from None

    def elements(self, name: str) -> list[str]:
        """Return the variables that a name stands for: itself, or all elements of a vector."""
        if name in self._variables or f"{name}[1]" not in self._variables:
            return [self.variable(name).name]
        vector = re.compile(rf"{re.escape(name)}\[(\d+(,\d+)*)\]")
        return [variable for variable in self._variables if vector.fullmatch(variable)]

    @property
    def feedthrough(self) -> dict[str, list[str]]:
        """For each output the inputs on which it depends directly, all where none are declared."""
        inputs = [v.name for v in self._variables.values() if v.causality == "input"]
        found = {}
        for unknown in self.description.outputs:
            needed = unknown.dependencies
            found[unknown.variable.name] = (
                inputs if needed is None else [v.name for v in needed if v.causality == "input"]
            )
        return found

    def expanded(self, values: Mapping[str, Value]) -> dict[str, float]:
        """Return numbers by variable, from numbers, lists for vectors, and names of choices."""
        numbers: dict[str, float] = {}
        for name, value in values.items():
            elements = self.elements(name)
            if isinstance(value, str):
                numbers[name] = self._choice(name, value)
                continue
            parts = list(value) if isinstance(value, tuple | list) else [value] * len(elements)
            if len(parts) != len(elements):
                raise SimulationError(
                    f"{self.fmu}: '{name}' has {len(elements)} elements; {len(parts)} values are "
                    "given."
                )
            numbers |= dict(zip(elements, parts, strict=True))
        return numbers

    def _choice(self, name: str, value: str) -> int:
        declared = self.variable(name).declaredType
        items = {
            item.name: int(item.value) for item in (declared.items if declared else None) or ()
        }
        if value not in items:
            known = f"needed is one of {', '.join(items)}" if items else "it has no choices"
            raise SimulationError(f"{self.fmu}: '{name}' cannot be '{value}'; {known}.")
        return items[value]

    def initialise(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Mapping[str, float] | None = None,
    ) -> None:
        """Set parameters, start values and inputs, and go through the initialisation.

        Parameters
        ----------
        time, stop : start and end of the experiment [s].
        start : values of parameters, states and inputs by name.
        """
        self.enter_initialisation(time=time, stop=stop, start=start)
        self.exit_initialisation()

    def enter_initialisation(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Mapping[str, float] | None = None,
    ) -> None:
        """Do the first half of `initialise`; inputs may be set and outputs read after it."""
        self.time = time
        self.used = True
        defined = stop is not None
        self._call(self._slave.fmi2SetupExperiment, False, 0.0, time, defined, stop or 0.0)
        self.set(start or {})
        self._call(self._slave.fmi2EnterInitializationMode)

    def exit_initialisation(self) -> None:
        """Do the second half of `initialise`; steps may follow."""
        self._call(self._slave.fmi2ExitInitializationMode)
        self._stepping = True

    def step(self, time: float, step: float) -> None:
        """Go from `time` to `time + step` [s]."""
        self.time = time
        self._call(self._slave.fmi2DoStep, time, step, True)
        self.time = time + step

    def reset(self) -> None:
        """Go back to before the initialisation, with all start values."""
        self._stepping = False
        self._call(self._slave.fmi2Reset)

    def set(self, values: Mapping[str, float]) -> None:
        """Set variables of any numeric type by name."""
        reals = {n: x for n, x in values.items() if self.variable(n).type == "Real"}
        if reals:
            batch = self.batch(list(reals))
            batch.values[:] = list(reals.values())
            batch.write()
        integers = [n for n in values if n not in reals]
        if integers:
            numbers = (fmi2Integer * len(integers))(*(int(values[n]) for n in integers))
            references = self._references(integers)
            self._call(self._slave.fmi2SetInteger, references, len(integers), numbers)

    def get(self, names: Iterable[str]) -> Array:
        """Return Real variables, in the order of their names."""
        return self.batch(list(names)).read().copy()

    def batch(self, names: Sequence[str]) -> "Batch":
        """Return a buffer by which the same Real variables are set or read again and again."""
        for name in names:
            if self.variable(name).type != "Real":
                raise SimulationError(f"{self.fmu}: variable '{name}' is not a Real.")
        return Batch(self, self._references(names))

    def slopes(self, names: Sequence[str]) -> Callable[[Array], None]:
        """Return a function that sets the slopes of inputs, (n,) per second, for the next step."""
        references = self._references(names)
        orders = (fmi2Integer * len(names))(*[1] * len(names))
        values = (fmi2Real * len(names))()

        def set_slopes(slopes: Array) -> None:
            values[:] = slopes.tolist()
            function = self._slave.fmi2SetRealInputDerivatives
            self._call(function, references, len(names), orders, values)

        return set_slopes

    def _references(self, names: Sequence[str]) -> Any:
        return (fmi2ValueReference * len(names))(
            *(self.variable(name).valueReference for name in names)
        )


class Batch:
    """Values of several Real variables in one buffer; made by `Component.batch`.

    Attributes
    ----------
    values : (n,) the buffer.
    """

    def __init__(self, component: Component, references: Any) -> None:
        self._component = component
        self._references = references
        self._count = len(references)
        self._buffer = (fmi2Real * self._count)()
        self.values: Array = np.frombuffer(self._buffer, dtype=np.float64)
        self._set = component._slave.fmi2SetReal
        self._get = component._slave.fmi2GetReal
        self._pointer = ctypes.cast(self._buffer, ctypes.POINTER(fmi2Real))

    def write(self) -> None:
        """Set the variables to `values`."""
        self._component._call(self._set, self._references, self._count, self._pointer)

    def read(self) -> Array:
        """Read the variables into `values` and return these."""
        self._component._call(self._get, self._references, self._count, self._pointer)
        return self.values
