"""Every engine on every case: its deviation from the expected results, or why it was not run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from interop.case import Alone, Case, Run, Together, deviation
from interop.control import TOLERANCE, Control
from interop.engine import Engine, SkippedError, Tools
from interop.engines import ENGINES
from interop.reference import alone, together

from fmu_src.run.master import ExchangeScheme
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.process import FailedError
from hesr_model.support.progress import Progress, report_progress, silent


@dataclass(frozen=True, kw_only=True)
class EngineResult:
    """One engine on one case.

    Attributes
    ----------
    deviation : largest difference of a signal relative to its largest value, None if not run.
    tolerance : largest deviation that counts as equal.
    skipped : why it was not run, otherwise empty.
    harness : fault of our harness, found by the control, otherwise empty; the case is not run.
    failure : error, otherwise empty.
    seconds : duration of the steps, None if unknown.
    """

    deviation: float | None = None
    tolerance: float = 0.0
    skipped: str = ""
    harness: str = ""
    failure: str = ""
    seconds: float | None = None

    @property
    def fails(self) -> bool:
        """Whether the engine or its harness failed, or its results differ."""
        return bool(self.failure or self.harness) or (
            self.deviation is not None and not self.deviation <= self.tolerance
        )


@dataclass(frozen=True, kw_only=True)
class EngineRow:
    """One engine.

    Attributes
    ----------
    version : its version, empty if it was not found.
    missing : why it was not found and how to get it, otherwise empty.
    cells : by the name of the case.
    """

    engine: Engine
    version: str = ""
    missing: str = ""
    cells: Mapping[str, EngineResult]


@dataclass(frozen=True, kw_only=True)
class EngineMatrix:
    """Engines by cases."""

    cases: Sequence[Case]
    rows: Sequence[EngineRow]

    @property
    def failing(self) -> list[tuple[str, str]]:
        """Names of engine and case of each failing cell."""
        return [
            (row.engine.name, name)
            for row in self.rows
            for name, cell in row.cells.items()
            if cell.fails
        ]


Fault = Callable[[Engine, Tools, Case], str]
"""Fault of an engine's harness for cases of a kind, as the control shows it; empty if none."""


def control_faults(controls: tuple[Control, Control]) -> Fault:
    """Return a function that runs each engine on the controls, alone and together, once."""

    @cache
    def fault(engine: Engine, tools: Tools, together: bool) -> str:
        control = controls[together]
        try:
            found = deviation(_run(engine, control.case, tools), control.expected)
        except SkippedError:
            return ""
        except FailedError as error:
            return str(error)
        return "" if found <= TOLERANCE else f"it deviates by {found:.1e}"

    return lambda engine, tools, case: fault(engine, tools, isinstance(case, Together))


def compare(
    cases: Sequence[Case],
    tools: Tools,
    *,
    engines: Sequence[Engine] = ENGINES,
    fault: Fault = lambda *_: "",
    progress: Progress = silent,
) -> EngineMatrix:
    """Run all available engines on all cases.

    Raises
    ------
    HesrError
        If our own code cannot run a case.
    """
    expected = cache(reference)
    rows = [
        _row(engine, cases, tools, expected, fault) for engine in report_progress(engines, progress)
    ]
    return EngineMatrix(cases=cases, rows=rows)


Expected = Callable[[Case, ExchangeScheme], Mapping[str, Array]]
"""`reference` with a cache."""


def reference(case: Case, coupling: ExchangeScheme) -> Mapping[str, Array]:
    """Return the results of our own code for a case: (N,) of each signal in its unit."""
    return alone(case) if isinstance(case, Alone) else together(case, coupling)


def _row(
    engine: Engine, cases: Sequence[Case], tools: Tools, expected: Expected, fault: Fault
) -> EngineRow:
    try:
        version = engine.find(tools)
    except (SkippedError, FailedError) as error:
        return EngineRow(engine=engine, missing=f"{error}: {engine.install}", cells={})
    cells = {case.name: run_cell(engine, case, tools, expected, fault) for case in cases}
    return EngineRow(engine=engine, version=version, cells=cells)


def run_cell(
    engine: Engine, case: Case, tools: Tools, expected: Expected, fault: Fault
) -> EngineResult:
    """Run an engine on its control, then on a case, and compare it with the expected results."""
    if said := fault(engine, tools, case):
        return EngineResult(harness=said)
    # Our code runs first: a case that cannot be run is not an engine's fault, and some never end.
    ours = expected(case, engine.coupling if isinstance(case, Together) else ExchangeScheme())
    try:
        run = _run(engine, case, tools)
    except SkippedError as error:
        return EngineResult(skipped=str(error))
    except FailedError as error:
        return EngineResult(failure=str(error))
    return EngineResult(
        deviation=deviation(run, ours),
        tolerance=case.tolerance,
        seconds=run.seconds,
    )


def _run(engine: Engine, case: Case, tools: Tools) -> Run:
    with scratch_folder() as folder:
        if isinstance(case, Together):
            if engine.together is None:
                raise SkippedError("it runs one FMU only")
            if any(
                case.spec.find_step_multiple(component) > 1 for component in case.spec.components
            ):
                raise SkippedError("engines take components with steps of their own in many ways")
            return engine.together(tools, case, folder)
        if engine.alone is None:
            raise SkippedError("it runs systems")
        return engine.alone(tools, case, folder)
