"""The matrix of engines and cases, printed at the end of the run."""

from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest
from cases import every_case, of_both_versions
from interop.case import Alone, Case
from interop.control import controls
from interop.engine import Engine, SkippedError, Tools
from interop.engines import ENGINES
from interop.matrix import (
    EngineMatrix,
    EngineResult,
    EngineRow,
    Expected,
    Fault,
    control_faults,
    reference,
    run_cell,
)
from interop.table import notes, table
from rich.console import Console

from cosim.report.tables.terminal import TerminalTable
from hesr_model.support.process import FailedError

_WIDTH = 132

_cases: list[Case] = []
_versions: dict[str, str] = {}
_missing: dict[str, str] = {}
_cells: dict[str, dict[str, EngineResult]] = {}


@pytest.fixture(scope="session")
def tools() -> Tools:
    """Engines installed by `.ci/interop` next to the tests, and those of this machine."""
    return Tools(folder=Path(__file__).parents[2] / ".tools/interop")


@pytest.fixture(scope="session")
def need(tools: Tools) -> Callable[[Engine], None]:
    """Skip the test if an engine is missing."""

    def check(engine: Engine) -> None:
        if engine.name not in _versions | _missing:
            try:
                _versions[engine.name] = engine.find(tools)
            except (SkippedError, FailedError) as error:
                _missing[engine.name] = f"{error}: {engine.install}"
        if engine.name in _missing:
            pytest.skip(f"{engine.name}: {_missing[engine.name]}")

    return check


@pytest.fixture(scope="session")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    _cases[:] = every_case(tmp_path_factory.mktemp("cases"))
    return {case.name: case for case in _cases}


@pytest.fixture(scope="session")
def versions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Alone, Alone]]:
    """FMUs in FMI 2.0 and 3.0."""
    return of_both_versions(tmp_path_factory.mktemp("versions"))


@pytest.fixture(scope="session")
def references() -> Expected:
    return cache(reference)


@pytest.fixture(scope="session")
def fault(tmp_path_factory: pytest.TempPathFactory) -> Fault:
    """Faults of harnesses, by a control that needs no code of ours."""
    return control_faults(controls(tmp_path_factory.mktemp("control")))


@pytest.fixture
def cell(
    tools: Tools,
    references: Expected,
    fault: Fault,
    request: pytest.FixtureRequest,
) -> Callable[[Engine, str | Case], EngineResult]:
    """Run an available engine on a case and keep the result for the table."""

    def run(engine: Engine, case: str | Case) -> EngineResult:
        if isinstance(case, str):
            case = request.getfixturevalue("cases")[case]
        elif case not in _cases:
            _cases.append(case)
        found = run_cell(engine, case, tools, references, fault)
        _cells.setdefault(engine.name, {})[case.name] = found
        return found

    return run


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not _cells:
        return
    rows = [
        EngineRow(
            engine=engine,
            version=_versions.get(engine.name, ""),
            missing=_missing.get(engine.name, ""),
            cells=_cells.get(engine.name, {}),
        )
        for engine in ENGINES
    ]
    matrix = EngineMatrix(cases=_cases, rows=rows)
    terminalreporter.section("engines")
    console = Console(width=_WIDTH)
    with console.capture() as shown:
        console.print(TerminalTable(table(matrix)))
    for line in (*shown.get().splitlines(), *notes(matrix)):
        terminalreporter.write_line(line)
