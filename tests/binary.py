"""A minimal binding to an FMU's binary."""

import ctypes
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

CALLBACK = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)


class Callbacks(ctypes.Structure):
    _fields_ = (
        ("logger", CALLBACK),
        ("allocateMemory", ctypes.c_void_p),
        ("freeMemory", ctypes.c_void_p),
        ("stepFinished", ctypes.c_void_p),
        ("componentEnvironment", ctypes.c_void_p),
    )


class EventInfo(ctypes.Structure):
    _fields_ = (
        ("newDiscreteStatesNeeded", ctypes.c_int),
        ("terminateSimulation", ctypes.c_int),
        ("nominalsOfContinuousStatesChanged", ctypes.c_int),
        ("valuesOfContinuousStatesChanged", ctypes.c_int),
        ("nextEventTimeDefined", ctypes.c_int),
        ("nextEventTime", ctypes.c_double),
    )


class Message(NamedTuple):
    """Messages from an instance to its host."""

    environment: int | None
    instance: str
    text: str
    status: int
    category: str


class Binary:
    """The functions of an FMU's binary, without a binding that enforces their order."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        from fmpy import read_model_description

        self.about = read_model_description(fmu)
        self.vr = {v.name: v.valueReference for v in self.about.modelVariables}
        identifier = self.about.coSimulation.modelIdentifier
        with zipfile.ZipFile(fmu) as archive:
            path = archive.extract(f"binaries/linux64/{identifier}.so", folder)
        self._library = ctypes.CDLL(path)
        self.messages: list[Message] = []
        self.host = Callbacks()
        self.host.logger = CALLBACK(self._log)
        self.host.componentEnvironment = 4711

    def _log(self, environment, name, status, category, text):
        message = Message(environment, name.decode(), text.decode(), status, category.decode())
        self.messages.append(message)

    def __call__(self, function: str, *arguments: Any) -> int:
        f = getattr(self._library, f"fmi2{function}")
        return f(*(ctypes.c_double(a) if isinstance(a, float) else a for a in arguments))

    def instantiate(
        self, name=b"one", kind=1, guid=None, host="own", logging=0
    ) -> ctypes.c_void_p | None:
        """Make an instance; kind 0 is model exchange, 1 is co-simulation."""
        f = self._library.fmi2Instantiate
        f.restype = ctypes.c_void_p
        guid = self.about.guid.encode() if guid is None else guid
        callbacks = ctypes.byref(self.host) if host == "own" else host
        c = f(name, kind, guid, None, callbacks, 0, logging)
        return None if c is None else ctypes.c_void_p(c)

    def ready(self, **more: Any) -> ctypes.c_void_p:
        c = self.instantiate(**more)
        assert self("SetupExperiment", c, 0, 0.0, 0.0, 0, 0.0) == 0
        assert self("EnterInitializationMode", c) == 0
        assert self("ExitInitializationMode", c) == 0
        return c

    def continuous(self, inputs: Mapping[str, float] | None = None, **more: Any) -> ctypes.c_void_p:
        """An instance for model exchange in continuous-time mode."""
        c = self.ready(kind=0, **more)
        assert self.set_all(c, inputs or {}) == 0
        self.event(c)
        return c

    def event(self, c: Any, values: Mapping[str, float] | None = None) -> None:
        """Pass through event mode, which allows setting values, to continuous-time mode."""
        assert self("EnterEventMode", c) == 0
        assert self.set_all(c, values or {}) == 0
        assert self("NewDiscreteStates", c, ctypes.byref(EventInfo())) == 0
        assert self("EnterContinuousTimeMode", c) == 0

    def numbers(self, function: str, c: Any, n: int) -> list[float]:
        """Array returned by a function: states, derivatives or indicators."""
        values = (ctypes.c_double * n)()
        assert self(function, c, values, n) == 0
        return list(values)

    def references(self, names: Sequence[str]) -> Any:
        return (ctypes.c_uint * len(names))(*(self.vr[n] for n in names))

    def set(self, c: Any, **values: float) -> int:
        return self.set_all(
            c, {"tau_load[1]" if n == "tau_load" else f"{n}[1]": x for n, x in values.items()}
        )

    def set_all(self, c: Any, values: Mapping[str, float]) -> int:
        numbers = (ctypes.c_double * len(values))(*values.values())
        return self("SetReal", c, self.references(list(values)), len(values), numbers)

    def get(self, c: Any, *names: str) -> list[float]:
        values = (ctypes.c_double * len(names))()
        assert self("GetReal", c, self.references(names), len(names), values) == 0
        return list(values)

    def step(self, c: Any, time: float, step: float) -> int:
        return self("DoStep", c, float(time), float(step), 1)
