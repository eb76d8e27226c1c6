"""A model simulated in Python as a slave of PythonFMU.

An FMU carries this file; everything else comes from HESR as the host's Python has it.
"""

import ctypes
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

from fmu_src.arm.python_fmu import ABOUT, MODEL, TABLE
from fmu_src.arm.signals import signals_of
from fmu_src.arm.simulation import Simulation
from hesr_model.errors import HesrError

_ROUNDING = 1e-6
"""By how much of the simulation's step times may be off."""


class PythonArm(Fmi2Slave):  # type: ignore[misc] # PythonFMU is not typed
    """Adapter of `Simulation`: value references are places in its table of variables."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        folder = Path(self.resources)
        table = folder / TABLE
        self._about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        self.modelName = self._about["identifier"]
        self._simulation = Simulation(
            signals_of(folder / MODEL, table if table.is_file() else None)
        )
        self._variables = self._simulation.variables
        self._values = [variable.start for variable in self._variables]
        self._inputs = self._places("input")
        self._outputs = self._places("output")
        self._parameters = self._places("fixed")
        self._running = False
        self._stale = True
        self._start = 0.0
        self._made = 0
        """Steps of the simulation since the start."""

    def _places(self, role: str) -> list[int]:
        return [k for k, variable in enumerate(self._variables) if variable.role == role]

    def to_xml(self, _options: object = None) -> ET.Element:
        """Return the description that was made with the FMU, dependencies included."""
        return ET.fromstring(self._about["xml"])

    def get_real(self, references: Sequence[int]) -> list[float]:
        """Return values, up to date with the parameters before the first step."""
        if not self._running and self._stale:
            self._begin()
        return [self._values[k] for k in references]

    def set_real(self, references: Sequence[int], values: Sequence[float]) -> None:
        """Take inputs, and parameters before the first step."""
        for k, value in zip(references, values, strict=True):
            self._values[k] = value
        self._stale = True

    def setup_experiment(
        self, start_time: float, stop_time: float | None, tolerance: float | None
    ) -> None:
        """Keep the time of the start [s]; the end and a tolerance mean nothing here."""
        del stop_time, tolerance
        self._start = start_time

    def exit_initialization_mode(self) -> None:
        """Put everything at its start."""
        self._begin()
        self._running = True
        self._made = 0

    def do_step(self, time: float, step: float) -> bool:
        """Simulate to the last multiple of the simulation's own step; say why if it cannot be done.

        Inputs are sampled and outputs held at these multiples, so that any step is right.
        """
        own = self._simulation.timestep
        due = math.floor((time + step - self._start) / own + _ROUNDING) - self._made
        if due < 1:
            return True
        inputs = [self._values[k] for k in self._inputs]
        try:
            outputs = self._simulation.step(inputs, due * own)
        except HesrError as error:
            self.log(str(error), Fmi2Status.discard)
            return False
        self._made += due
        self._show(outputs.tolist())
        return True

    def _begin(self) -> None:
        given = {self._variables[k].name: self._values[k] for k in self._parameters}
        try:
            outputs = self._simulation.reset(given)
        except HesrError:
            self._stay()
            raise
        self._show(outputs.tolist())
        self._stale = False

    def _stay(self) -> None:
        """Count what PythonFMU lets go of when a call raises: it does so again in the end."""
        for held in (self, type(self), self.log_queue):
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(held))

    def _show(self, outputs: Sequence[float]) -> None:
        for k, value in zip(self._outputs, outputs, strict=True):
            self._values[k] = value

    def _get_fmu_state(self) -> dict[str, Any]:
        return {
            "values": list(self._values),
            "running": self._running,
            "start": self._start,
            "made": self._made,
            "simulation": self._simulation.state(),
        }

    def _set_fmu_state(self, state: dict[str, Any]) -> None:
        self._values = list(state["values"])
        self._running, self._stale = state["running"], not state["running"]
        self._start, self._made = state["start"], state["made"]
        self._simulation.restore(state["simulation"])
