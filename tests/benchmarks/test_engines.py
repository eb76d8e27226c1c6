"""How fast the closed loop with the native arm runs in each engine, side by side."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from cosim.component import Component
from cosim.interop.case import Together
from cosim.interop.engine import Engine, SkippedError, Tools
from cosim.interop.engines import ENGINES
from cosim.master import Master
from cosim.package.container import write_container
from cosim.package.contents import read_contents
from hesr_model.files import models_folder

sys.path.append(str(Path(__file__).parents[1] / "interop"))
from cases import system
from systems import closed_system

Tell = Callable[[str], None]

GROUP = "10 s of the closed loop at 200 Hz in each engine"
TOOLS = Tools(folder=Path(__file__).parents[2] / ".tools/interop")
ROUNDS = 3


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> Together:
    folder = tmp_path_factory.mktemp("closed")
    return system(closed_system(folder / "closed"), folder)


@pytest.fixture
def told(benchmark: BenchmarkFixture, tell: Tell) -> Callable[[str, list[float], float], None]:
    """Print how many times faster than real time the fastest round was."""

    def line(name: str, seconds: list[float], stop: float) -> None:
        speed = stop / min(seconds)
        benchmark.group = GROUP
        benchmark.extra_info |= {"times real time": speed}
        tell(f"{name}: {speed:.0f} times real time, {1e3 * min(seconds):.0f} ms")

    return line


@pytest.mark.parametrize("engine", [e for e in ENGINES if e.together], ids=lambda e: e.name)
def test_engine(
    engine: Engine,
    closed: Together,
    benchmark: BenchmarkFixture,
    told: Callable[[str, list[float], float], None],
) -> None:
    """By the engine's own account of its steps; the rounds' times are those of whole processes."""
    try:
        engine.find(TOOLS)
    except SkippedError as error:
        pytest.skip(f"{engine.name}: {error}: {engine.install}")
    assert engine.together is not None
    seconds: list[float] = []

    def run() -> None:
        with TemporaryDirectory() as folder:
            found = engine.together(TOOLS, closed, Path(folder))
            assert found.seconds is not None
            seconds.append(found.seconds)

    benchmark.pedantic(run, rounds=ROUNDS)
    told(engine.name, seconds, closed.spec.stop)


def test_our_master(
    closed: Together,
    benchmark: BenchmarkFixture,
    told: Callable[[str, list[float], float], None],
) -> None:
    seconds: list[float] = []
    with Master(closed.spec) as master:

        def run() -> None:
            begin = time.perf_counter()
            master.run().require_success()
            seconds.append(time.perf_counter() - begin)

        benchmark.pedantic(run, rounds=ROUNDS, warmup_rounds=1)
    told("our master", seconds, closed.spec.stop)


@pytest.mark.parametrize("read", [True, False], ids=["all outputs read", "only stepped"])
def test_the_loop_as_one_fmu(
    read: bool,
    closed: Together,
    benchmark: BenchmarkFixture,
    told: Callable[[str, list[float], float], None],
    tmp_path: Path,
) -> None:
    """Aim: 200 times real time, on one core."""
    spec = closed.spec
    fmu = write_container(read_contents(spec, tmp_path / "closed"), tmp_path / "closed.fmu")
    seconds: list[float] = []

    def run() -> None:
        with Component(fmu) as loop:
            outputs = loop.batch(list(closed.signals))
            loop.initialise(stop=spec.stop)
            begin = time.perf_counter()
            for k in range(spec.steps):
                loop.step(k * spec.step, spec.step)
                if read:
                    outputs.read()
            seconds.append(time.perf_counter() - begin)

    benchmark.pedantic(run, rounds=ROUNDS, warmup_rounds=1)
    what = "all outputs read" if read else "only stepped"
    told(f"the loop as one FMU, FMPy's container, {what} (aim 200)", seconds, spec.stop)


def test_the_physics_alone(
    closed: Together,
    benchmark: BenchmarkFixture,
    told: Callable[[str, list[float], float], None],
) -> None:
    """What no engine can be faster than: MuJoCo's own steps of the arm."""
    model = mujoco.MjModel.from_xml_path(str(models_folder() / "uf850/uf850.xml"))
    data = mujoco.MjData(model)
    steps = round(closed.spec.stop / model.opt.timestep)
    seconds: list[float] = []

    def run() -> None:
        begin = time.perf_counter()
        mujoco.mj_step(model, data, steps)
        seconds.append(time.perf_counter() - begin)

    benchmark.pedantic(run, rounds=ROUNDS, warmup_rounds=1)
    told("MuJoCo's steps alone", seconds, closed.spec.stop)
