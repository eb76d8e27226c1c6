"""FMI 2.0 and 3.0 as FMPy calls them: names, types and signatures of their functions."""

from collections.abc import Callable, Mapping
from ctypes import byref, c_bool, c_double, c_int
from typing import Any

import fmpy
from fmpy import fmi2, fmi3

Call = Callable[..., None]  # calls a function by name with arguments after the instance
Tell = Callable[[int, str], None]  # receives status and text of a message


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
    models, slaves = fmi2.FMU2Model, fmi2.FMU2Slave

    def instantiate(self, slave: Any, tell: Tell) -> None:
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_logger(tell))
        callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
        slave.instantiate(callbacks=callbacks)

    def setup(self, call: Call, time: float, stop: float | None) -> None:
        call(self.functions["setup"], False, 0.0, time, stop is not None, stop or 0.0)

    def enter(self, call: Call, _time: float, _stop: float | None) -> None:
        call(self.functions["enter_initialisation"])

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
    models, slaves = fmi3.FMU3Model, fmi3.FMU3Slave

    def instantiate(self, slave: Any, tell: Tell) -> None:
        slave.instantiate(logMessage=_logger(tell))

    def setup(self, call: Call, time: float, stop: float | None) -> None:
        """Do nothing."""

    def enter(self, call: Call, time: float, stop: float | None) -> None:
        more = (c_bool(False), 0.0, time, c_bool(stop is not None), stop or 0.0)
        call(self.functions["enter_initialisation"], *more)

    def kind(self, kind: str, declared: str | None) -> tuple[str, Any]:
        default = {"Integer": "Int32"}.get(kind, kind)
        own = {None: default, "Enumeration": "Int64"}.get(declared, declared)
        return str(own), getattr(fmi3, f"fmi3{own}")

    def values(self, pointer: Any, count: int) -> tuple[Any, ...]:
        return pointer, count

    def set_slopes(self, _call: Call, _references: list[int], _slopes: list[float]) -> str:
        return "inputs have no derivatives in FMI 3.0"

    def step(self, call: Call, time: float, size: float) -> str:
        event, end, early, last = c_bool(), c_bool(), c_bool(), c_double()
        results = [byref(result) for result in (event, end, early, last)]
        call("fmi3DoStep", time, size, c_bool(True), *results)
        if end.value:
            return "fmi3DoStep requested termination"
        return "fmi3DoStep returned early" if early.value else ""


VERSIONS: Mapping[int, _Fmi2] = {2: _Fmi2(), 3: _Fmi3()}
