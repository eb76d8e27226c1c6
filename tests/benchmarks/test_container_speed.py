"""How fast the closed loop is inside one FMU."""

from collections.abc import Callable
from pathlib import Path

import pytest
from closed_loop import build
from pytest_benchmark.fixture import BenchmarkFixture

from cosim.closed_loop import Scheme
from cosim.component import Component
from cosim.package.container import write_container
from cosim.package.contents import read_contents
from fmu_src import model_file
from hesr_model.artifacts import read_model

Tell = Callable[[str], None]
STOP = 10.0


@pytest.fixture(scope="module")
def container(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loop")
    bench = build(folder, read_model(model_file("uf850-table1")))
    spec = bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))
    return write_container(read_contents(spec, Path("loop.toml")), folder / "loop.fmu")


@pytest.mark.parametrize("steps", [1, 2000], ids=["one call", "a call every 5 ms"])
def test_ten_seconds_in_a_container(
    steps: int, container: Path, benchmark: BenchmarkFixture, tell: Tell
) -> None:
    """Aim: 200 times real time."""
    benchmark.group = "10 s of the closed loop at 200 Hz, six or seven FMUs"
    step = STOP / steps
    with Component(container) as fmu:
        outputs = fmu.batch([f"arm.q_true[{i}]" for i in (1, 2, 3)])

        def begin() -> None:
            if fmu.used:
                fmu.reset()
            fmu.initialise(stop=STOP)

        def run() -> None:
            for k in range(steps):
                fmu.step(k * step, step)
                outputs.read()

        benchmark.pedantic(run, setup=begin, rounds=5, warmup_rounds=1)
    speed = STOP / benchmark.stats.stats.min
    benchmark.extra_info["times real time"] = speed
    tell(f"container, {steps} calls: {speed:.0f} times real time (aim 200)")
