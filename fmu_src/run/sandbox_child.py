"""Server of FMUs in a child process.

Arrays are texts in base 64. The file `SHARED` begins with the running call (`StepRecord`), followed
by values and recorded rows of a system.
"""

import base64
import ctypes
import mmap
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hesr_model.support import child_main
from hesr_model.support.child_main import MAX_MESSAGE_LENGTH, Connection

if TYPE_CHECKING:
    from fmu_src.run.instance import Instance, LocalBuffer
    from fmu_src.run.native import StepRecord

MAX_MESSAGES = 100
"""Number of the last messages of an FMU that are forwarded."""

# Largest text of an answer of an FMU.
MAX_ANSWER_BYTES = 4 * MAX_MESSAGES * MAX_MESSAGE_LENGTH
SHARED = "shared"
HEAD = 24  # bytes of `StepRecord`
LAYOUT_FIELDS: dict[str, Any] = dict.fromkeys(("begin", "step", "low", "high"), float)
LAYOUT_FIELDS |= {"rows": "intp", "limited": "intp"}  # parts of a layout, and types


@dataclass
class _Slave:
    """A component of a system that is stepped in Python."""

    instance: "Instance"
    number: int
    progress: "StepRecord"
    time: float = 0.0

    def step(self, time: float, step_size: float) -> None:
        from fmu_src.run.native import End

        self.progress.station, self.progress.call = self.number, End.STEP_FAILED
        self.instance.step(time, step_size)


class _Host:
    def __init__(self) -> None:
        self._instance_number = 0
        self._messages: list[tuple[int, int, str]] = []  # number of the instance, status, text
        self._instances: list[Instance] = []
        self._buffers: list[LocalBuffer] = []
        self._file = Path(SHARED).open("r+b")  # noqa: SIM115  # as long as the process
        self._shared = mmap.mmap(self._file.fileno(), HEAD)

    def _tell(self, instance_number: int, status: int, text: str) -> None:
        self._messages.append((instance_number, status, text[:MAX_MESSAGE_LENGTH]))
        del self._messages[:-MAX_MESSAGES]

    def answer_calls(
        self, instance_number: int, calls: Sequence[Sequence[Any]], ahead: Sequence[int]
    ) -> dict[str, Any]:
        """Do the calls, and read buffers speculatively."""
        from fmu_src.run.instance import CallError, LoadError

        answer: dict[str, Any] = {"results": [], "ahead": []}
        self._instance_number = instance_number
        try:
            for position, (method, *arguments) in enumerate(calls):
                self._note(position)
                call = getattr(self, f"_{method}", None) or getattr(
                    self._instances[instance_number], method
                )
                answer["results"].append(call(*arguments))
        except LoadError as error:
            answer["unloadable"] = str(error)[:MAX_MESSAGE_LENGTH]
            ahead = ()
        except CallError as error:
            answer["failed"] = str(error)[:MAX_MESSAGE_LENGTH]
            ahead = ()
        messages, self._messages = self._messages, []
        with suppress(CallError):  # it will be read again if needed
            for position, number in enumerate(ahead, start=len(calls)):
                self._note(position)
                answer["ahead"].append(self._read(number))
                messages += self._messages
                self._messages = []
        self._messages = []
        return answer | {"messages": messages}

    def _note(self, position: int) -> None:
        struct.pack_into("=q", self._shared, HEAD - 8, position)

    def _load(self, fmu: dict[str, Any]) -> None:
        from fmu_src.run.instance import UnpackedFmu
        from fmu_src.run.loader import load_instance

        self._instances.append(
            load_instance(UnpackedFmu(**fmu), partial(self._tell, self._instance_number))
        )

    def _buffer(self, references: Sequence[int]) -> None:
        self._buffers.append(self._instances[self._instance_number].buffer(references))

    def _write(self, number: int, values: str) -> None:
        buffer = self._buffers[number]
        buffer.values.data.cast("B")[:] = base64.b64decode(values)
        buffer.write()

    def _read(self, number: int) -> str:
        return base64.b64encode(self._buffers[number].read().tobytes()).decode()

    def _close(self, stepping: bool) -> None:
        self._instances[self._instance_number].close(stepping=stepping)

    def _system(
        self,
        stations: Sequence[Any],
        size: Sequence[int],
        layout_fields: Mapping[str, Any],
        library: str,
    ) -> None:
        """Prepare the steps of a system, whose values and rows are in the shared file."""
        import numpy as np

        from fmu_src.run.master import ExchangeScheme, Layout, PythonStepper, Station
        from fmu_src.run.native import StepRecord, native_stepper

        values, rows, width = size
        self._shared = mmap.mmap(self._file.fileno(), 0)
        self._progress = StepRecord.from_buffer(self._shared)
        shared = np.frombuffer(self._shared, dtype=float, offset=HEAD)
        signal_values = shared[:values]
        recorded_rows = shared[values : values + rows * width].reshape(rows, width)
        system_stations = []
        first = 0
        for i, (instance_number, every, inputs, sources, outputs) in enumerate(stations):
            instance = self._instances[instance_number]
            part = signal_values[first : first + len(outputs)]
            first += len(outputs)
            system_stations.append(
                Station(
                    slave=_Slave(instance, i, self._progress),
                    every=every,
                    inputs=instance.buffer(inputs),
                    sources=np.array(sources, dtype=np.intp),
                    outputs=instance.buffer(outputs, part),
                    begin=layout_fields["begin"],
                )
            )
        arrays: dict[str, Any] = {
            n: np.array(layout_fields[n], kind)[()] for n, kind in LAYOUT_FIELDS.items()
        }
        layout = Layout(
            stations=tuple(system_stations),
            links=(),
            scheme=ExchangeScheme(order=layout_fields["order"]),
            values=signal_values,
            names=(("", ""),) * values,
            **arrays,
        )
        compiled = None
        if library:
            compiled = native_stepper(layout, ctypes.CDLL(library), self._progress)
        self._stepper = compiled or PythonStepper(layout)
        self._stepper.begin(recorded_rows)

    def _advance(self, stop: int) -> None:
        """Step until `stop` rows are recorded, a value is not finite or outside its limits."""
        from hesr_model.errors import SimulationError

        with suppress(SimulationError):  # limits, which the parent checks
            try:
                self._stepper.advance(stop)
            finally:
                self._progress.done = self._stepper.done


def serve(connection: Connection) -> None:
    """Serve FMUs, and run functions, until the connection ends."""
    host = _Host()
    child_main.serve(connection, lambda request: host.answer_calls(**request))
