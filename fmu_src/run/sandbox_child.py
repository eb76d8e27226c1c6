"""Process of a sandbox, which serves FMUs or runs functions by name.

python -m fmu_src.run.sandbox_child SOCKET READABLE [MODULE ...]

Messages are JSON after their length; arrays are texts in base 64. The file `SHARED` begins with the
running call (`StepRecord`), followed by values and recorded rows of a system. The process ends with
its parent. It may write in its folder and read below READABLE; see `sandbox_rights`.
"""

import base64
import ctypes
import importlib
import json
import mmap
import os
import signal
import socket
import struct
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fmu_src.run.sandbox_rights import give_up

if TYPE_CHECKING:
    from fmu_src.run.instance import Instance, LocalBuffer
    from fmu_src.run.native import StepRecord

MAX_MEMORY_BYTES = 4 << 30  # of the process
MAX_FILE_BYTES = 1 << 30
MAX_OPEN_FILES = 256  # at a time
MAX_MESSAGES = 100
MAX_MESSAGE_LENGTH = 2000
"""Number and size [characters] of the last messages of an FMU that are forwarded."""

# Largest text of an answer of an FMU.
MAX_ANSWER_BYTES = 4 * MAX_MESSAGES * MAX_MESSAGE_LENGTH
SHARED = "shared"
HEAD = 24  # bytes of `StepRecord`
LENGTH = struct.Struct("!I")
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
    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._process = os.getpid()
        self._instance_number = 0
        self._messages: list[tuple[int, int, str]] = []  # number of the instance, status, text
        self._instances: list[Instance] = []
        self._buffers: list[LocalBuffer] = []
        self._file = Path(SHARED).open("r+b")  # noqa: SIM115  # as long as the process
        self._shared = mmap.mmap(self._file.fileno(), HEAD)

    def serve(self) -> None:
        requests = self._connection.makefile("rb")
        while header := requests.read(LENGTH.size):
            request = json.loads(requests.read(*LENGTH.unpack(header)))
            reply = _run(*request["run"]) if "run" in request else self._answer_calls(**request)
            if os.getpid() != self._process:  # the FMU has forked: one process answers
                os._exit(0)
            answer = json.dumps(reply).encode()
            self._connection.sendall(LENGTH.pack(len(answer)) + answer)

    def _tell(self, instance_number: int, status: int, text: str) -> None:
        self._messages.append((instance_number, status, text[:MAX_MESSAGE_LENGTH]))
        del self._messages[:-MAX_MESSAGES]

    def _answer_calls(
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
        compiled = native_stepper(layout, ctypes.CDLL(library), self._progress) if library else None
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


def _run(function: str, *arguments: Any) -> dict[str, Any]:
    module, _, name = function.partition(":")
    try:
        return {"result": getattr(importlib.import_module(module), name)(*arguments)}
    except Exception as error:
        return {"raised": f"{type(error).__name__}: {error}"[:MAX_MESSAGE_LENGTH]}


def _limit() -> None:
    with suppress(ImportError):  # Windows has no such limits
        import resource

        for kind, limit in (
            (resource.RLIMIT_AS, MAX_MEMORY_BYTES),
            (resource.RLIMIT_FSIZE, MAX_FILE_BYTES),
            (resource.RLIMIT_NOFILE, MAX_OPEN_FILES),
            (resource.RLIMIT_CORE, 0),
        ):
            # A lower limit may be set already.
            hard = resource.getrlimit(kind)[1]
            effective_limit = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
            resource.setrlimit(kind, (effective_limit, effective_limit))


def _end_with_parent() -> None:
    with suppress(OSError):
        while os.read(0, 1):
            pass
    if hasattr(os, "killpg"):
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(1)


def main() -> None:
    """Serve the socket whose number is the first argument."""
    connection = socket.socket(fileno=int(sys.argv[1]))
    _limit()
    give_up(Path.cwd(), Path(sys.argv[2]))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    for name in sys.argv[3:]:  # while the parent works
        importlib.import_module(name)
    _Host(connection).serve()


if __name__ == "__main__":
    main()
