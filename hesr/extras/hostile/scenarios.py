"""Scenarios of an adverse master, each run with a new instance in the sandbox."""

import ctypes
import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

from fmu_src.run.instance import WARNING, CallError, Instance, LoadError, UnpackedFmu

MAX_REPEATS = 20  # of a discarded step, and of events at one instant
ROUNDING_STEP = 1e-14  # step [s] left by the round-off of summed times
_STEP_SHARES = {"nominal": 1.0, "dense": 0.125, "fifth": 0.2, "double": 2.0}  # by scenario
_SAME_INSTANT = 1e-6  # events nearer than this share of a step follow one another
_DISCARD_STATUS = 2
_OUTCOMES = {2: "is discarded", 3: "ends in an error", 4: "ends in a fatal error"}


class RefusedError(Exception):
    """The FMU has refused a call, with a status if it has one."""

    def __init__(self, text: str, status: int | None = None) -> None:
        super().__init__(text)
        self.status = status


def outcome(plan: Mapping[str, Any], scenario: str) -> dict[str, Any]:
    """Run a scenario of a plan of `hesr.extras.hostile.master` and return its times and values."""
    run: _Run | None = None
    try:
        run = _Run(plan, exchange=scenario in _EXCHANGES)
        run.begin()
        (_EXCHANGES | _SIMULATIONS).get(scenario, _take_steps)(run, scenario)
        if run.recorded.get("taken", True):
            run.instance.call("fmi2Terminate")
            run.instance.close(stepping=False)
    except LoadError as error:
        return {"refused": f"its binary cannot be loaded ({error})"}
    except RefusedError as error:
        recorded = {}
        if run is not None:
            recorded = run.recorded
        return recorded | {"refused": str(error)}
    return run.recorded


class _Run:
    def __init__(self, plan: Mapping[str, Any], *, exchange: bool) -> None:
        self.plan = plan
        self.step = float(plan["step"])
        self.recorded: dict[str, Any] = {"times": [], "rows": [], "steps": []}
        self.time = 0.0  # of the instance [s]
        self.last_step = 0.0  # [s]
        self._exchange = exchange
        self._messages: list[str] = []
        identifier = plan["simulation"]
        if exchange:
            identifier = plan["exchange"]
        fmu = UnpackedFmu(
            folder=plan["folder"],
            guid=plan["guid"],
            identifier=identifier,
            name="hostile",
            exchange=exchange,
        )
        self.instance = Instance(fmu, self._record_message, self.build_refusal)
        self._inputs = self.instance.buffer(
            [excitation["reference"] for excitation in plan["inputs"]]
        )
        self._outputs = self.instance.buffer(plan["outputs"])

    def _record_message(self, status: int, text: str) -> None:
        if status > WARNING:
            self._messages.append(text)

    def build_refusal(self, error: Exception) -> RefusedError:
        function = str(error)
        status = None
        if isinstance(error, CallError) and error.status is not None:
            function = error.function
            status = error.status
            function += f" {_OUTCOMES.get(status, f'fails with status {status}')}"
        if self._messages:
            function += f" with '{self._messages[0]}'"
            self._messages.clear()
        return RefusedError(function, status)

    def begin(self) -> None:
        self.instance.setup(0.0, None)
        self.set_inputs(0.0)
        self.instance.enter_initialisation()
        self.set_inputs(0.0)
        self.instance.exit_initialisation()
        if not self._exchange:
            self.record()

    def set_inputs(self, time: float) -> None:
        """Set the inputs of a time [s]: smooth, with two periods over the experiment."""
        angle = 4.0 * math.pi * time / (self.step * self.plan["steps"])
        for k, excitation in enumerate(self.plan["inputs"]):
            deviation = excitation["amplitude"] * math.sin(angle + 2.4 * k)
            self._inputs.values[k] = excitation["centre"] + deviation
        if self.plan["inputs"]:
            self._inputs.write()

    def read_outputs(self) -> list[float]:
        if not self.plan["outputs"]:
            return []
        outputs: list[float] = self._outputs.read().tolist()
        return outputs

    def record(self) -> None:
        self.recorded["rows"].append(self.read_outputs())
        self.recorded["times"].append(self.time)
        self.recorded["steps"].append(self.last_step)

    def do_step(self, step_size: float) -> None:
        """Step with the present inputs; repeat the step if it is discarded."""
        for repeat in range(1, MAX_REPEATS + 1):
            try:
                self.instance.step(self.time, step_size)
            except RefusedError as error:
                is_discarded = error.status == _DISCARD_STATUS
                if is_discarded and repeat < MAX_REPEATS:
                    continue
                call = f"fmi2DoStep of {step_size:.9g} s at {self.time:.9g} s"
                text = str(error).replace("fmi2DoStep", call, 1)
                if is_discarded:
                    text += f" each of {repeat} times"
                raise RefusedError(text) from error
            break
        self.time += step_size
        self.last_step = step_size

    def advance(self, step_size: float) -> None:
        self.set_inputs(self.time)
        self.do_step(step_size)
        self.record()


def _take_steps(run: _Run, scenario: str) -> None:
    for step_size in _choose_steps(scenario, run.step, run.plan["steps"]):
        run.advance(step_size)


def _choose_steps(scenario: str, step_size: float, step_count: int) -> Iterator[float]:
    """Yield the steps [s] of a scenario."""
    if scenario in _STEP_SHARES:
        share = _STEP_SHARES[scenario]
        nominal_count = step_count
        if scenario in ("nominal", "dense"):
            # References run longer: the last inputs of others count at their end.
            nominal_count += 2
        yield from [share * step_size] * round(nominal_count / share)
    elif scenario == "irrational":
        shares = [math.sqrt(0.5), math.pi / 3.0, math.e - 2.0, math.sqrt(2.0) - 1.0, math.pi / 7.0]
        yield from [share * step_size for share in shares] * round(step_count / math.fsum(shares))
    elif scenario == "summed":  # as if the stop time were one round-off further
        yield from [step_size] * step_count
        yield ROUNDING_STEP
    elif scenario == "tiny":
        for _ in range(step_count):
            yield ROUNDING_STEP
            yield step_size - ROUNDING_STEP


def _hold_inputs(run: _Run, _scenario: str) -> None:
    for _ in range(run.plan["steps"] // 2 + 2):
        run.set_inputs(run.time)
        for _ in range(4):
            run.do_step(0.5 * run.step)
            run.record()


def _refresh_outputs(run: _Run, _scenario: str) -> None:
    run.recorded["fresh"] = []
    for _ in range(run.plan["steps"]):
        run.set_inputs(run.time)
        run.read_outputs()
        run.recorded["fresh"].append(run.read_outputs())
        run.do_step(run.step)
        run.record()


def _repeat_steps(run: _Run, _scenario: str) -> None:
    """Take steps back, as masters with iteration or step control do."""
    long_step = run.step
    if run.plan["variable"]:
        long_step = 2.0 * run.step
    for k in range(run.plan["steps"]):
        if k % 5 == 0:
            state = run.instance.ask("getFMUstate")
            time = run.time
            for _ in range(3):
                run.set_inputs(run.time + run.step)
                run.do_step(long_step)
                run.read_outputs()
                run.instance.ask("setFMUstate", state)
                run.time = time
            run.instance.ask("freeFMUstate", state)
        run.advance(run.step)


_SIMULATIONS = {"refreshed": _refresh_outputs, "repeated": _repeat_steps, "held": _hold_inputs}


def _solve(run: _Run, scenario: str) -> None:
    """Hold inputs over each step of a solver; "late" sets them only after events."""
    from fmpy.sundials import CVodeSolver

    slave = run.instance.slave
    _handle_events(run)
    solver = CVodeSolver(
        nx=run.plan["states"],
        nz=run.plan["indicators"],
        get_x=slave.getContinuousStates,
        set_x=slave.setContinuousStates,
        get_dx=slave.getDerivatives,
        get_z=slave.getEventIndicators,
        get_nominals=slave.getNominalsOfContinuousStates,
        set_time=slave.setTime,
        input=SimpleNamespace(apply=lambda _: None),  # inputs are never set
        startTime=0.0,
        maxStep=run.step,
        maxNumSteps=100_000,
    )
    time = 0.0
    for k in range(run.plan["steps"]):
        end_time = (k + 1) * run.step
        run.set_inputs(time)
        event_count = 0
        event_time = time
        while time < end_time:
            has_event, _, time = _advance_solver(run, solver, time, end_time)
            run.instance.ask("setTime", time)
            requests_event, ends_run = run.instance.ask("completedIntegratorStep")
            if ends_run:
                raise RefusedError(f"fmi2CompletedIntegratorStep ends the run at {time:.9g} s")
            if not has_event and not requests_event:
                continue
            is_same_instant = time - event_time < _SAME_INSTANT * run.step
            if not is_same_instant:
                event_count = 0
            event_count += 1
            event_time = time
            if event_count > MAX_REPEATS:
                raise RefusedError(
                    f"more than {MAX_REPEATS} events follow one another at {time:.9g} s, where "
                    "the inputs are held over the solver's step"
                )
            run.instance.ask("enterEventMode")
            if scenario != "late":
                run.set_inputs(time)
            _handle_events(run)
            run.set_inputs(time)
            solver.reset(time)
        run.time = time
        run.record()


def _advance_solver(
    run: _Run, solver: Any, time: float, end_time: float
) -> tuple[bool, Any, float]:
    state_count = run.plan["states"]
    saved_states = (ctypes.c_double * state_count)()
    if state_count:
        run.instance.ask("getContinuousStates", saved_states, state_count)
    with suppress(Exception):  # FMPy raises bare exceptions
        return cast("tuple[bool, Any, float]", solver.step(time, end_time))
    # Held inputs jump, so CVODE may give up; only a second failure is the FMU's.
    run.instance.ask("setTime", time)
    if state_count:
        run.instance.ask("setContinuousStates", saved_states, state_count)
    solver.reset(time)
    try:
        return cast("tuple[bool, Any, float]", solver.step(time, end_time))
    except Exception as error:  # FMPy raises bare exceptions
        raise RefusedError(f"CVODE fails ({error})") from error


def _handle_events(run: _Run) -> None:
    for _ in range(MAX_REPEATS):
        if not run.instance.ask("newDiscreteStates")[0]:
            break
    else:
        raise RefusedError("fmi2NewDiscreteStates requests iterations endlessly")
    run.instance.ask("enterContinuousTimeMode")


def _set_excess_state(run: _Run, _scenario: str) -> None:
    _handle_events(run)
    state_count = run.plan["states"] + 1
    run.recorded["taken"] = False
    with suppress(RefusedError):
        run.instance.ask("setContinuousStates", (ctypes.c_double * state_count)(), state_count)
        run.recorded["taken"] = True


_EXCHANGES = {"exchange": _solve, "late": _solve, "sizes": _set_excess_state}
