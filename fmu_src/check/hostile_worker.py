"""A master that does what masters do at their worst, in a process of its own.

This file is run as a script and imports nothing of the project:

    hostile_worker.py PLAN.json ANSWER.jsonl

Each scenario of the plan is run with a new instance, and its outcome written as a line of its own
as soon as it is known: what is missing when the process has crashed is the scenario that did it.
"""

import ctypes
import json
import math
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

MOST_MEMORY = 4 << 30
MOST_REPEATS = 20
"""Of a step that is discarded, and of events at one instant."""

ROUNDING = 1e-14
"""A step [s] such as summed times leave."""

_DISCARD = 2


class RefusedError(Exception):
    """The FMU has refused a call; the text says which and in what words."""


def main(arguments: list[str]) -> None:
    """Run the scenarios of a plan."""
    with suppress(ImportError):  # Windows has no such limits
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    plan = json.loads(Path(arguments[0]).read_text(encoding="utf-8"))
    with Path(arguments[1]).open("w", encoding="utf-8") as answer:
        for scenario in plan["scenarios"]:
            answer.write(json.dumps({"scenario": scenario, **_outcome(plan, scenario)}) + "\n")
            answer.flush()


def _outcome(plan: dict[str, Any], scenario: str) -> dict[str, Any]:
    runs = _EXCHANGES | _SIMULATIONS
    master = _Master(plan, exchange=scenario in _EXCHANGES)
    try:
        master.begin()
        runs.get(scenario, _stepped)(master, scenario)
        if master.found.get("taken", True):
            master.end()
    except RefusedError as error:
        return master.found | {"refused": str(error)}
    return master.found


class _Master:
    """One instance and what it gave."""

    def __init__(self, plan: dict[str, Any], *, exchange: bool) -> None:
        self.plan = plan
        self.step: float = plan["step"]
        self.found: dict[str, Any] = {"times": [], "rows": [], "steps": []}
        self.time, self.reached = 0.0, 0.0
        """Where the instance is, and the length of the step that took it there [s]."""
        self._exchange = exchange
        self._said: list[str] = []
        self._inputs = [one["reference"] for one in plan["inputs"]]
        self._outputs = list(plan["outputs"])

    def begin(self) -> None:
        """Instantiate and initialise."""
        from fmpy import calloc, fmi2, free

        kind = self.plan["exchange" if self._exchange else "simulation"]
        try:
            self.fmu = (fmi2.FMU2Model if self._exchange else fmi2.FMU2Slave)(
                guid=self.plan["guid"],
                modelIdentifier=kind,
                unzipDirectory=self.plan["folder"],
                instanceName="hostile",
            )
        except Exception as error:  # FMPy raises bare exceptions
            raise RefusedError(f"its binary cannot be loaded ({error})") from error
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._hear)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
        self._do("fmi2Instantiate", self.fmu.instantiate, callbacks=callbacks)
        self._do("fmi2SetupExperiment", self.fmu.setupExperiment, startTime=0.0)
        self.set_inputs(0.0)
        self._do("fmi2EnterInitializationMode", self.fmu.enterInitializationMode)
        self.set_inputs(0.0)
        self._do("fmi2ExitInitializationMode", self.fmu.exitInitializationMode)
        if not self._exchange:
            self.look()

    def end(self) -> None:
        """Terminate and free."""
        self._do("fmi2Terminate", self.fmu.terminate)
        self.fmu.freeInstance()

    def _hear(self, _place: Any, _name: Any, status: int, _category: Any, text: bytes) -> None:
        if status:
            self._said.append(text.decode("utf-8", "replace"))

    def _do(self, name: str, function: Any, *arguments: Any, **more: Any) -> Any:
        self._said.clear()
        try:
            return function(*arguments, **more)
        except Exception as error:  # FMPy raises bare exceptions, too
            raise RefusedError(f"{name} {self._answer(error)}") from error

    def _answer(self, error: Exception) -> str:
        words = {2: "is discarded", 3: "ends in an error", 4: "ends in a fatal error"}
        done = words.get(getattr(error, "status", 0), f"fails ({error})")
        return f"{done} with '{self._said[0]}'" if self._said else done

    def inputs(self, time: float) -> list[float]:
        """Return smooth inputs (inputs,), two periods of each over the experiment."""
        cycle = 4.0 * math.pi * time / (self.step * self.plan["steps"])
        return [
            one["centre"] + one["amplitude"] * math.sin(cycle + 2.4 * k)
            for k, one in enumerate(self.plan["inputs"])
        ]

    def set_inputs(self, time: float) -> None:
        """Set what the inputs are at a time [s]."""
        if self._inputs:
            self._do("fmi2SetReal", self.fmu.setReal, self._inputs, self.inputs(time))

    def outputs(self) -> list[float]:
        """Return the outputs (outputs,)."""
        if not self._outputs:
            return []
        return list(self._do("fmi2GetReal", self.fmu.getReal, self._outputs))

    def look(self) -> None:
        """Read the outputs and keep them."""
        self.found["times"].append(self.time)
        self.found["steps"].append(self.reached)
        self.found["rows"].append(self.outputs())

    def do_step(self, step: float) -> None:
        """Make a step with the inputs as they are; repeat it where it is discarded."""
        for repeat in range(1, MOST_REPEATS + 1):
            self._said.clear()
            try:
                self.fmu.doStep(self.time, step)
            except Exception as error:  # FMPy raises bare exceptions, too
                discarded = getattr(error, "status", 0) == _DISCARD
                if discarded and repeat < MOST_REPEATS:
                    continue
                often = f" each of {repeat} times" if discarded else ""
                raise RefusedError(
                    f"fmi2DoStep of {step:.9g} s at {self.time:.9g} s {self._answer(error)}{often}"
                ) from error
            break
        self.time += step
        self.reached = step

    def advance(self, step: float) -> None:
        """Set the inputs, make a step and keep the outputs."""
        self.set_inputs(self.time)
        self.do_step(step)
        self.look()


# --- co-simulation ----------------------------------------------------------------------------


def _stepped(master: _Master, scenario: str) -> None:
    for step in _steps(scenario, master.step, master.plan["steps"]):
        master.advance(step)


def _steps(scenario: str, step: float, count: int) -> Iterator[float]:
    """Yield the lengths [s] of the steps of a scenario, which all end at about the same time."""
    if scenario in ("nominal", "dense", "fifth", "double"):
        share = {"nominal": 1.0, "dense": 0.125, "fifth": 0.2, "double": 2.0}[scenario]
        # References go on for longer, since the last inputs of others count at their end.
        end = count + 2 if scenario in ("nominal", "dense") else count
        yield from [share * step] * round(end / share)
    elif scenario == "irrational":
        shares = [math.sqrt(0.5), math.pi / 3.0, math.e - 2.0, math.sqrt(2.0) - 1.0, math.pi / 7.0]
        yield from [share * step for share in shares] * round(count / math.fsum(shares))
    elif scenario == "summed":  # and what rounding leaves to a stop time
        yield from [step] * count
        yield ROUNDING
    elif scenario == "tiny":
        for _ in range(count):
            yield ROUNDING
            yield step - ROUNDING


def _held(master: _Master, _scenario: str) -> None:
    """Hold inputs for twice the preferred step, and look twice within each."""
    for _ in range(master.plan["steps"] // 2 + 2):
        master.set_inputs(master.time)
        for _ in range(4):
            master.do_step(0.5 * master.step)
            master.look()


def _refreshed(master: _Master, _scenario: str) -> None:
    """Read outputs once the inputs are set, twice, as masters with direct feedthrough do."""
    master.found["fresh"] = []
    for _ in range(master.plan["steps"]):
        master.set_inputs(master.time)
        master.outputs()
        master.found["fresh"].append(master.outputs())
        master.do_step(master.step)
        master.look()


def _repeated(master: _Master, _scenario: str) -> None:
    """Take steps back again and again, as masters do that iterate or control their step."""
    longer = master.step * (2.0 if master.plan["variable"] else 1.0)
    fmu = master.fmu
    for k in range(master.plan["steps"]):
        if k % 5 == 0:
            state = fmu.getFMUstate()
            time = master.time
            for _ in range(3):
                master.set_inputs(master.time + master.step)
                master.do_step(longer)
                master.outputs()
                fmu.setFMUstate(state)
                master.time = time
            fmu.freeFMUstate(state)
        master.advance(master.step)


_SIMULATIONS = {"refreshed": _refreshed, "repeated": _repeated, "held": _held}
"""Scenarios that are not made of steps alone."""

# --- model exchange ---------------------------------------------------------------------------


class _Stale:
    """Inputs that a solver never sets within its steps, nor its root search."""

    def apply(self, time: float) -> None:
        """Leave the inputs as they are."""


def _solve(master: _Master, scenario: str) -> None:
    """Hold inputs over each step of a solver, as long as ours; "late" sets them after events."""
    from fmpy.sundials import CVodeSolver

    fmu = master.fmu
    _events(master)
    solver = CVodeSolver(
        nx=master.plan["states"],
        nz=master.plan["indicators"],
        get_x=fmu.getContinuousStates,
        set_x=fmu.setContinuousStates,
        get_dx=fmu.getDerivatives,
        get_z=fmu.getEventIndicators,
        get_nominals=fmu.getNominalsOfContinuousStates,
        set_time=fmu.setTime,
        input=_Stale(),
        startTime=0.0,
        maxStep=master.step,
        maxNumSteps=100_000,
    )
    time = 0.0
    for k in range(master.plan["steps"]):
        end = (k + 1) * master.step
        master.set_inputs(time)
        events, since = 0, time
        while time < end:
            found, _, time = _solved(master, solver, time, end)
            fmu.setTime(time)
            asked, stop = fmu.completedIntegratorStep()
            if stop:
                raise RefusedError(f"fmi2CompletedIntegratorStep ends the run at {time:.9g} s")
            if not found and not asked:
                continue
            events = events + 1 if time - since < 1e-6 * master.step else 1
            since = time
            if events > MOST_REPEATS:
                raise RefusedError(
                    f"more than {MOST_REPEATS} events follow one another at {time:.9g} s, where "
                    "the inputs are held over the solver's step"
                )
            master._do("fmi2EnterEventMode", fmu.enterEventMode)
            if scenario != "late":
                master.set_inputs(time)
            _events(master)
            master.set_inputs(time)
            solver.reset(time)
        master.time = time
        master.look()


def _solved(master: _Master, solver: Any, time: float, end: float) -> tuple[bool, Any, float]:
    fmu, size = master.fmu, master.plan["states"]
    before = (ctypes.c_double * size)()
    if size:
        fmu.getContinuousStates(before, size)
    with suppress(Exception):  # FMPy raises bare ones
        return cast("tuple[bool, Any, float]", solver.step(time, end))
    # CVODE is nowhere told that held inputs jump, and gives up where that is steep. Masters begin
    # anew then; what fails from there on is of the FMU.
    fmu.setTime(time)
    if size:
        fmu.setContinuousStates(before, size)
    solver.reset(time)
    solved: tuple[bool, Any, float] = master._do("CVODE", solver.step, time, end)
    return solved


def _events(master: _Master) -> None:
    """Go through an event to continuous-time mode."""
    for _ in range(MOST_REPEATS):
        more = master._do("fmi2NewDiscreteStates", master.fmu.newDiscreteStates)
        if not more[0]:
            break
    else:
        raise RefusedError("fmi2NewDiscreteStates asks for another iteration without end")
    master._do("fmi2EnterContinuousTimeMode", master.fmu.enterContinuousTimeMode)


def _sizes(master: _Master, _scenario: str) -> None:
    """Hand over one state too many; hosts that need one where there is none make one up."""
    _events(master)
    size = master.plan["states"] + 1
    values = (ctypes.c_double * size)()
    try:
        master.fmu.setContinuousStates(values, size)
        master.found["taken"] = True
    except Exception:  # FMPy raises bare exceptions, too
        master.found["taken"] = False  # and an error has ended the run


_EXCHANGES = {"exchange": _solve, "late": _solve, "sizes": _sizes}

if __name__ == "__main__":
    main(sys.argv[1:])
