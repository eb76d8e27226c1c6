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
from fmu_src.check.rules import Problem, rule_of, with_rule
from fmu_src.run.instance import PLATFORM, SUFFIX, DiedError
from fmu_src.run.sandbox import NONSENSE, Sandbox
from hesr_model.support.arrays import Array
from hesr_model.support.text import plain, quoted

SECONDS = 300.0  # for a scenario
STEPS = 200  # of the nominal run
_SCENARIO = "hesr.extras.hostile.scenarios:outcome"
_STEP = 0.01  # [s], unless the FMU prefers one
_ERRORS = 5.0  # threshold of a jump, in step errors of the nominal run
_LEAST = 0.02  # added to it, relative to the range of an output
_SAME = 1e-9  # tolerance of runs that must be equal, relative to the range

_FREE = {
    "fifth": "steps of a fifth of the preferred one",
    "double": "steps of twice the preferred one",
    "irrational": "steps of irrational lengths",
    "tiny": "steps of rounding size between others",
}
"""Scenarios for FMUs whose communication step may vary."""

_NAMES = _FREE | {
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
    damaged = any(rule_of(name).severity == "error" for name, _ in contents.problems)
    if damaged or model_description.attributes.get("fmiVersion") != "2.0":
        return [], ["Hostile master: not run; it needs FMI 2.0 and a valid archive."]
    own = f"binaries/{PLATFORM}/"
    kinds = {
        kind.element: kind
        for kind in model_description.kinds
        if f"{own}{kind.identifier}{SUFFIX}" in contents.files
    }
    if not kinds:
        return [], [f"Hostile master: a binary for this platform, {PLATFORM}, is missing."]
    for name, file in contents.files.items():
        if name.startswith((own, "resources/")):
            target = folder / "hostile" / name
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(file.read_bytes())
    master = _Master(model_description, kinds, folder)
    return list(with_rule("hostile", master.findings())), master.skipped


class _Master:
    def __init__(
        self, about: ParsedDescription, kinds: Mapping[str, InterfaceKind], folder: Path
    ) -> None:
        self._folder = folder
        reals = [
            variable
            for variable in about.variables
            if variable.kind == "Real" and variable.reference is not None
        ]
        self._outputs = [variable for variable in reals if variable.causality == "output"]
        self._simulation = simulation = kinds.get("CoSimulation")
        self._exchange = exchange = kinds.get("ModelExchange")
        step = real(about.experiment.get("stepSize"))
        self._step = _STEP if step is None or not 0.0 < step < math.inf else step
        self._varies = bool(simulation and simulation.can("canHandleVariableCommunicationStepSize"))
        self.skipped: list[str] = []
        self._plan = {
            "folder": str(folder / "hostile"),
            "guid": about.attributes.get("guid", ""),
            "simulation": simulation and simulation.identifier,
            "exchange": exchange and exchange.identifier,
            "step": self._step,
            "steps": STEPS,
            "variable": self._varies,
            "states": len(about.structure["Derivatives"]),
            "indicators": integer(about.attributes.get("numberOfEventIndicators")) or 0,
            "inputs": [
                _excitation(variable) for variable in reals if variable.causality == "input"
            ],
            "outputs": [variable.reference for variable in self._outputs],
        }

    def _scenarios(self) -> list[str]:
        chosen: list[str] = []
        if self._simulation is None:
            self.skipped.append("Hostile steps: co-simulation is not available.")
        else:
            chosen += ["nominal", "summed", "refreshed"]
            if self._varies:
                chosen += ["dense", "held", *_FREE]
            else:
                self.skipped.append(
                    "Hostile steps: canHandleVariableCommunicationStepSize is false, so only "
                    f"steps of {self._step:g} s were tried."
                )
            if self._simulation.can("canGetAndSetFMUstate"):
                chosen.append("repeated")
        if self._exchange is not None:
            chosen += ["exchange", "late", "sizes"]
        return chosen

    def findings(self) -> Iterator[str]:
        runs = self._runs(self._scenarios())
        for name, run in runs.items():
            if run.refused:
                claim = "; canHandleVariableCommunicationStepSize is true" if name in _FREE else ""
                yield f"{_NAMES[name]}: {plain(run.refused.rstrip('.'), 400)}{claim}."
            if run.taken and self._plan["states"]:
                yield f"{_NAMES[name]}: it is accepted without an error."
            if run.taken is False and not self._plan["states"]:
                yield (
                    "fmi2SetContinuousStates with one state is refused by an FMU without states; "
                    "solvers that need one state add it."
                )
        if self._outputs:
            yield from self._jumps(runs)

    def _runs(self, scenarios: Sequence[str]) -> dict[str, _Run]:
        found = dict[str, _Run]()
        sandbox = None
        try:
            for name in scenarios:
                try:
                    if sandbox is None:
                        own = Path(mkdtemp(dir=self._folder))
                        sandbox = Sandbox(own, SECONDS, Path(str(self._plan["folder"])))
                    outcome = sandbox.run(_SCENARIO, self._plan, name)
                    try:
                        found[name] = _run(outcome, len(self._outputs))
                    except (ValueError, TypeError, AttributeError) as error:
                        raise sandbox.died(NONSENSE) from error
                except DiedError as error:
                    sandbox = None
                    found[name] = _run({"refused": f"the FMU {error}"}, len(self._outputs))
        finally:
            if sandbox is not None:
                sandbox.kill()
        return found

    def _jumps(self, runs: Mapping[str, _Run]) -> Iterator[str]:
        nominal = runs.get("nominal")
        if nominal is None or nominal.refused:
            return
        complete = {name: run for name, run in runs.items() if not run.refused}
        small = [complete[name] for name in ("dense", "held") if name in complete]
        reference = small or [nominal]
        scale = _scale(np.concatenate([one.rows for one in reference]))
        own = np.zeros(len(self._outputs))
        fresh = [
            replace(run, times=run.times[:-1], steps=run.steps[1:], rows=run.fresh)
            for name, run in complete.items()
            if name == "refreshed"
        ]
        for own_run in (nominal, *fresh, *small[:-1]):
            # Small steps differ from each other if outputs are fast.
            others = [one for one in reference if one is not own_run]
            around = _find_extremes_around(own_run, others or reference, self._step)
            own = np.maximum(own, _excess(own_run, around).max(axis=0))
        # The jumps of discrete outputs depend on the step.
        free = np.array(
            [np.inf if variable.variability == "discrete" else 0.0 for variable in self._outputs]
        )
        for name in ("summed", *_FREE):
            if name in runs:
                longer = max(1.0, float(runs[name].steps.max(initial=0.0)) / self._step)
                around = _find_extremes_around(runs[name], reference, self._step)
                least = _ERRORS * longer * own + _LEAST * scale + free
                over = _excess(runs[name], around) - least
                yield from self._worst(name, runs[name], over / scale, around)
        for name in ("refreshed", "repeated"):
            if name in runs:
                same = nominal.rows[: len(runs[name].rows)]
                over = _excess(runs[name], (same, same)) - _SAME * scale
                yield from self._worst(name, runs[name], over / scale, (same, same))

    def _worst(
        self, name: str, run: _Run, over: Array, around: tuple[Array, Array]
    ) -> Iterator[str]:
        bad = ~(over <= 0.0)  # NaN is bad
        if not bad.any():
            return
        sizes = np.where(np.isnan(over), np.inf, over)
        at = np.unravel_index(int(np.argmax(sizes)), sizes.shape)
        more = int(bad.any(axis=0).sum()) - 1
        others = f" (and {more} more output{'s' if more > 1 else ''})" if more else ""
        low = around[0][at]
        high = around[1][at]
        right = f"{low:.9g}" if low == high else f"from {low:.6g} to {high:.6g}"
        yield (
            f"{_NAMES[name]}: {quoted(self._outputs[at[1]].name)}{others} is {run.rows[at]:.9g} at "
            f"{run.times[at[0]]:.6g} s after a step of {run.steps[at[0]]:.6g} s, where steps of "
            f"{self._step:g} s and less give {right}."
        )


def _excitation(variable: ParsedVariable) -> dict[str, Any]:
    start, low, high = (real(variable.get(name)) for name in ("start", "min", "max"))
    centre = start if start is not None and math.isfinite(start) else 0.0
    amplitude = 0.5 * (real(variable.get("nominal")) or 1.0)
    if low is not None and high is not None and math.isfinite(high - low):
        centre, amplitude = 0.5 * (low + high), min(amplitude, 0.4 * (high - low))
    elif low is not None:
        centre = max(centre, low + amplitude)
    elif high is not None:
        centre = min(centre, high - amplitude)
    return {"reference": variable.reference, "centre": centre, "amplitude": amplitude}


def _run(outcome: Any, outputs: int) -> _Run:
    times = np.array(outcome.get("times", []), dtype=float)
    fresh = outcome.get("fresh", [])
    refused = outcome.get("refused", "")
    if not isinstance(refused, str):
        raise TypeError(refused)
    return _Run(
        times=times,
        steps=np.array(outcome.get("steps", []), dtype=float).reshape(times.shape),
        rows=np.array(outcome.get("rows", []), dtype=float).reshape(times.size, outputs),
        fresh=np.array(fresh, dtype=float).reshape(len(fresh), outputs),
        refused=refused,
        taken=outcome.get("taken"),
    )


def _scale(rows: Array) -> Array:
    """Return the range (outputs,) of each output, at least its round-off."""
    finite = np.where(np.isfinite(rows), rows, 0.0)
    rounding = np.maximum(1e-9 * np.abs(finite).max(axis=0), 1e-12)
    scale: Array = np.maximum(np.ptp(finite, axis=0), rounding)
    return scale


def _find_extremes_around(
    run: _Run, references: Sequence[_Run], step: float
) -> tuple[Array, Array]:
    """Return minimum and maximum (N, outputs) of references around the times of a run."""
    low = np.full_like(run.rows, np.inf)
    high = np.full_like(run.rows, -np.inf)
    for k, (time, last) in enumerate(zip(run.times, run.steps, strict=True)):
        reach = 1.01 * (step + max(step, float(last)))
        for one in references:
            first, end = np.searchsorted(one.times, (time - reach, time + reach))
            rows = one.rows[min(first, len(one.rows) - 1) : max(end, first + 1)]
            low[k] = np.minimum(low[k], rows.min(axis=0))
            high[k] = np.maximum(high[k], rows.max(axis=0))
    return low, high


def _excess(run: _Run, around: tuple[Array, Array]) -> Array:
    """Return the distance (N, outputs) of a run from a range."""
    over: Array = np.maximum(np.maximum(around[0] - run.rows, run.rows - around[1]), 0.0)
    return over
