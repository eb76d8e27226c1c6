"""Every engine gives what our own code gives in its way of coupling."""

from collections.abc import Callable

import pytest
from cases import NAMES

from cosim.interop.engine import Engine
from cosim.interop.engines import ENGINES
from cosim.interop.matrix import EngineResult

SYSTEMS = ("open", "closed")
REASONS = (
    "it runs systems",
    "it runs one FMU only",
    "it is for model exchange, the FMU is not",
    "it evaluates between events, where the FMU holds its signs",
    "the FMU's co-simulation integrates in a way of its own",
)


@pytest.mark.parametrize("case", NAMES)
@pytest.mark.parametrize("engine", ENGINES, ids=lambda engine: engine.name)
def test_engine(
    engine: Engine,
    case: str,
    need: Callable[[Engine], None],
    cell: Callable[[Engine, str], EngineResult],
) -> None:
    need(engine)
    if (engine.together if case in SYSTEMS else engine.alone) is None:
        pytest.skip(f"{engine.name} is not for {'systems' if case in SYSTEMS else 'one FMU'}")
    found = cell(engine, case)
    if found.skipped:
        assert found.skipped in REASONS
        pytest.skip(found.skipped)
    assert not found.failure, found.failure
    assert found.deviation is not None
    assert found.deviation <= found.tolerance
