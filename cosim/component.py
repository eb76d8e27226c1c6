"""One FMU as a co-simulation slave, run by FMPy: values by name, always freed."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, chdir, suppress
from ctypes import c_double, c_int, c_void_p
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Integer,
    fmi2Real,
    fmi2ValueReference,
)
from fmpy.model_description import ModelDescription, read_model_description

from cosim.batch import WARNING, Array, Batch
from cosim.variables import Variables
from hesr_model.errors import SimulationError


def described(fmu: Path) -> ModelDescription:
    """Read what an FMU says of itself, without loading it.

    Raises
    ------
    SimulationError
        If it cannot be read.
    """
    try:
        return read_model_description(fmu, validate=False)
    except Exception as error:  # FMPy raises bare exceptions
        raise SimulationError(f"{fmu}: not a readable FMU ({error}).") from error


class Component:
    """A slave; a context manager that frees the instance and its files on every way out.

    Parameters
    ----------
    fmu : the FMU, FMI 2.0 for co-simulation.
    name : name of the instance; the file's stem where not given.

    Attributes
    ----------
    description : the FMU's own, once it is loaded.
    variables : look-up in it.
    time : that the FMU has reached, or at which the call began that failed [s].
    messages : what the FMU has told its host.
    used : whether an initialisation has begun, so that a reset is needed before another one.

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
    variables: Variables

    def __init__(self, fmu: Path, *, name: str | None = None) -> None:
        self.fmu = fmu
        self.name = name or fmu.stem
        self.time = 0.0
        self.messages: list[str] = []
        self.used = False
        self._complaint: str | None = None
        self._stepping = False
        self._cleanup = ExitStack()

    def __enter__(self) -> Self:
        """Extract, load and instantiate."""
        with ExitStack() as cleanup:
            folder = cleanup.enter_context(TemporaryDirectory(prefix="hesr-"))
            binaries = f"binaries/{fmpy.platform}/"
            self.description = described(self.fmu)
            try:
                fmpy.extract(
                    self.fmu, folder, lambda name: name.startswith((binaries, "resources/"))
                )
            except Exception as error:  # FMPy raises bare exceptions
                raise SimulationError(f"{self.fmu}: not a readable FMU ({error}).") from error
            self.variables = Variables(self.fmu, self.description)
            self._slave = self._loaded(Path(folder))
            cleanup.callback(self._slave.freeLibrary)
            self._instantiate()
            cleanup.callback(self._free)
            self._bind_step()
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
        callbacks.allocateMemory = defaultCallbacks.allocateMemory
        callbacks.freeMemory = defaultCallbacks.freeMemory
        try:
            self._slave.instantiate(callbacks=callbacks)
        except Exception as error:  # FMPy raises bare exceptions
            raise self._failure(error) from error

    def _bind_step(self) -> None:
        """Prepare the call of `step`, past FMPy's layer as in `Batch`."""
        self._do_step = self._slave.dll["fmi2DoStep"]
        self._instance = c_void_p(self._slave.component)
        self._from, self._size, self._final = c_double(), c_double(), c_int(1)

    def _free(self) -> None:
        if self._stepping:
            # A slave that refuses to end has to be freed all the same.
            with suppress(FMICallException):
                self._slave.fmi2Terminate(self._slave.component)
        self._slave.fmi2FreeInstance(self._slave.component)

    def _log(self, _environment: Any, _name: bytes, status: int, _kind: bytes, text: bytes) -> None:
        self.messages.append(text.decode("utf-8", errors="replace"))
        if status > WARNING:
            self._complaint = self.messages[-1]

    def _failure(self, error: Exception) -> SimulationError:
        self._stepping = False
        # A message of a call that went well says nothing about this one.
        reason, self._complaint = self._complaint or str(error), None
        return SimulationError(
            f"{self.fmu.name} ('{self.name}') at t = {self.time:.9g} s: {reason}"
        )

    def _fail(self, function: str, status: int) -> None:
        raise self._failure(FMICallException(function=function, status=status))

    def _call(self, function: Any, *arguments: Any) -> None:
        try:
            function(self._slave.component, *arguments)
        except FMICallException as error:
            raise self._failure(error) from error

    def initialise(
        self,
        *,
        time: float = 0.0,
        stop: float | None = None,
        start: Mapping[str, float | str] | None = None,
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
        start: Mapping[str, float | str] | None = None,
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
        self.time = self._from.value = time
        self._size.value = step
        status = self._do_step(self._instance, self._from, self._size, self._final)
        if status > WARNING:
            self._fail("fmi2DoStep", status)
        self.time = time + step

    def reset(self) -> None:
        """Go back to before the initialisation, with all start values."""
        self._stepping = False
        self._call(self._slave.fmi2Reset)
        self.used = False

    def set(self, values: Mapping[str, float | str]) -> None:
        """Set variables of any type by name; text for those of type String only."""
        kinds: dict[str, list[str]] = {}
        for name in values:
            kinds.setdefault(self.variables[name].type, []).append(name)
        for kind, names in kinds.items():
            chosen = [values[name] for name in names]
            if kind == "Real":
                batch = self.batch(names)
                batch.values[:] = chosen
                batch.write()
            elif kind in ("Boolean", "String"):
                setter = self._slave.setBoolean if kind == "Boolean" else self._slave.setString
                references = self.variables.references(names, kind)
                self._call(lambda _instance, r, c, setter=setter: setter(r, c), references, chosen)
            else:
                numbers = (fmi2Integer * len(names))(*map(int, chosen))
                places = self._references(names, kind)
                self._call(self._slave.fmi2SetInteger, places, len(names), numbers)

    def get(self, names: Iterable[str]) -> Array:
        """Return Real variables, (n,) in their units, in the order of their names."""
        return self.batch(list(names)).read()

    def batch(self, names: Sequence[str], values: Array | None = None) -> Batch:
        """Return a buffer by which the same Real variables are set or read again and again.

        Parameters
        ----------
        names : of the variables.
        values : (n,) contiguous memory to be that buffer, in the variables' units; its own where
            not given.
        """
        return Batch(
            library=self._slave.dll,
            instance=self._slave.component,
            references=self.variables.references(names, "Real"),
            values=np.zeros(len(names)) if values is None else values,
            fail=self._fail,
        )

    def slopes(self, names: Sequence[str]) -> Callable[[Array], None]:
        """Return a function that sets the slopes of inputs, (n,) [unit/s], for the next step."""
        references = self._references(names, "Real")
        orders = (fmi2Integer * len(names))(*[1] * len(names))
        values = (fmi2Real * len(names))()

        def set_slopes(slopes: Array) -> None:
            values[:] = slopes.tolist()
            function = self._slave.fmi2SetRealInputDerivatives
            self._call(function, references, len(names), orders, values)

        return set_slopes

    def _references(self, names: Sequence[str], kind: str) -> Any:
        return (fmi2ValueReference * len(names))(*self.variables.references(names, kind))
