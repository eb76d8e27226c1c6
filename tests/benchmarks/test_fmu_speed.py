"""Speed of the friction FMU from Python, in a C host, and compared with a PythonFMU."""

import re
import shutil
import subprocess
import time
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from c_hosts import build_host
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from pytest_benchmark.fixture import BenchmarkFixture
from pythonfmu.builder import FmuBuilder

from fmu_src import export_fmu, model_file
from fmu_src.run import native
from fmu_src.run.fmu import FmuInstance, remember
from fmu_src.run.replay import replay
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.residual import FrictionRecord

STEP = 0.005
Tell = Callable[[str], None]


@pytest.fixture(scope="module")
def model() -> FrictionModel:
    return FrictionModel.read(model_file("uf850-table1"))


@pytest.fixture(scope="module")
def fmu(model: FrictionModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_fmu(model, tmp_path_factory.mktemp("fmu") / "Friction.fmu")


@pytest.fixture(scope="module", params=["native", "PythonFMU", "PythonFMU, lowered"])
def any_fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The FMU, and the same law as PythonFMU in two variants."""
    if request.param == "native":
        path: Path = request.getfixturevalue("fmu")
        return path
    script = "slave.py" if request.param == "PythonFMU" else "lowered_slave.py"
    folder = tmp_path_factory.mktemp("python")
    built = Path(FmuBuilder.build_FMU(Path(__file__).with_name(script), dest=folder))
    remember(built)  # in this process, since its doStep is called alone
    return built


def test_friction_step(any_fmu: Path, benchmark: BenchmarkFixture) -> None:
    """Target: 1.3 us for the native one, at most a fifth of the others."""
    benchmark.group = "doStep of three joints through FMPy"
    with FmuInstance(any_fmu) as component:
        component.initialise(start={"dq[1]": 0.3})
        step, instance = component._instance.slave.fmi2DoStep, component._instance.slave.component
        counter = iter(range(10**9))
        benchmark(lambda: step(instance, next(counter) * STEP, STEP, True))
        assert component.get(["tau[1]"])[0] != 0.0


def test_set_step_get(any_fmu: Path, benchmark: BenchmarkFixture) -> None:
    benchmark.group = "set, doStep, get of three joints through a FmuInstance"
    with FmuInstance(any_fmu) as component:
        component.initialise()
        inputs = component.buffer([f"dq[{i}]" for i in (1, 2, 3)])
        outputs = component.buffer([f"tau[{i}]" for i in (1, 2, 3)])
        counter = iter(range(10**9))

        def sample() -> None:
            inputs.values[:] = 0.3
            inputs.write()
            component.step(next(counter) * STEP, STEP)
            outputs.read()

        benchmark(sample)
        assert np.all(outputs.values != 0.0)


@pytest.fixture(scope="module")
def host(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_host("host.c", tmp_path_factory.mktemp("host"))


class InHost:
    """doStep of three joints in a C host."""

    def __init__(self, host: Path, fmu: Path, folder: Path) -> None:
        about = read_model_description(str(fmu))
        with zipfile.ZipFile(fmu) as archive:
            name = next(n for n in archive.namelist() if n.startswith("binaries/linux64/"))
            library = archive.extract(name, folder)
        tau = str(next(v.valueReference for v in about.modelVariables if v.name == "tau[1]"))
        self._command = (str(host), library, about.guid, "3", tau)
        self._folder = folder

    def _run(self, steps: int, *before: str) -> subprocess.CompletedProcess[str]:
        command = [*before, *self._command, str(steps), "time"]
        return subprocess.run(command, capture_output=True, text=True, check=True)

    def time(self) -> float:
        """Return the duration of a step [ns]."""
        return float(self._run(20_000).stdout)

    def instructions(self) -> float:
        """Return the number of instructions of a step, which is independent of the load."""
        counting = ("valgrind", "--tool=callgrind", f"--callgrind-out-file={self._folder}/out",
                    "--toggle-collect=fmi2DoStep")  # fmt: skip
        texts = [self._run(steps, *counting).stderr for steps in (10, 30)]
        few, many = (int(re.search(r"Collected : (\d+)", text)[1]) for text in texts)
        return (many - few) / 2000


@pytest.mark.parametrize("discretisation", ["euler", "exact"])
def test_step_in_a_c_host(
    discretisation: str, model: FrictionModel, host: Path, benchmark: BenchmarkFixture,
    tmp_path: Path, tell: Tell,
) -> None:  # fmt: skip
    """Target: 150 ns for three joints of ParFam-H; the number of instructions ignores the load."""
    laws = tuple(replace(law, discretisation=discretisation) for law in model.laws)
    in_host = InHost(host, export_fmu(replace(model, laws=laws), tmp_path / "F.fmu"), tmp_path)
    taken = benchmark.pedantic(in_host.time, rounds=5)
    benchmark.extra_info |= {"aim": "150 ns", "ns": taken}
    tell(f"doStep of three joints, {discretisation}: {taken:.0f} ns in a C host")
    if shutil.which("valgrind"):
        tell(f"  {in_host.instructions():.0f} instructions in it, by callgrind")


@pytest.mark.parametrize(
    ("law", "aim"), [("parfam_s_v", 1.3), ("parfam_s_load", None), ("parfam_s", 2.1)]
)
def test_a_step_of_stops_compared_with_lugre(
    law: str, aim: float | None, records: dict[str, list[FrictionRecord]], host: Path,
    tmp_path: Path, tell: Tell,
) -> None:  # fmt: skip
    def in_host(name: str) -> InHost:
        joints = list(zip(*records.values(), strict=True))
        laws = tuple(fit_joint(name, joint, seed=0) for joint in joints)
        own = FrictionModel(
            robot="bench", law=name, sample_time=STEP, laws=laws,
            joints=tuple(joint[0].joint for joint in joints),
        )  # fmt: skip
        folder = tmp_path / name
        return InHost(host, export_fmu(own, tmp_path / f"{name}.fmu"), folder)

    hosts = [in_host(law), in_host("lugre")]
    own, lugres = (
        min(times) for times in zip(*([h.time() for h in hosts] for _ in range(9)), strict=True)
    )
    goal = f" (aim: {aim})" if aim else ""
    tell(f"step of three joints of {law}: {own:.0f} ns, {own / lugres:.2f} of LuGre's{goal}")


def test_instantiation(benchmark: BenchmarkFixture, fmu: Path, tmp_path: Path) -> None:
    """Target: 1 ms without loading the library and reading the XML."""
    about = read_model_description(str(fmu))
    folder = extract(str(fmu), unzipdir=str(tmp_path))
    slave = FMU2Slave(
        guid=about.guid, modelIdentifier=about.coSimulation.modelIdentifier,
        unzipDirectory=folder, instanceName="one",
    )  # fmt: skip

    def live() -> None:
        slave.instantiate()
        slave.fmi2FreeInstance(slave.component)

    benchmark(live)
    slave.freeLibrary()


def test_replay_of_a_log(benchmark: BenchmarkFixture, fmu: Path) -> None:
    t = STEP * np.arange(4000)
    dq = np.stack([np.sin(t)] * 3, axis=1)
    torque = benchmark.pedantic(replay, args=(fmu, t, dq), rounds=5, warmup_rounds=1)
    assert torque.shape == dq.shape


@pytest.mark.parametrize("platforms", ["linux64", "all"])
def test_export(
    platforms: str, benchmark: BenchmarkFixture, model: FrictionModel, tmp_path: Path, tell: Tell
) -> None:
    """Target: 5 s for all platforms with a warm compiler cache; 120 KB and 500 KB."""
    path = benchmark.pedantic(
        export_fmu, args=(model, tmp_path / "F.fmu"), kwargs={"platforms": [platforms]},
        rounds=3, warmup_rounds=1,
    )  # fmt: skip
    tell(f"FMU of three joints, {platforms}: {path.stat().st_size / 1024:.0f} KB")


def test_rows_in_c_compared_with_python(
    fmu: Path, benchmark: BenchmarkFixture, monkeypatch: pytest.MonkeyPatch, tell: Tell
) -> None:
    """Target: twice the speed, although both include loading the FMU."""
    benchmark.group = "replay of a minute at 200 Hz, three joints"
    t = STEP * np.arange(12_000)
    dq = np.sin(np.outer(t, [1.0, 2.0, 3.0]))
    in_c = benchmark.pedantic(lambda: replay(fmu, t, dq), rounds=5, warmup_rounds=1)
    monkeypatch.setattr(native, "_library", lambda: None)
    begin = time.perf_counter()
    in_python = replay(fmu, t, dq)
    slower = (time.perf_counter() - begin) / benchmark.stats.stats.min
    assert in_c.tobytes() == in_python.tobytes()
    tell(f"{slower:.1f} times the speed of steps from Python")
