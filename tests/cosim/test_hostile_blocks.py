"""Parts of a loop, and the whole loop, under hostile call sequences of a master."""

from pathlib import Path

import pytest
from closed_loop import Bench

from cosim.loop.closed_loop import Compensation, Scheme
from fmu_src.check.run import check
from hesr.extras.ssp.container import write_container
from hesr.extras.ssp.contents import read_contents


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


@pytest.mark.soak
@pytest.mark.parametrize("compensation", ["torque_error", "servo_inversion"])
def test_a_container_survives_hostile_calls(
    bench: Bench, compensation: Compensation, tmp_path: Path
) -> None:
    spec = bench.system(bench.loop(Scheme(compensation=compensation, Kx=5.0)))
    contents = read_contents(spec.model_copy(update={"name": "closed"}), Path("closed.toml"))
    assert complaints(write_container(contents, tmp_path / "Closed.fmu")) == []
