"""One instance of an FMU, loaded by FMPy into this process: functions, references, buffers."""

from collections.abc import Callable, Sequence
from contextlib import chdir, suppress
from ctypes import c_double, c_int, c_void_p
from dataclasses import asdict, dataclass
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    defaultCallbacks,
    fmi2Boolean,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
    fmi2Integer,
    fmi2Real,
    fmi2String,
    fmi2ValueReference,
)

from fmu_src.run.batch import WARNING, Batch
from fmu_src.run.variables import Declared
from hesr_model.support.arrays import Array

PLATFORM: str = fmpy.platform
"""This platform, as FMI 2.0 names it."""

BINARIES = {2: f"binaries/{PLATFORM}/", 3: f"binaries/{fmpy.platform_tuple}/"}
"""Folder of the binaries for this platform, in an FMU of a version of FMI."""

SUFFIX: str = fmpy.sharedLibraryExtension
"""Of a binary's name."""

_TYPES = {"Boolean": fmi2Boolean, "Integer": fmi2Integer, "String": fmi2String}


_RENAMED = {
    "fmi2SetReal": "fmi3SetFloat64",
    "fmi2GetReal": "fmi3GetFloat64",
    "fmi2SetInteger": "fmi3SetInt32",
}


def renamed(function: str, fmi: int) -> str:
    """Return what a function of FMI 2.0 is called in a version of FMI."""
    if fmi == 2:
        return function
    return _RENAMED.get(function, function.replace("fmi2", "fmi3"))


class LoadError(Exception):
    """A binary cannot be loaded; the text says why."""


class DiedError(Exception):
    """The process of an FMU gave no answer and is no more; the text says in which call and how."""


class CallError(Exception):
    """A function of an FMU has failed, or its instance cannot be made.

    Parameters
    ----------
    function : its name.
    status : that it gave; None where it says why in words.
    """

    def __init__(self, function: str, status: int | None = None) -> None:
        super().__init__(
            function if status is None else str(FMICallException(function=function, status=status))
        )
        self.status = status


@dataclass(frozen=True, kw_only=True)
class Binary:
    """What an instance is made of.

    Attributes
    ----------
    folder : of the unpacked FMU.
    guid, identifier : from its description.
    name : of the instance.
    fmi : version.
    variables : of FMI 3.0; see `fmu_src.run.variables`.
    """

    folder: str
    guid: str
    identifier: str
    name: str
    fmi: int = 2
    variables: Sequence[Declared] = ()

    to_json = asdict


class Instance:
    """An FMU in this process.

    Parameters
    ----------
    binary : what it is made of.
    tell : is given the status and the text of each message of the FMU.
    failure : makes what is raised of a `CallError`.

    Raises
    ------
    LoadError
        If its binary cannot be loaded.
    CallError
        By it and every method: if a function of the FMU fails.
    """

    def __init__(
        self,
        binary: Binary,
        tell: Callable[[int, str], None],
        failure: Callable[[Exception], Exception] = lambda error: error,
    ) -> None:
        self._tell, self._failure = tell, failure
        try:
            # FMPy changes the working directory and, if loading fails, does not change it back.
            with chdir(binary.folder):
                self._make(binary)
        except Exception as error:  # FMPy raises bare exceptions
            raise LoadError(str(error)) from error
        try:
            self._begin(binary)
        except Exception as error:  # FMPy raises bare exceptions
            self._slave.freeLibrary()
            raise failure(CallError(str(error))) from error

    def _make(self, binary: Binary) -> None:
        self._slave: Any = FMU2Slave(
            guid=binary.guid,
            modelIdentifier=binary.identifier,
            unzipDirectory=binary.folder,
            instanceName=binary.name,
        )

    def _begin(self, _binary: Binary) -> None:
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(self._log)
        callbacks.allocateMemory = defaultCallbacks.allocateMemory
        callbacks.freeMemory = defaultCallbacks.freeMemory
        self._slave.instantiate(callbacks=callbacks)
        # Past FMPy's layer as in `Batch`.
        self._do_step = self._slave.dll["fmi2DoStep"]
        self._instance = c_void_p(self._slave.component)
        self._from, self._size, self._final = c_double(), c_double(), c_int(1)

    def _log(self, _environment: Any, _name: bytes, status: int, _kind: bytes, text: bytes) -> None:
        self._tell(status, (text or b"").decode("utf-8", errors="replace"))

    def _fail(self, function: str, status: int) -> None:
        raise self._failure(CallError(function, status))

    def call(self, function: str, *arguments: float) -> None:
        """Call a function of the FMU that takes the instance and numbers."""
        self._do(function, *arguments)

    def put(self, kind: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of a type other than Real, text encoded in UTF-8."""
        if kind == "String":
            values = [text.encode() for text in values]
        n = len(references)
        places = (fmi2ValueReference * n)(*references)
        self._do(f"fmi2Set{kind}", places, n, (_TYPES[kind] * n)(*values))

    def slope(self, references: Sequence[int], slopes: Sequence[float]) -> None:
        """Set the slopes of Real inputs [unit/s] for the next step."""
        n = len(references)
        places, orders = (fmi2ValueReference * n)(*references), (fmi2Integer * n)(*[1] * n)
        self._do("fmi2SetRealInputDerivatives", places, n, orders, (fmi2Real * n)(*slopes))

    def _do(self, function: str, *arguments: Any) -> None:
        try:
            getattr(self._slave, function)(self._slave.component, *arguments)
        except FMICallException as error:
            raise self._failure(CallError(function, error.status)) from error

    def step(self, time: float, size: float) -> None:
        """Go from a time on by the size of a step [s]."""
        self._from.value = time
        self._size.value = size
        status = self._do_step(self._instance, self._from, self._size, self._final)
        if status > WARNING:
            self._fail("fmi2DoStep", status)

    def batch(self, references: Sequence[int], values: Array | None = None) -> Batch:
        """Return a buffer of Real variables.

        Parameters
        ----------
        references : of the variables.
        values : (n,) contiguous memory to be that buffer, in the variables' units; its own where
            not given.
        """
        return Batch(
            library=self._slave.dll,
            instance=self._slave.component,
            references=references,
            values=np.zeros(len(references)) if values is None else values,
            fail=self._fail,
        )

    def close(self, *, stepping: bool) -> None:
        """End the simulation, if it is stepping, free the instance and unload the binary."""
        try:
            if stepping:
                # A slave that refuses to end has to be freed all the same.
                with suppress(FMICallException):
                    self._end()
            self._free()
        finally:
            self._slave.freeLibrary()

    def _end(self) -> None:
        self._slave.fmi2Terminate(self._slave.component)

    def _free(self) -> None:
        self._slave.fmi2FreeInstance(self._slave.component)

    def kill(self) -> None:
        """Do the same where nobody wants to wait."""
        self.close(stepping=False)
