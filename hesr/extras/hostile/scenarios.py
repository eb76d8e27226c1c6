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
        if run.found.get("taken", True):
            run.fmu.call("fmi2Terminate")
            run.fmu.close(stepping=False)
    except LoadError as error:
        return {"refused": f"its binary cannot be loaded ({error})"}
    except RefusedError as error:
        return (run.found if run else {}) | {"refused": str(error)}
    return run.found


class _Run:
    def __init__(self, plan: Mapping[str, Any], *, exchange: bool) -> None:
        self.plan = plan
        self.step = float(plan["step"])
        self.found: dict[str, Any] = {"times": [], "rows": [], "steps": []}
        self.time = self.reached = 0.0  # of the instance, and size of its last step [s]
        self._exchange = exchange
        self._messages: list[str] = []
        fmu = UnpackedFmu(
            folder=plan["folder"],
            guid=plan["guid"],
            identifier=plan["exchange" if exchange else "simulation"],
            name="hostile",
            exchange=exchange,
        )
        self.fmu = Instance(fmu, self._hear, self.refusal)
        self._inputs = self.fmu.buffer([excitation["reference"] for excitation in plan["inputs"]])
        self._outputs = self.fmu.buffer(plan["outputs"])

    def _hear(self, status: int, text: str) -> None:
        if status > WARNING:
            self._messages.append(text)

    def refusal(self, error: Exception) -> RefusedError:
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
        self.fmu.setup(0.0, None)
        self.set_inputs(0.0)
        self.fmu.enter_initialisation()
        self.set_inputs(0.0)
        self.fmu.exit_initialisation()
        if not self._exchange:
            self.record()

    def set_inputs(self, time: float) -> None:
        """Set the inputs of a time [s]: smooth, with two periods over the experiment."""
        cycle = 4.0 * math.pi * time / (self.step * self.plan["steps"])
        for k, excitation in enumerate(self.plan["inputs"]):
            swing = excitation["amplitude"] * math.sin(cycle + 2.4 * k)
            self._inputs.values[k] = excitation["centre"] + swing
        if self.plan["inputs"]:
            self._inputs.write()

    def outputs(self) -> list[float]:
        return self._outputs.read().tolist() if self.plan["outputs"] else []

    def record(self) -> None:
        self.found["rows"].append(self.outputs())
        self.found["times"].append(self.time)
        self.found["steps"].append(self.reached)

    def do_step(self, step: float) -> None:
        """Step with the present inputs; repeat the step if it is discarded."""
        for repeat in range(1, MAX_REPEATS + 1):
            try:
                self.fmu.step(self.time, step)
            except RefusedError as error:
                if error.status == _DISCARD_STATUS and repeat < MAX_REPEATS:
                    continue
                which = f"fmi2DoStep of {step:.9g} s at {self.time:.9g} s"
                often = f" each of {repeat} times" if error.status == _DISCARD_STATUS else ""
                text = str(error).replace("fmi2DoStep", which, 1)
                raise RefusedError(f"{text}{often}") from error
            break
        self.time += step
        self.reached = step

    def advance(self, step: float) -> None:
        self.set_inputs(self.time)
        self.do_step(step)
        self.record()


def _take_steps(run: _Run, scenario: str) -> None:
    for step in _steps(scenario, run.step, run.plan["steps"]):
        run.advance(step)


def _steps(scenario: str, step: float, count: int) -> Iterator[float]:
    """Yield the steps [s] of a scenario."""
    if scenario in ("nominal", "dense", "fifth", "double"):
        share = {"nominal": 1.0, "dense": 0.125, "fifth": 0.2, "double": 2.0}[scenario]
        # References run longer: the last inputs of others count at their end.
        end = count + 2 if scenario in ("nominal", "dense") else count
        yield from [share * step] * round(end / share)
    elif scenario == "irrational":
        shares = [math.sqrt(0.5), math.pi / 3.0, math.e - 2.0, math.sqrt(2.0) - 1.0, math.pi / 7.0]
        yield from [share * step for share in shares] * round(count / math.fsum(shares))
    elif scenario == "summed":  # as if the stop time were one round-off further
        yield from [step] * count
        yield ROUNDING_STEP
    elif scenario == "tiny":
        for _ in range(count):
            yield ROUNDING_STEP
            yield step - ROUNDING_STEP


def _hold_inputs(run: _Run, _scenario: str) -> None:
    for _ in range(run.plan["steps"] // 2 + 2):
        run.set_inputs(run.time)
        for _ in range(4):
            run.do_step(0.5 * run.step)
            run.record()


def _refresh_outputs(run: _Run, _scenario: str) -> None:
    run.found["fresh"] = []
    for _ in range(run.plan["steps"]):
        run.set_inputs(run.time)
        run.outputs()
        run.found["fresh"].append(run.outputs())
        run.do_step(run.step)
        run.record()


def _repeat_steps(run: _Run, _scenario: str) -> None:
    """Take steps back, as masters with iteration or step control do."""
    longer = run.step * (2.0 if run.plan["variable"] else 1.0)
    for k in range(run.plan["steps"]):
        if k % 5 == 0:
            state = run.fmu.ask("getFMUstate")
            time = run.time
            for _ in range(3):
                run.set_inputs(run.time + run.step)
                run.do_step(longer)
                run.outputs()
                run.fmu.ask("setFMUstate", state)
                run.time = time
            run.fmu.ask("freeFMUstate", state)
        run.advance(run.step)


_SIMULATIONS = {"refreshed": _refresh_outputs, "repeated": _repeat_steps, "held": _hold_inputs}


def _solve(run: _Run, scenario: str) -> None:
    """Hold inputs over each step of a solver; "late" sets them only after events."""
    from fmpy.sundials import CVodeSolver

    fmu = run.fmu.slave
    _handle_events(run)
    solver = CVodeSolver(
        nx=run.plan["states"],
        nz=run.plan["indicators"],
        get_x=fmu.getContinuousStates,
        set_x=fmu.setContinuousStates,
        get_dx=fmu.getDerivatives,
        get_z=fmu.getEventIndicators,
        get_nominals=fmu.getNominalsOfContinuousStates,
        set_time=fmu.setTime,
        input=SimpleNamespace(apply=lambda _: None),  # inputs are never set
        startTime=0.0,
        maxStep=run.step,
        maxNumSteps=100_000,
    )
    time = 0.0
    for k in range(run.plan["steps"]):
        end = (k + 1) * run.step
        run.set_inputs(time)
        events = 0
        event_time = time
        while time < end:
            has_event, _, time = _advance_solver(run, solver, time, end)
            run.fmu.ask("setTime", time)
            requests_event, stop = run.fmu.ask("completedIntegratorStep")
            if stop:
                raise RefusedError(f"fmi2CompletedIntegratorStep ends the run at {time:.9g} s")
            if not has_event and not requests_event:
                continue
            events = events + 1 if time - event_time < 1e-6 * run.step else 1
            event_time = time
            if events > MAX_REPEATS:
                raise RefusedError(
                    f"more than {MAX_REPEATS} events follow one another at {time:.9g} s, where "
                    "the inputs are held over the solver's step"
                )
            run.fmu.ask("enterEventMode")
            if scenario != "late":
                run.set_inputs(time)
            _handle_events(run)
            run.set_inputs(time)
            solver.reset(time)
        run.time = time
        run.record()


def _advance_solver(run: _Run, solver: Any, time: float, end: float) -> tuple[bool, Any, float]:
    size = run.plan["states"]
    saved_states = (ctypes.c_double * size)()
    if size:
        run.fmu.ask("getContinuousStates", saved_states, size)
    with suppress(Exception):  # FMPy raises bare exceptions
        return cast("tuple[bool, Any, float]", solver.step(time, end))
    # Held inputs jump, so CVODE may give up; only a second failure is the FMU's.
    run.fmu.ask("setTime", time)
    if size:
        run.fmu.ask("setContinuousStates", saved_states, size)
    solver.reset(time)
    try:
        return cast("tuple[bool, Any, float]", solver.step(time, end))
    except Exception as error:  # FMPy raises bare exceptions
        raise RefusedError(f"CVODE fails ({error})") from error


def _handle_events(run: _Run) -> None:
    for _ in range(MAX_REPEATS):
        if not run.fmu.ask("newDiscreteStates")[0]:
            break
    else:
        raise RefusedError("fmi2NewDiscreteStates requests iterations endlessly")
    run.fmu.ask("enterContinuousTimeMode")


def _set_excess_state(run: _Run, _scenario: str) -> None:
    _handle_events(run)
    size = run.plan["states"] + 1
    run.found["taken"] = False
    with suppress(RefusedError):
        run.fmu.ask("setContinuousStates", (ctypes.c_double * size)(), size)
        run.found["taken"] = True


_EXCHANGES = {"exchange": _solve, "late": _solve, "sizes": _set_excess_state}
