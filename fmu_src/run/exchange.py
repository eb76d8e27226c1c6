"""FMUs for model exchange, integrated by CVode between communication points.

An `ExchangeInstance` steps like a co-simulation slave. Inputs are set as for every `Instance`; each
such change is an event. Within a step, inputs with slopes follow them.
"""

from collections.abc import Callable, Sequence
from math import isclose
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.sundials import CVodeSolver

from fmu_src.run.instance import CallError, Failure, Instance, LocalBuffer, Tell, UnpackedFmu

_MAX_STEP_SHARE = 0.02  # of the solver, as a fraction of the run; that of FMPy
_MAX_EVENTS = 10_000  # per step; a model with more chatters


class _Solver(CVodeSolver):  # type: ignore[misc]  # FMPy has no types
    """CVode that ends at the first failure of the FMU: ctypes would ignore exceptions."""

    failure: Exception | None = None

    def f(self, time: float, *arguments: Any) -> int:
        def slopes(*solver_arguments: Any) -> int:
            # CVode's own steps are longer than those between rows: inputs must follow their slopes.
            self.input.apply(time)
            return int(CVodeSolver.f(self, time, *solver_arguments))

        return self._guard(slopes, *arguments)

    def g(self, *arguments: Any) -> int:
        return self._guard(super().g, *arguments)

    def _guard(self, function: Callable[..., int], *arguments: Any) -> int:
        try:
            return function(*arguments)
        except Exception as error:
            self.failure = self.failure or error
            return -1


class _Ramp:
    """Inputs that change linearly from a time on; CVode calls `apply`."""

    def __init__(self, buffer: LocalBuffer, slopes: Sequence[float]) -> None:
        self._buffer = buffer
        self._slopes = np.array(slopes)
        self._first = np.zeros(len(self._slopes))
        self._begin = 0.0  # [s]

    def begin(self, time: float) -> None:
        """Begin a step at a time [s] with the present inputs."""
        self._begin = time
        self._first[:] = self._buffer.read()

    def apply(self, time: float) -> None:
        """Set the inputs to their values at a time [s]."""
        self._buffer.values[:] = self._first + self._slopes * (time - self._begin)
        self._buffer.write()


class ExchangeInstance(Instance):
    """An FMU for model exchange with its solver."""

    has_solver = True

    def __init__(
        self, fmu: UnpackedFmu, tell: Tell, failure: Failure = lambda error: error
    ) -> None:
        self._about = fmu
        self._solver: _Solver | None = None
        self._ramp: _Ramp | None = None
        self._is_continuous = False  # otherwise it is in event mode or not initialised
        self._is_integrating = False
        self._next_event: float | None = None  # [s]
        super().__init__(fmu, tell, failure)
        if fmu.fmi == 2:
            self._update = "newDiscreteStates"
            self._derivatives = "getDerivatives"
        else:
            self._update = "updateDiscreteStates"
            self._derivatives = "getContinuousStateDerivatives"

    def call(self, function: str, *arguments: Any) -> None:
        """Call a function; a variable that is set between two steps is set in event mode."""
        sets = function.startswith(self.fmi.functions["set"])
        if sets and self._is_continuous and not self._is_integrating:
            self._enter_event_mode()
        super().call(function, *arguments)

    def exit_initialisation(self) -> None:
        """Exit the initialisation and enter continuous-time mode."""
        super().exit_initialisation()
        begin, _ = self._experiment
        self._update_discrete_states(begin)
        self._solver = self._new_solver()

    def reset(self) -> None:
        """Return to the state before the initialisation."""
        self._solver = None
        self._ramp = None
        self._is_continuous = False
        super().reset()

    def set_slopes(self, references: Sequence[int], slopes: Sequence[float]) -> None:
        """Set the slopes of Real inputs [unit/s] for the next step."""
        self._ramp = _Ramp(self.buffer(references), slopes)

    def apply(self, time: float) -> None:
        """Set the inputs that have slopes to their values at a time [s]; called by CVode."""
        if self._ramp is not None:
            self._ramp.apply(time)

    def step(self, time: float, size: float) -> None:
        """Integrate from a time [s] by a size [s]."""
        if not self._is_continuous:
            self._update_discrete_states(time)
        if self._ramp is not None:
            self._ramp.begin(time)
        end = time + size
        self._is_integrating = True
        try:
            for _ in range(_MAX_EVENTS):
                if time >= end or isclose(time, end):
                    return
                time = self._integrate(time, end)
        finally:
            self._is_integrating = False
        raise self._failure(CallError(f"it has more than {_MAX_EVENTS} events in a step"))

    def _integrate(self, time: float, end: float) -> float:
        """Integrate to the next event or the end [s], handle the event, and return the time."""
        target = end
        event_time = self._next_event
        if event_time is not None and event_time < end and not isclose(event_time, end):
            target = event_time
        is_event, time = self._solve(time, target)
        is_event = is_event or (event_time is not None and isclose(time, event_time))
        self.ask("setTime", time)
        self.apply(time)
        if self._about.completes_steps:
            entered, ended = self.ask("completedIntegratorStep")
            if ended:
                raise self._failure(CallError("completedIntegratorStep requested termination"))
            is_event = is_event or bool(entered)
        if is_event:
            self._enter_event_mode()
            self._update_discrete_states(time)
        return time

    def _solve(self, time: float, target: float) -> tuple[bool, float]:
        """Return whether CVode has found a state event, and the time reached [s]."""
        solver = self._solver
        assert solver is not None, "the FMU is not initialised"
        try:
            is_event, _, reached = solver.step(time, target)
        except FMICallException as error:
            self.fail(error.function, error.status)
        except (RuntimeError, TypeError) as error:  # TypeError: FMPy has no text for the error
            if solver.failure is None:
                raise self._failure(CallError(f"CVode cannot integrate it ({error})")) from error
        if isinstance(solver.failure, FMICallException):
            self.fail(solver.failure.function, solver.failure.status)
        if solver.failure is not None:
            raise solver.failure
        return bool(is_event), float(reached)

    def _enter_event_mode(self) -> None:
        self._is_continuous = False
        self.ask("enterEventMode")

    def _update_discrete_states(self, time: float) -> None:
        """Iterate the discrete states at a time [s] and enter continuous-time mode."""
        for _ in range(_MAX_EVENTS):
            needs_more, ends, _, _, is_defined, next_event = self.ask(self._update)
            if ends:
                raise self._failure(CallError(f"{self._update} requested termination"))
            if not needs_more:
                break
        else:
            raise self._failure(CallError("the iteration of its events does not end"))
        self._next_event = None
        if is_defined and next_event > time:
            self._next_event = float(next_event)
        self.ask("enterContinuousTimeMode")
        self._is_continuous = True
        if self._solver is not None:
            self._solver.reset(time)

    def _new_solver(self) -> _Solver:
        begin, stop = self._experiment
        fmu = self._about
        max_step = float("inf")
        if stop is not None:
            max_step = _MAX_STEP_SHARE * (stop - begin)

        def get_nominals(values: Any, count: int) -> None:
            self.slave.getNominalsOfContinuousStates(values, count)

        return _Solver(
            nx=fmu.states,
            nz=fmu.indicators,
            get_x=self.slave.getContinuousStates,
            set_x=self.slave.setContinuousStates,
            get_dx=getattr(self.slave, self._derivatives),
            get_z=self.slave.getEventIndicators,
            get_nominals=get_nominals,
            set_time=self.slave.setTime,
            input=self,
            startTime=begin,
            maxStep=max_step,
            relativeTolerance=fmu.tolerance,
        )
