"""Speed of the closed loop with the native arm in each engine."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
import pytest
from interop.case import Together
from interop.engine import Engine, SkippedError, Tools
from interop.engines import ENGINES
from pytest_benchmark.fixture import BenchmarkFixture

from cosim.systems.simulation import Master
from hesr_model.support.files import models_folder

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
    """Print the speed of the fastest round in multiples of real time."""

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
    """As measured by the engine for its steps; times of rounds are those of whole processes."""
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


def test_the_physics_alone(
    closed: Together,
    benchmark: BenchmarkFixture,
    told: Callable[[str, list[float], float], None],
) -> None:
    """MuJoCo's own steps of the arm in Python; timing of the stages costs an extra 10 %."""
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
