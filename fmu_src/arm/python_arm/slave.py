"""A simulated model as a PythonFMU slave."""

import ctypes
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmu_src.arm.python_arm.export import ABOUT, MODEL
from fmu_src.arm.python_arm.simulation import Simulation
from fmu_src.arm.signals import read_signals
from fmu_src.arm.table import SignalTable
from hesr_model.errors import HesrError

_ROUNDING = 1e-6  # tolerance of communication points, in steps of the simulation


class PythonArm(Fmi2Slave):  # type: ignore[misc] # PythonFMU is not typed
    """Adapter of `Simulation`; a value reference is an index into its variables."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        folder = Path(self.resources)
        self._about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        self.modelName = self._about["identifier"]
        table = None
        if self._about["signals"]:
            table = SignalTable.model_validate(self._about["signals"])
        self._simulation = Simulation(read_signals(folder / MODEL, table))
        self._variables = self._simulation.variables
        self._values = [variable.start for variable in self._variables]
        self._inputs = self._find_role("input")
        self._outputs = self._find_role("output")
        self._parameters = self._find_role("fixed")
        self._running = False
        self._stale = True
        self._start = 0.0  # [s]
        self._steps = 0  # of the simulation since the start

    def _find_role(self, role: str) -> list[int]:
        return [k for k, variable in enumerate(self._variables) if variable.role == role]

    def to_xml(self, _options: object = None) -> ET.Element:
        """Return the description made with the FMU, dependencies included."""
        return ET.fromstring(self._about["xml"])

    def get_real(self, references: Sequence[int]) -> list[float]:
        """Return values; before the first step they follow the parameters."""
        if not self._running and self._stale:
            self._reset()
        return [self._values[k] for k in references]

    def set_real(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Set inputs, and parameters before the first step."""
        for k, value in zip(references, values, strict=True):
            self._values[k] = value
        self._stale = True

    def get_integer(self, references: Sequence[int]) -> list[int]:
        """Return the halves of the noise's seed."""
        return [int(self._values[k]) for k in references]

    def set_integer(self, references: Sequence[int], values: Sequence[int]) -> None:
        """Set the halves of the noise's seed before the first step."""
        self.set_real(references, values)

    def setup_experiment(
        self, start_time: float, stop_time: float | None, tolerance: float | None
    ) -> None:
        """Store the start time [s]."""
        del stop_time, tolerance
        self._start = start_time

    def exit_initialization_mode(self) -> None:
        """Reset the simulation with the parameters."""
        self._reset()
        self._running = True
        self._steps = 0

    def do_step(self, time: float, step_size: float) -> bool:
        """Simulate to the last multiple of the simulation's own step; log a failure's reason."""
        timestep = self._simulation.timestep
        due = math.floor((time + step_size - self._start) / timestep + _ROUNDING) - self._steps
        if due < 1:
            return True
        try:
            outputs = self._simulation.step([self._values[k] for k in self._inputs], due * timestep)
        except HesrError as error:
            self.log(str(error), Fmi2Status.discard)
            return False
        self._steps += due
        self._show(outputs.tolist())
        return True

    def _reset(self) -> None:
        try:
            outputs = self._simulation.reset(
                {self._variables[k].name: self._values[k] for k in self._parameters}
            )
        except HesrError:
            # PythonFMU releases these when a call raises, and again at the end.
            for python_object in (self, type(self), self.log_queue):
                ctypes.pythonapi.Py_IncRef(ctypes.py_object(python_object))
            raise
        self._show(outputs.tolist())
        self._stale = False

    def _show(self, outputs: Sequence[float]) -> None:
        for k, value in zip(self._outputs, outputs, strict=True):
            self._values[k] = value

    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "values": list(self._values),
            "running": self._running,
            "start": self._start,
            "steps": self._steps,
            "simulation": self._simulation.state(),
        }

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        self._values = list(state["values"])
        self._running = state["running"]
        self._stale = not state["running"]
        self._start = state["start"]
        self._steps = state["steps"]
        self._simulation.restore(state["simulation"])
