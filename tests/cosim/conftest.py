"""FMUs, alone and as a system."""

import shutil
from collections.abc import Callable
from pathlib import Path

import fakes as stand_ins
import pytest
from closed_loop import Bench, write_fmus
from remedy_places import Place
from rotary_bench import write_bench
from small_fmus import lag
from small_study import Run, hesr_here
from small_twin import ALONE

from cosim.systems.system import SystemSpec
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot
from hesr_model.support.files import models_folder

Shared = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(scope="session")
def friction_fmu(table1_fmu: Path) -> Path:
    """Friction FMU of Table I."""
    return table1_fmu


@pytest.fixture(scope="session")
def lag_fmu(shared: Shared) -> Path:
    """A first-order lag from u to y that refuses steps beyond a given time."""
    return shared("lag", lag) / "Lag.fmu"


@pytest.fixture(scope="session")
def bench(shared: Shared, table1: FrictionModel) -> Bench:
    """The closed loop of the UF850 with the friction of Table I."""
    return Bench.of(shared("loop", lambda folder: write_fmus(folder, table1)), table1)


@pytest.fixture(scope="session")
def rotary_bench(shared: Shared) -> Path:
    """A bench of one motor with logs, a body, laws with and without band, and an FMU."""
    return shared("rotary bench", write_bench)


@pytest.fixture(scope="session")
def study_run(shared: Shared) -> Run:
    """A run of the small study with all tables, in one process; its output goes to a pipe."""

    def make(folder: Path) -> None:
        Run.make(folder, "-o", Run.of(folder).results, "--verbose", program=ALONE)
        Run.of(folder).require_success()

    return Run.of(shared("study", make))


@pytest.fixture(scope="session")
def study_run_for_programs(shared: Shared) -> Run:
    """The same run by workers, with JSON output and a relative output folder."""
    options = ("-o", "results", "--json", "-", "--verbose")

    def make(folder: Path) -> None:
        Run.make(folder, *options)
        Run.of(folder).require_success()

    return Run.of(shared("study for programs", make))


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> Callable[..., SystemSpec]:
    """Replace the slaves that masters load by Python ones; give the system description."""
    stand_ins.install(monkeypatch)
    return stand_ins.system


@pytest.fixture
def place(
    tmp_path: Path,
    rotary_bench: Path,
    small_results: Path,
    lag_fmu: Path,
    arm_model: Robot,
    arm_log: Log,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> Place:
    (tmp_path / "written").mkdir()
    return Place(
        folder=tmp_path / "written",
        bench=shutil.copytree(rotary_bench, tmp_path / "bench"),
        results=small_results,
        results_robot=models_folder() / "uf850" / "robot.toml",
        lag_fmu=lag_fmu,
        run=hesr_here(capsys, monkeypatch),
        arm=arm_model,
        arm_log=arm_log,
    )
