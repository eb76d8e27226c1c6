"""Speed of many loops compared with MuJoCo's own steps, and steps in Python."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import mujoco
import numpy as np
import psutil
import pytest
from closed_loop import Bench, build

from cosim.loop.closed_loop import Scheme
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec, write_system
from fmu_src import model_file
from hesr.extras.sweep.job import run_sweep
from hesr_model.friction.model import FrictionModel

Tell = Callable[[str], None]

EACH = 600  # runs per core, so that start-up costs do not count

STUDY = """
name = "loops"
system = "loop.toml"
design = "latin_hypercube"
runs = 400
chunk = 50
[[inputs]]
variables = ["arm.payload"]
low = 0.0
high = 3.0
[[outputs]]
name = "tracking"
signal = "arm.q_true"
reference = "trajectory.q"
"""


def written(folder: Path, spec: SystemSpec, runs: int) -> Path:
    """Write a study with the given number of runs, and its system."""
    write_system(spec, folder / "loop.toml")
    study = folder / f"study{runs}.toml"
    study.write_text(STUDY.replace("runs = 400", f"runs = {runs}"), encoding="utf-8")
    return study


def lasted(work: Callable[[], object]) -> float:
    """Wall time of a function [s]."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


@contextmanager
def largest_process() -> Iterator[list[int]]:
    """Yield a list that finally has the peak memory of a worker [B]."""
    found, over = [0], threading.Event()

    def look() -> None:
        while not over.wait(0.2):
            for child in psutil.Process().children():
                with suppress(psutil.Error):
                    found[0] = max(found[0], child.memory_info().rss)

    thread = threading.Thread(target=look)
    thread.start()
    try:
        yield found
    finally:
        over.set()
        thread.join()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return build(tmp_path_factory.mktemp("loop"), FrictionModel.read(model_file("uf850-table1")))


@pytest.fixture(scope="module")
def spec(bench: Bench) -> SystemSpec:
    """Ten seconds of the closed loop at 200 Hz."""
    return bench.system(bench.loop(Scheme(compensation="servo_inversion", Kx=5.0)))


def spent(work: Callable[[], object]) -> float:
    """CPU time of this process [s], independent of other processes."""
    start = time.process_time()
    work()
    return time.process_time() - start


def turn_about(works: dict[str, Callable[[], object]], rounds: int = 7) -> dict[str, float]:
    """Least CPU time of each of several functions, interleaved so that other load slows all."""
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            times[name].append(spent(work))
    return {name: min(found) for name, found in times.items()}


def test_loops_in_c(bench: Bench, spec: SystemSpec, tell: Tell) -> None:
    """Targets: 1.7 times the steps in Python, at most 1.6 times MuJoCo's own steps."""
    model = mujoco.MjModel.from_xml_path(str(bench.plant.model))
    count = round(spec.stop / model.opt.timestep)
    with Master(spec) as native, Master(spec, native=False) as readable:
        one, other = native.run().require_success(), readable.run().require_success()
        assert all(np.array_equal(v, other.signals[name]) for name, v in one.signals.items())
        found = turn_about(
            {
                "C": native.run,
                "Python": readable.run,
                "MuJoCo": lambda: mujoco.mj_step(model, mujoco.MjData(model), count),
            }
        )
    shown = ", ".join(f"{name} {1e3 * seconds:.1f} ms" for name, seconds in found.items())
    tell(
        f"{shown}; in C {found['Python'] / found['C']:.2f} times as fast as in Python (aim 1.7), "
        f"{found['C'] / found['MuJoCo']:.2f} times MuJoCo's steps (aim 1.6)"
    )


def test_a_sweep_on_all_cores(spec: SystemSpec, tell: Tell, tmp_path: Path) -> None:
    """Targets: 85 % of the rate of one core times their number, 400 MB per worker."""
    cores = os.cpu_count() or 1
    studies = [written(tmp_path, spec, count) for count in (EACH, EACH * cores)]
    one = EACH / lasted(lambda: run_sweep(studies[0], tmp_path / "one", workers=1))
    with largest_process() as memory:
        rate = EACH * cores / lasted(lambda: run_sweep(studies[1], tmp_path / "all"))
    tell(
        f"{rate:.0f} loops of 10 s a second on {cores} cores, {one:.0f} on one: "
        f"{100 * rate / cores / one:.0f} % of it on each (aim 85); a worker takes at most "
        f"{memory[0] / 1e6:.0f} MB (aim 400)"
    )


def test_a_sweep_on_a_cluster(spec: SystemSpec, tell: Tell, tmp_path: Path) -> None:
    """Target: equal time on two dask.distributed workers and in two processes, within 10 %."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    study = written(tmp_path, spec, 2 * EACH)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as local:
        address = local.scheduler_address
        run_sweep(written(tmp_path, spec, 100), tmp_path / "first", cluster=address)  # imports
        there = lasted(lambda: run_sweep(study, tmp_path / "there", cluster=address))
    here = lasted(lambda: run_sweep(study, tmp_path / "here", workers=2))
    tell(f"{2 * EACH} loops: {there:.1f} s on the cluster, {here:.1f} s here: {there / here:.2f}")
