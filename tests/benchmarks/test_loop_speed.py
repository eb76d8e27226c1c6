"""Speed of a closed loop of FMUs relative to real time, to the loop without FMI, and by size."""

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from closed_loop import Bench, build
from oracles.monolithic import run_loop
from pytest_benchmark.fixture import BenchmarkFixture
from small_fmus import lag

from cosim.loop.closed_loop import Scheme
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src import model_file
from fmu_src.arm.python_arm.export import export_python_arm
from hesr_model.friction.model import FrictionModel
from hesr_model.support.files import models_folder

Tell = Callable[[str], None]

SCHEMES = {
    "none": Scheme(compensation="none"),
    "torque_error": Scheme(compensation="torque_error"),
    "servo_inversion": Scheme(compensation="servo_inversion", Kx=5.0),
    "filtered": Scheme(compensation="torque_error", source="filtered"),
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return build(tmp_path_factory.mktemp("loop"), FrictionModel.read(model_file("uf850-table1")))


def least(work: Callable[[], object], rounds: int = 5) -> float:
    """Least wall time of several rounds [s]."""
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_ten_seconds_of_the_closed_loop(
    scheme: str, bench: Bench, benchmark: BenchmarkFixture, tell: Tell
) -> None:
    """Targets: 80 times real time, and 1.5 times the wall time of the loop without FMI."""
    benchmark.group = "10 s of the closed loop at 200 Hz, six or seven FMUs"
    loop = bench.loop(SCHEMES[scheme])
    spec = bench.system(loop)
    with Master(spec) as master:
        found = benchmark.pedantic(
            lambda: master.run().require_success(), rounds=5, warmup_rounds=1
        )
        # Interleaved, so that other load slows both.
        pairs = [
            (least(lambda: master.run(), 1), least(lambda: run_loop(loop), 1)) for _ in range(5)
        ]
    with_fmi, without = (min(times) for times in zip(*pairs, strict=True))
    error = float(np.abs(found.vector("arm.q_true") - run_loop(loop).q_true).max())
    speed, ratio = loop.stop / with_fmi, with_fmi / without
    benchmark.extra_info |= {"times real time": speed, "against the loop without FMI": ratio}
    tell(
        f"{scheme}: {len(spec.components)} FMUs, {speed:.0f} times real time (aim 80); "
        f"{1e3 * with_fmi:.0f} ms, without FMI {1e3 * without:.0f} ms, ratio {ratio:.2f} (aim 1.5);"
        f" positions agree to {error:.0e} rad"
    )


def test_ten_seconds_with_the_arm_as_a_python_fmu(
    bench: Bench, benchmark: BenchmarkFixture, tell: Tell, tmp_path: Path
) -> None:
    """Target: 40 times real time."""
    benchmark.group = "10 s of the closed loop at 200 Hz, six or seven FMUs"
    folder = models_folder() / "uf850"
    arm = export_python_arm(folder / "uf850.xml", folder / "arm.toml", tmp_path / "Arm.fmu")
    loop = bench.loop(SCHEMES["servo_inversion"])
    spec = replace(bench, fmus=replace(bench.fmus, arm=arm)).system(loop)
    with Master(spec) as master:
        benchmark.pedantic(lambda: master.run().require_success(), rounds=5, warmup_rounds=1)
        speed = loop.stop / least(lambda: master.run())
    benchmark.extra_info |= {"times real time": speed}
    tell(f"with the arm as a PythonFMU: {speed:.0f} times real time (aim 40)")


def test_starting_the_closed_loop(bench: Bench, benchmark: BenchmarkFixture) -> None:
    """Loading, checking, one step and freeing: the fixed cost of a run."""
    spec = bench.system(bench.loop(SCHEMES["torque_error"]), stop=0.005)

    def live() -> None:
        with Master(spec) as master:
            master.run().require_success()

    benchmark.pedantic(live, rounds=5, warmup_rounds=1)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A nearly empty FMU."""
    return lag(tmp_path_factory.mktemp("small"))


def chain(fmu: Path, count: int, stop: float) -> SystemSpec:
    """A chain of components, each fed by the previous one."""
    names = [f"c{i}" for i in range(count)]
    return SystemSpec.model_validate(
        {
            "step": 0.005,
            "stop": stop,
            "components": [
                {"name": name, "fmu": fmu, "start": {"u": 1.0} if name == "c0" else {}}
                for name in names
            ],
            "connections": {f"{into}.u": f"{out}.y" for out, into in pairwise(names)},
            "observe": [f"{names[-1]}.y"],
        }
    )


def per_step(fmu: Path, count: int, stop: float) -> float:
    """Wall time of one communication step [us]."""
    spec = chain(fmu, count, stop)
    with Master(spec) as master:
        return 1e6 * least(lambda: master.run().require_success(), 3) / spec.steps


def test_cost_grows_linearly_with_components(small: Path, tell: Tell) -> None:
    counts = (5, 10, 20, 50)
    costs = [per_step(small, count, 5.0) for count in counts]
    slope, constant = np.polyfit(counts, costs, 1)
    shown = ", ".join(f"{n}: {c:.1f}" for n, c in zip(counts, costs, strict=True))
    tell(f"us per step by number of components: {shown}; {slope:.2f} us each + {constant:.1f} us")
    assert costs[-1] / counts[-1] < 1.5 * costs[0] / counts[0]


def test_cost_grows_linearly_with_time(small: Path, tell: Tell) -> None:
    stops = (5.0, 20.0, 80.0)
    costs = [per_step(small, 6, stop) for stop in stops]
    shown = ", ".join(f"{s:g} s: {c:.1f}" for s, c in zip(stops, costs, strict=True))
    tell(f"us per step of six components by simulated time: {shown}")
    assert costs[-1] < 1.5 * costs[0]
