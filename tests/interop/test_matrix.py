"""Every engine gives the results of our own code with its exchange scheme."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from cases import NAMES, OF_FMI_3
from interop.case import Alone, Case, deviation
from interop.engine import Engine, Tools
from interop.engines import ENGINES
from interop.matrix import EngineResult

SYSTEMS = ("open", "observed", "closed")
REASONS = (
    "it runs systems",
    "it runs one FMU only",
    "it is for model exchange, the FMU is not",
    "it evaluates between events, where the FMU holds its signs",
    "the FMU's co-simulation integrates in a way of its own",
    "it is run with FMI 2.0 only",
    "it takes no arrays of several elements",
    "it reads no units with kelvin in FMI 3.0",
)


@pytest.mark.parametrize("case", NAMES)
@pytest.mark.parametrize("engine", ENGINES, ids=lambda engine: engine.name)
def test_each_engine_matches(
    engine: Engine,
    case: str,
    need: Callable[[Engine], None],
    cell: Callable[[Engine, str | Case], EngineResult],
) -> None:
    need(engine)
    if (engine.together if case in SYSTEMS else engine.alone) is None:
        pytest.skip(f"{engine.name} is not for {'systems' if case in SYSTEMS else 'one FMU'}")
    found = cell(engine, case)
    if found.skipped:
        assert found.skipped in REASONS
        pytest.skip(found.skipped)
    assert not found.harness, f"the harness fails on its control: {found.harness}"
    assert not found.failure, found.failure
    assert found.deviation is not None
    assert found.deviation <= found.tolerance


SAME = 1e-15
"""Tolerance between an engine's results for FMI 3.0 and FMI 2.0, relative to the largest value."""

STEP = 2.0**-8
"""[s]; its multiples are exact, so the engines' different sums of steps agree."""


@pytest.mark.parametrize("name", OF_FMI_3)
@pytest.mark.parametrize(
    "engine", [e for e in ENGINES if e.alone is not None], ids=lambda engine: engine.name
)
def test_fmi_3_matches_fmi_2(
    engine: Engine,
    name: str,
    versions: dict[str, tuple[Alone, Alone]],
    tools: Tools,
    need: Callable[[Engine], None],
    cell: Callable[[Engine, str | Case], EngineResult],
    tmp_path: Path,
) -> None:
    """In each engine, and compared with our own code."""
    need(engine)
    old, new = versions[name]
    found = cell(engine, new)
    if found.skipped:
        assert found.skipped in REASONS
        pytest.skip(found.skipped)
    assert not found.harness, f"the harness fails on its control: {found.harness}"
    assert not found.failure, found.failure
    assert found.deviation is not None
    assert found.deviation <= found.tolerance
    assert engine.alone is not None
    runs = []
    for case in (old, new):
        folder = tmp_path / str(case.fmi)
        folder.mkdir()
        runs.append(engine.alone(tools, replace(case, step=STEP), folder))
    assert deviation(runs[1], runs[0].signals) <= SAME
