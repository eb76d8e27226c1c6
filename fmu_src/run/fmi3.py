"""FMI 3.0 as FMPy calls it, where it differs from FMI 2.0."""

from collections.abc import Mapping
from ctypes import byref, c_bool, c_double
from typing import Any

import fmpy
from fmpy import fmi3

from fmu_src.run.fmi2 import Call, Fmi2, Tell


class Fmi3(Fmi2):
    """Names, types and signatures of FMI 3.0."""

    folder = f"binaries/{fmpy.platform_tuple}/"
    functions: Mapping[str, str] = {
        name: function.replace("fmi2", "fmi3") for name, function in Fmi2.functions.items()
    } | {"write": "fmi3SetFloat64", "read": "fmi3GetFloat64"}

    def slave(self, *, exchange: bool, **more: Any) -> Any:
        """Return FMPy's instance, not yet instantiated."""
        return (fmi3.FMU3Model if exchange else fmi3.FMU3Slave)(**more)

    def instantiate(self, slave: Any, tell: Tell) -> None:
        """Instantiate an FMU and pass on its messages."""

        def log(_environment: Any, status: int, _kind: bytes, text: bytes) -> None:
            tell(status, (text or b"").decode("utf-8", errors="replace"))

        slave.instantiate(logMessage=log)

    def setup(self, call: Call, time: float, stop: float | None) -> None:
        """Do nothing: FMI 3.0 passes the experiment on entering the initialisation."""

    def enter(self, call: Call, time: float, stop: float | None) -> None:
        """Enter the initialisation of an experiment [s]."""
        more = (c_bool(False), 0.0, time, c_bool(stop is not None), stop or 0.0)
        call(self.functions["enter_initialisation"], *more)

    def kind(self, kind: str, declared: str | None) -> tuple[str, Any]:
        """Return suffix of the functions and C type for a type of variable."""
        default = {"Integer": "Int32"}.get(kind, kind)
        own = {None: default, "Enumeration": "Int64"}.get(declared, declared)
        return str(own), getattr(fmi3, f"fmi3{own}")

    def values(self, pointer: Any, count: int) -> tuple[Any, ...]:
        """Return the arguments that pass values."""
        return pointer, count

    def set_slopes(self, call: Call, references: list[int], slopes: list[float]) -> None:  # noqa: ARG002 - FMI 3.0 has no such function
        """Refuse slopes of inputs."""
        raise ValueError("inputs have no derivatives in FMI 3.0")

    def step(self, call: Call, time: float, size: float) -> str:
        """Step from a time [s] by a size [s]; return why the simulation must end, or ""."""
        event, end, early, last = c_bool(), c_bool(), c_bool(), c_double()
        call(
            "fmi3DoStep", time, size, c_bool(True),
            byref(event), byref(end), byref(early), byref(last),
        )  # fmt: skip
        if end.value:
            return "fmi3DoStep asked for the end of the simulation"
        return "fmi3DoStep ended early, unasked" if early.value else ""
