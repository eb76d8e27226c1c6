"""A small arm with known parameters, and slow fixtures shared by all workers."""

import gc
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path

import ci_reports
import numpy as np
import pytest
import shared_folders
from c_hosts import Wine
from cpu_time import CpuTime, Record
from hypothesis import HealthCheck, settings
from nightly_groups import read_groups
from plugin_packages import InstallPlugin, lay_package
from registry_models import everyday, models_of_registry
from threadpoolctl import threadpool_limits

from fmu_src import export_fmu, model_file
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.log_format import LogFormat
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import cache

# The duration of an example and of its generation depends on the load of the machine.
settings.register_profile("unhurried", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("unhurried")

TESTS = Path(__file__).parent
CI_FOLDERS = ("browser", "fuzz", "interop", "real")
"""Folders of tests run only by `make test-all`."""

NIGHTLY = read_groups(TESTS / "nightly.toml")
"""Groups of nightly tests, of which `make nightly` can run one at a time."""

DEFAULT_SELECTION = "not ci and not soak"
"""Tests that `pytest` runs without arguments."""


SAFE_PATH = "PYTHONSAFEPATH"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--nightly",
        choices=("all", *NIGHTLY),
        help="run the nightly tests of this group, and no others",
    )


def pytest_configure(config: pytest.Config) -> None:
    CpuTime.measure(config)
    config.pluginmanager.register(ci_reports)
    names_tests = config.args_source is pytest.Config.ArgsSource.ARGS
    if not config.option.markexpr and not names_tests and config.getoption("--nightly") is None:
        config.option.markexpr = DEFAULT_SELECTION
    # Tests with an empty cache would have every process list all fonts again, and say so if slow.
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    os.environ.setdefault("MPLCONFIGDIR", str(home / "matplotlib"))
    # Hostile FMUs of tests are told by variables what to do.
    os.environ.setdefault("HESR_FMU_ENVIRONMENT", "DEED TARGET PID_FILE FREED ATTACKS")
    # Programs in Java run for seconds: optimising them would take as long again.
    os.environ.setdefault("JAVA_TOOL_OPTIONS", "-XX:TieredStopAtLevel=1")
    # More threads of linear algebra than cores wait for each other, here and in programs that tests
    # start.
    if "OMP_NUM_THREADS" not in os.environ:
        os.environ["OMP_NUM_THREADS"] = "1"
        threadpool_limits(1)
    # Test processes use all cores: jobs stay in them, except in commands that tests start.
    os.cpu_count = lambda: 1
    # Shells start background jobs with SIGINT ignored, which test processes would inherit.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Do not import tests that the marks deselect, nor benchmarks that no argument names."""
    if collection_path.parent != TESTS:
        return None
    if collection_path.name in CI_FOLDERS and "not ci" in config.option.markexpr:
        return True
    if collection_path.name == "benchmarks":
        folder = config.invocation_params.dir
        named = (folder / argument.partition("::")[0] for argument in config.args)
        return None if any(path.is_relative_to(collection_path) for path in named) else True
    return None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Do not search modules and tests for garbage: they stay."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    record = Record()
    for item in items:
        if item.path.relative_to(TESTS).parts[0] in CI_FOLDERS:
            item.add_marker(pytest.mark.ci)
        elif record.is_slow(item):
            item.add_marker(pytest.mark.ci(recorded=True))
        for group in NIGHTLY.values():
            if group.has(item.nodeid):
                item.add_marker(pytest.mark.nightly(group.name))
    if not any("::" in argument for argument in config.args):
        _require_known_entries([item.nodeid for item in items])
    _select_nightly(config, items)


def _is_named(item: pytest.Item, config: pytest.Config) -> bool:
    """Return whether the command line names this test, not only its file or folder."""
    names = (argument for argument in config.args if "::" in argument)
    return any(item.nodeid == name or item.nodeid.startswith(f"{name}[") for name in names)


def _require_known_entries(node_ids: list[str]) -> None:
    """Refuse entries of nightly groups that name no test: renamed tests would run in every gate."""
    for group in NIGHTLY.values():
        unknown = group.missing_files(TESTS.parent) + group.unknown_entries(node_ids)
        if unknown:
            raise pytest.UsageError(f"tests/nightly.toml, {group.name}: there is no {unknown[0]}")


def _select_nightly(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect nightly tests, or all tests outside the nightly group that was asked for."""
    wanted_group = config.getoption("--nightly")
    if wanted_group is None and "nightly" in config.option.markexpr:
        return
    selected: list[pytest.Item] = []
    deselected: list[pytest.Item] = []
    for item in items:
        groups = _nightly_groups(item)
        if wanted_group is None:
            is_wanted = not groups or _is_named(item, config)
        elif wanted_group == "all":
            is_wanted = bool(groups)
        else:
            is_wanted = wanted_group in groups
        (selected if is_wanted else deselected).append(item)
    config.hook.pytest_deselected(items=deselected)
    items[:] = selected


def _nightly_groups(item: pytest.Item) -> set[str]:
    """Return the nightly groups of a test; none if the test belongs to every gate."""
    groups = set()
    for mark in item.iter_markers("nightly"):
        if len(mark.args) != 1 or mark.args[0] not in NIGHTLY:
            known = ", ".join(NIGHTLY)
            raise pytest.UsageError(f"{item.nodeid}: nightly takes one group of {known}")
        groups.add(mark.args[0])
    return groups


ARM_MJCF = """
<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="link1" pos="0 0 0.3">
      <inertial pos="0.01 0.02 -0.03" mass="4" fullinertia="0.02 0.03 0.025 0.001 0.002 0.003"/>
      <joint name="j1" axis="0 0 1" range="-3 3" armature="0.4" damping="2" frictionloss="3"/>
      <body name="link2" pos="0.1 0 0.2">
        <inertial pos="0.15 0.02 0.03" mass="2.5" fullinertia="0.02 0.04 0.03 0.002 0.001 0.003"/>
        <joint name="j2" axis="0 1 0" range="-2 2" armature="0.3"/>
        <body name="link3" pos="0.3 0 0.05">
          <inertial pos="0.1 -0.02 0.03" mass="1.2" fullinertia="0.01 0.02 0.015 0 0.001 0"/>
          <joint name="j3" axis="0 1 0.3" range="-2 2" armature="0.1"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

RATE = 200.0

MakeMotion = Callable[..., Motion]
Shared = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(autouse=True)
def restored_safe_path() -> Generator[None]:
    """Undo that the command line forbids imports from the current folder for this process."""
    before = os.environ.get(SAFE_PATH)
    yield
    if before is None:
        os.environ.pop(SAFE_PATH, None)


@pytest.fixture
def install_plugin(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> InstallPlugin:
    """Return a function that installs a package with entry points of one group for this test."""

    def install(group: str, **points: str) -> None:
        site = lay_package(tmp_path_factory.mktemp("site"), {group: points})
        monkeypatch.syspath_prepend(str(site))

    return install


@pytest.fixture(scope="session")
def session_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of this session, the same for all workers."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


@pytest.fixture(scope="session")
def shared_now(session_folder: Path) -> Shared:
    """Return the folder of a name, filled by the first worker that requests it.

    Tests must not write to it.
    """

    def filled(name: str, fill: shared_folders.Fill) -> Path:
        return shared_folders.fill_once(session_folder / name, name, fill, session_folder)

    return filled


@pytest.fixture(scope="session")
def shared(session_folder: Path, shared_now: Shared) -> Shared:
    """Return the folder of a name, as `shared_now`, also kept for later sessions.

    Only sources and the file of the fixture may determine its content.
    """
    if os.environ.get("CI") == "true":
        return shared_now
    return lambda name, fill: shared_folders.keep(name, fill, session_folder)


@pytest.fixture(scope="session")
def wine(shared_now: Shared) -> Wine:
    """Wine with one settings folder for all tests, because creating it is slower than any test."""
    program = shutil.which("wine") or shutil.which("wine64")
    if program is None:
        pytest.skip("wine, which runs Windows programs, is not installed")
    # Do not search for .NET or a browser.
    own = {"WINEDEBUG": "-all", "DISPLAY": "", "WINEDLLOVERRIDES": "mscoree,mshtml="}

    def make(folder: Path) -> None:
        settled = {**os.environ, **own, "WINEPREFIX": str(folder)}
        subprocess.run([program, "wineboot", "--init"], env=settled, check=True, timeout=600)

    return Wine(program, {**own, "WINEPREFIX": str(shared_now("wine", make))})


@pytest.fixture(scope="session")
def table1() -> FrictionModel:
    """The paper's law with the paper's coefficients."""
    return FrictionModel.read(model_file("uf850-table1"))


@pytest.fixture(scope="session")
def table1_fmu(table1: FrictionModel, shared: Shared) -> Path:
    return shared("table1", lambda to: export_fmu(table1, to / "Friction.fmu")) / "Friction.fmu"


@pytest.fixture(scope="session")
def registry_models(shared: Shared) -> dict[str, FrictionModel]:
    """A fitted model of every law of everyday tests, in registry order."""

    def fit(folder: Path) -> None:
        for model in models_of_registry():
            model.write(folder / f"{model.law}.json")

    folder = shared("registry", fit)
    return {law: FrictionModel.read(folder / f"{law}.json") for law in everyday()}


@pytest.fixture(scope="session")
def small_results(shared: Shared) -> Path:
    """Results of a minimal study that covers every step."""
    from small_results import write_results  # slow import

    return shared("results", write_results) / "results"


@pytest.fixture
def empty_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder, except for the compiler's own C libraries."""
    libraries = cache.folder() / "zig"
    libraries.mkdir(exist_ok=True)
    home = tmp_path_factory.mktemp("cache")
    monkeypatch.setenv("XDG_CACHE_HOME", str(home))
    (cache.folder() / "zig").symlink_to(libraries)
    return cache.folder()


@pytest.fixture
def arm(tmp_path: Path) -> RobotDescription:
    """Description of a three-joint arm, with its MJCF in a temporary folder."""
    model = tmp_path / "arm.xml"
    model.write_text(ARM_MJCF, encoding="utf-8")
    return RobotDescription(
        name="arm", model=model, joints=("j1", "j2", "j3"), log=LogFormat(sample_rate=RATE)
    )


@pytest.fixture
def arm_model(arm: RobotDescription) -> Robot:
    return Robot(arm)


@pytest.fixture
def make_motion(arm_model: Robot) -> MakeMotion:
    """Motions of the arm in closed form: a few harmonics, starting at rest or reversed in time."""

    def make(
        *, name: str = "motion", seconds: float = 10.0, reverse: bool = False, friction: float = 0.0
    ) -> Motion:
        t = np.arange(round(seconds * RATE)) / RATE
        run = t[-1] - t if reverse else t
        way = -1.0 if reverse else 1.0
        base = 2 * np.pi * 0.1
        q, dq, ddq = np.zeros((3, len(t), 3))
        for harmonic, gain in ((1, 1.0), (2, -0.6), (3, 0.4), (5, 0.15)):
            w = base * harmonic
            phase = np.array([0.3, 1.1, 2.3]) * harmonic
            angle = w * run[:, None] + phase
            q += 0.5 * gain * np.sin(angle)
            dq += way * 0.5 * gain * w * np.cos(angle)
            ddq -= 0.5 * gain * w**2 * np.sin(angle)
        tau = arm_model.torque(arm_model.nominal_parameters, q, dq, ddq)
        tau += friction * (np.sign(dq) + 0.5 * dq)
        return Motion(name=name, t=t, q=q, dq=dq, ddq=ddq, tau=tau, q_raw=q)

    return make


@pytest.fixture
def one_way(arm_model: Robot, make_motion: MakeMotion) -> Motion:
    """The first joint turns at one speed, the second one in one direction."""
    motion = make_motion(friction=3.0, seconds=12.0)
    q, dq, ddq = (signal.copy() for signal in (motion.q, motion.dq, motion.ddq))
    q[:, 0], dq[:, 0], ddq[:, 0] = 0.5 * motion.t, 0.5, 0.0
    phase = 2.0 * motion.t
    q[:, 1] = motion.t - 0.5 * np.sin(phase)
    dq[:, 1], ddq[:, 1] = 1.0 - np.cos(phase), 2.0 * np.sin(phase)
    tau = arm_model.torque(arm_model.nominal_parameters, q, dq, ddq)
    tau += 3.0 * (np.sign(dq) + 0.5 * dq)
    return replace(motion, q=q, dq=dq, ddq=ddq, tau=tau, q_raw=q)


@pytest.fixture
def arm_log(make_motion: MakeMotion) -> Log:
    """A log of the arm with friction."""
    motion = make_motion(name="run", friction=3.0)
    return Log(name="run", t=motion.t, q=motion.q, dq=motion.dq, tau=motion.tau)
