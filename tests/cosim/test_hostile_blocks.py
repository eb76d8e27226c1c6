"""Parts of a loop under hostile call sequences of a master."""

from pathlib import Path

import pytest
from closed_loop import Bench

from fmu_src.check.run import check


def complaints(fmu: Path) -> list[str]:
    report = check(fmu, kinds=["hostile"])
    assert not any(reason.startswith("Hostile") for reason in report.skipped)
    return [problem.found for problem in report.problems]


@pytest.mark.ci
@pytest.mark.parametrize("name", ["trajectory", "body", "controller", "velocity"])
def test_a_part_survives_hostile_calls(bench: Bench, name: str) -> None:
    assert complaints(getattr(bench.fmus, name)) == []


@pytest.mark.soak
def test_the_arm_survives_hostile_calls(bench: Bench) -> None:
    assert complaints(bench.fmus.arm) == []
