"""Behaviour of an FMU under adverse masters: odd step sizes, unusual calls.

The reference is the same FMU at an eighth of its preferred step, and at half of it with inputs held
for twice that step. An output jumps if it leaves the range of the reference around its time by
several step errors. The step error is its distance from this range at the preferred step.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from fmu_src.check.archive import Contents
from fmu_src.check.description import (
    InterfaceKind,
    ParsedDescription,
    ParsedVariable,
    integer,
    real,
)
from fmu_src.check.rules import Problem, find_rule, label_problems
from fmu_src.run.instance import PLATFORM, SUFFIX
from fmu_src.run.sandbox import Sandbox
from hesr_model.support.arrays import Array
from hesr_model.support.child import INVALID_ANSWER
from hesr_model.support.process import DiedError
from hesr_model.support.text import count_noun, quote, sanitise

SECONDS = 300.0  # for a scenario
STEPS = 200  # of the nominal run
_SCENARIO = "hesr.extras.hostile.scenarios:outcome"
_DEFAULT_STEP = 0.01  # [s], unless the FMU prefers one
_JUMP_THRESHOLD = 5.0  # threshold of a jump, in step errors of the nominal run
_MIN_RELATIVE_JUMP = 0.02  # added to it, relative to the range of an output
_EQUALITY_TOLERANCE = 1e-9  # tolerance of runs that must be equal, relative to the range

_FREE_STEP_SCENARIOS = {
    "fifth": "steps of a fifth of the preferred one",
    "double": "steps of twice the preferred one",
    "irrational": "steps of irrational lengths",
    "tiny": "steps of rounding size between others",
}
"""Scenarios for FMUs whose communication step may vary."""

_SCENARIO_NAMES = _FREE_STEP_SCENARIOS | {
    "nominal": "the preferred step",
    "dense": "steps of an eighth of the preferred one",
    "held": "steps of half the preferred one",
    "summed": "a last step of rounding size, as summed times leave it",
    "refreshed": "reading outputs between fmi2SetReal and fmi2DoStep",
    "repeated": "steps that are taken back by fmi2SetFMUstate",
    "exchange": "model exchange with inputs held over each step of the solver",
    "late": "model exchange with inputs set after events only",
    "sizes": "fmi2SetContinuousStates with one state too many",
}


@dataclass(frozen=True, kw_only=True)
class _Run:
    """Outcome of a scenario: (N,) times [s] and steps before them [s], (N, outputs) values."""

    times: Array
    steps: Array
    rows: Array
    fresh: Array  # values that were read before the steps
    refused: str
    taken: bool | None


def problems(
    model_description: ParsedDescription, contents: Contents, folder: Path
) -> tuple[list[Problem], list[str]]:
    """Run an FMU of FMI 2.0; return findings, and reasons for scenarios that were not run."""
    is_damaged = any(find_rule(name).severity == "error" for name, _ in contents.problems)
    if is_damaged or model_description.attributes.get("fmiVersion") != "2.0":
        return [], ["Hostile master: not run; it needs FMI 2.0 and a valid archive."]
    binary_prefix = f"binaries/{PLATFORM}/"
    kinds = {
        kind.element: kind
        for kind in model_description.kinds
        if f"{binary_prefix}{kind.identifier}{SUFFIX}" in contents.files
    }
    if not kinds:
        return [], [f"Hostile master: a binary for this platform, {PLATFORM}, is missing."]
    for name, file in contents.files.items():
        if name.startswith((binary_prefix, "resources/")):
            target = folder / "hostile" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    master = _Master(model_description, kinds, folder)
    return list(label_problems("hostile", master.find_problems())), master.skipped


class _Master:
    def __init__(
        self, model_description: ParsedDescription, kinds: Mapping[str, InterfaceKind], folder: Path
    ) -> None:
        self._folder = folder
        reals = [
            variable
            for variable in model_description.variables
            if variable.kind == "Real" and variable.reference is not None
        ]
        inputs = [variable for variable in reals if variable.causality == "input"]
        self._outputs = [variable for variable in reals if variable.causality == "output"]
        self._simulation = kinds.get("CoSimulation")
        self._exchange = kinds.get("ModelExchange")
        self._step = _choose_step(model_description)
        self._varies = _can_vary_step(self._simulation)
        self.skipped: list[str] = []
        indicator_count = integer(model_description.attributes.get("numberOfEventIndicators"))
        self._plan = {
            "folder": str(folder / "hostile"),
            "guid": model_description.attributes.get("guid", ""),
            "simulation": _get_identifier(self._simulation),
            "exchange": _get_identifier(self._exchange),
            "step": self._step,
            "steps": STEPS,
            "variable": self._varies,
            "states": len(model_description.structure["Derivatives"]),
            "indicators": indicator_count or 0,
            "inputs": [_choose_excitation(variable) for variable in inputs],
            "outputs": [variable.reference for variable in self._outputs],
        }

    def _choose_scenarios(self) -> list[str]:
        scenarios: list[str] = []
        if self._simulation is None:
            self.skipped.append("Hostile steps: co-simulation is not available.")
        else:
            scenarios += ["nominal", "summed", "refreshed"]
            if self._varies:
                scenarios += ["dense", "held", *_FREE_STEP_SCENARIOS]
            else:
                self.skipped.append(
                    "Hostile steps: canHandleVariableCommunicationStepSize is false, so only "
                    f"steps of {self._step:g} s were tried."
                )
            if self._simulation.can("canGetAndSetFMUstate"):
                scenarios.append("repeated")
        if self._exchange is not None:
            scenarios += ["exchange", "late", "sizes"]
        return scenarios

    def find_problems(self) -> Iterator[str]:
        runs = self._run_scenarios(self._choose_scenarios())
        for name, run in runs.items():
            if run.refused:
                problem = f"{_SCENARIO_NAMES[name]}: {sanitise(run.refused.rstrip('.'), 400)}"
                if name in _FREE_STEP_SCENARIOS:
                    problem += "; canHandleVariableCommunicationStepSize is true"
                yield f"{problem}."
            if run.taken and self._plan["states"]:
                yield f"{_SCENARIO_NAMES[name]}: it is accepted without an error."
            if run.taken is False and not self._plan["states"]:
                yield (
                    "fmi2SetContinuousStates with one state is refused by an FMU without states; "
                    "solvers that need one state add it."
                )
        if self._outputs:
            yield from self._find_jumps(runs)

    def _run_scenarios(self, scenarios: Sequence[str]) -> dict[str, _Run]:
        runs = dict[str, _Run]()
        sandbox = None
        try:
            for name in scenarios:
                try:
                    if sandbox is None:
                        run_folder = Path(mkdtemp(dir=self._folder))
                        sandbox = Sandbox(run_folder, SECONDS, Path(str(self._plan["folder"])))
                    outcome = sandbox.run(_SCENARIO, self._plan, name)
                    try:
                        runs[name] = _read_run(outcome, len(self._outputs))
                    except (ValueError, TypeError, AttributeError) as error:
                        raise sandbox.end_process(INVALID_ANSWER) from error
                except DiedError as error:
                    sandbox = None
                    runs[name] = _read_run({"refused": f"the FMU {error}"}, len(self._outputs))
        finally:
            if sandbox is not None:
                sandbox.kill()
        return runs

    def _find_jumps(self, runs: Mapping[str, _Run]) -> Iterator[str]:
        nominal = runs.get("nominal")
        if nominal is None or nominal.refused:
            return
        complete_runs = {name: run for name, run in runs.items() if not run.refused}
        fine_runs = [complete_runs[name] for name in ("dense", "held") if name in complete_runs]
        references = fine_runs or [nominal]
        scale = _measure_scale(np.concatenate([reference_run.rows for reference_run in references]))
        checked_runs = [nominal, *fine_runs[:-1]]
        if "refreshed" in complete_runs:
            run = complete_runs["refreshed"]
            checked_runs.append(
                replace(run, times=run.times[:-1], steps=run.steps[1:], rows=run.fresh)
            )
        step_errors = self._measure_step_errors(checked_runs, references)
        for name in ("summed", *_FREE_STEP_SCENARIOS):
            if name in runs:
                extremes = _find_extremes_around(runs[name], references, self._step)
                threshold = self._choose_threshold(runs[name], step_errors, scale)
                excess = _measure_excess(runs[name], extremes) - threshold
                yield from self._describe_worst_jump(name, runs[name], excess / scale, extremes)
        for name in ("refreshed", "repeated"):
            if name in runs:
                expected_rows = nominal.rows[: len(runs[name].rows)]
                extremes = (expected_rows, expected_rows)
                excess = _measure_excess(runs[name], extremes) - _EQUALITY_TOLERANCE * scale
                yield from self._describe_worst_jump(name, runs[name], excess / scale, extremes)

    def _measure_step_errors(
        self, checked_runs: Sequence[_Run], references: Sequence[_Run]
    ) -> Array:
        """Return the largest distance (outputs,) of runs from the other references."""
        step_errors = np.zeros(len(self._outputs))
        for run in checked_runs:
            # Small steps differ from each other if outputs are fast.
            other_references = [reference for reference in references if reference is not run]
            extremes = _find_extremes_around(run, other_references or references, self._step)
            step_errors = np.maximum(step_errors, _measure_excess(run, extremes).max(axis=0))
        return step_errors

    def _choose_threshold(self, run: _Run, step_errors: Array, scale: Array) -> Array:
        """Return the excess (outputs,) that counts as a jump; errors grow with the step."""
        step_ratio = max(1.0, float(run.steps.max(initial=0.0)) / self._step)
        # The jumps of discrete outputs depend on the step.
        is_discrete = [variable.variability == "discrete" for variable in self._outputs]
        discrete_allowance = np.where(is_discrete, np.inf, 0.0)
        return np.asarray(
            _JUMP_THRESHOLD * step_ratio * step_errors
            + _MIN_RELATIVE_JUMP * scale
            + discrete_allowance
        )

    def _describe_worst_jump(
        self, name: str, run: _Run, excess: Array, extremes: tuple[Array, Array]
    ) -> Iterator[str]:
        is_outside = ~(excess <= 0.0)  # NaN is bad
        if not is_outside.any():
            return
        sizes = np.where(np.isnan(excess), np.inf, excess)
        index = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        other_count = int(is_outside.any(axis=0).sum()) - 1
        others_text = ""
        if other_count:
            others_text = f" (and {count_noun(other_count, 'more output')})"
        lowest = extremes[0][index]
        highest = extremes[1][index]
        expected_text = f"from {lowest:.6g} to {highest:.6g}"
        if lowest == highest:
            expected_text = f"{lowest:.9g}"
        yield (
            f"{_SCENARIO_NAMES[name]}: {quote(self._outputs[index[1]].name)}{others_text} is "
            f"{run.rows[index]:.9g} at {run.times[index[0]]:.6g} s after a step of "
            f"{run.steps[index[0]]:.6g} s, where steps of {self._step:g} s and less give "
            f"{expected_text}."
        )


def _choose_step(model_description: ParsedDescription) -> float:
    """Return the preferred step [s] of an FMU, or the default one."""
    step_size = real(model_description.experiment.get("stepSize"))
    if step_size is None or not 0.0 < step_size < math.inf:
        return _DEFAULT_STEP
    return step_size


def _can_vary_step(simulation: InterfaceKind | None) -> bool:
    return simulation is not None and simulation.can("canHandleVariableCommunicationStepSize")


def _get_identifier(kind: InterfaceKind | None) -> str | None:
    if kind is None:
        return None
    return kind.identifier


def _choose_excitation(variable: ParsedVariable) -> dict[str, Any]:
    """Return centre and amplitude of an input, within its limits and about its start value."""
    start_value = real(variable.get("start"))
    lower = real(variable.get("min"))
    upper = real(variable.get("max"))
    centre = 0.0
    if start_value is not None and math.isfinite(start_value):
        centre = start_value
    amplitude = 0.5 * (real(variable.get("nominal")) or 1.0)
    if lower is not None and upper is not None and math.isfinite(upper - lower):
        centre = 0.5 * (lower + upper)
        amplitude = min(amplitude, 0.4 * (upper - lower))
    elif lower is not None:
        centre = max(centre, lower + amplitude)
    elif upper is not None:
        centre = min(centre, upper - amplitude)
    return {"reference": variable.reference, "centre": centre, "amplitude": amplitude}


def _read_run(outcome: Any, output_count: int) -> _Run:
    times = np.array(outcome.get("times", []), dtype=float)
    fresh_rows = outcome.get("fresh", [])
    refusal = outcome.get("refused", "")
    if not isinstance(refusal, str):
        raise TypeError(refusal)
    return _Run(
        times=times,
        steps=np.array(outcome.get("steps", []), dtype=float).reshape(times.shape),
        rows=np.array(outcome.get("rows", []), dtype=float).reshape(times.size, output_count),
        fresh=np.array(fresh_rows, dtype=float).reshape(len(fresh_rows), output_count),
        refused=refusal,
        taken=outcome.get("taken"),
    )


def _measure_scale(rows: Array) -> Array:
    """Return the range (outputs,) of each output, at least its round-off."""
    finite = np.where(np.isfinite(rows), rows, 0.0)
    rounding = np.maximum(1e-9 * np.abs(finite).max(axis=0), 1e-12)
    scale: Array = np.maximum(np.ptp(finite, axis=0), rounding)
    return scale


def _find_extremes_around(
    run: _Run, references: Sequence[_Run], step_size: float
) -> tuple[Array, Array]:
    """Return minimum and maximum (N, outputs) of references around the times of a run."""
    lowest = np.full_like(run.rows, np.inf)
    highest = np.full_like(run.rows, -np.inf)
    for k, (time, last_step) in enumerate(zip(run.times, run.steps, strict=True)):
        reach = 1.01 * (step_size + max(step_size, float(last_step)))
        for reference in references:
            first, last = np.searchsorted(reference.times, (time - reach, time + reach))
            rows = reference.rows[min(first, len(reference.rows) - 1) : max(last, first + 1)]
            lowest[k] = np.minimum(lowest[k], rows.min(axis=0))
            highest[k] = np.maximum(highest[k], rows.max(axis=0))
    return lowest, highest


def _measure_excess(run: _Run, extremes: tuple[Array, Array]) -> Array:
    """Return the distance (N, outputs) of a run from a range."""
    excess: Array = np.maximum(np.maximum(extremes[0] - run.rows, run.rows - extremes[1]), 0.0)
    return excess
