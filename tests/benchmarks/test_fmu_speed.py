"""Speed of the friction FMU from Python, in a C host, and compared with a PythonFMU."""

import re
import shutil
import subprocess
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from c_hosts import build_host
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from pytest_benchmark.fixture import BenchmarkFixture
from pythonfmu.builder import FmuBuilder

from fmu_src import export_fmu, model_file
from fmu_src.export.package import read_c_source
from fmu_src.friction.replay import replay
from fmu_src.run import native
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.trust import remember
from hesr_model.fitting.fit import fit_joint
from hesr_model.friction.model import FrictionModel
from hesr_model.laws.stops.form import DEFLECTIONS
from hesr_model.rigid_body.friction_record import FrictionRecord

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


@dataclass(frozen=True)
class InHost:
    """A library with three joints in a C host; `tau` is the first value reference of outputs."""

    host: Path
    library: Path
    guid: str = ""
    tau: int = 3

    @classmethod
    def of(cls, host: Path, fmu: Path, folder: Path) -> "InHost":
        about = read_model_description(str(fmu))
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(folder)
        library = next(folder.glob("binaries/linux64/*.so"))
        tau = next(v.valueReference for v in about.modelVariables if v.name == "tau[1]")
        return cls(host, library, about.guid, tau)

    def _run(self, steps: int, *mode: str, before: tuple[str, ...] = ()) -> tuple[str, str]:
        own = (str(self.host), str(self.library), self.guid, "3", str(self.tau), str(steps))
        done = subprocess.run([*before, *own, *mode], capture_output=True, text=True, check=True)
        return done.stdout, done.stderr

    def time(self) -> float:
        """Return the duration of a step [ns]."""
        return float(self._run(20_000, "time")[0])

    def sample(self) -> float:
        """Return the duration of set, step and get [ns]."""
        return float(self._run(1_000_000, "loop")[0])

    def torques(self) -> list[float]:
        """Return the torques of 2000 steps."""
        return [float(x) for x in self._run(2000)[0].split()]

    def instructions(self) -> float:
        """Return the number of instructions of a step, which is independent of the load."""
        counting = (
            "valgrind",
            "--tool=callgrind",
            f"--callgrind-out-file={self.library.with_suffix('.callgrind')}",
            "--toggle-collect=fmi2DoStep",
        )
        texts = [self._run(steps, "time", before=counting)[1] for steps in (10, 30)]
        few, many = (int(re.search(r"Collected : (\d+)", text)[1]) for text in texts)
        return (many - few) / 2000


def least(*measures: Callable[[], float]) -> list[float]:
    """Return the least duration of each, measured in turns so that all meet the same load."""
    return [min(times) for times in zip(*([m() for m in measures] for _ in range(9)), strict=True)]


@pytest.mark.parametrize("discretisation", ["euler", "exact"])
def test_step_in_a_c_host(
    discretisation: str,
    model: FrictionModel,
    host: Path,
    benchmark: BenchmarkFixture,
    tmp_path: Path,
    tell: Tell,
) -> None:
    """Target: 150 ns for three joints of ParFam-H; the number of instructions ignores the load."""
    laws = tuple(replace(law, discretisation=discretisation) for law in model.laws)
    in_host = InHost.of(host, export_fmu(replace(model, laws=laws), tmp_path / "F.fmu"), tmp_path)
    taken = benchmark.pedantic(in_host.time, rounds=5)
    benchmark.extra_info |= {"aim": "150 ns", "ns": taken}
    tell(f"doStep of three joints, {discretisation}: {taken:.0f} ns in a C host")
    if shutil.which("valgrind"):
        tell(f"  {in_host.instructions():.0f} instructions in it, by callgrind")


def fitted(law: str, records: dict[str, list[FrictionRecord]]) -> FrictionModel:
    joints = list(zip(*records.values(), strict=True))
    laws = tuple(fit_joint(law, joint, seed=0) for joint in joints)
    names = tuple(joint[0].joint for joint in joints)
    return FrictionModel(robot="bench", law=law, sample_time=STEP, laws=laws, joints=names)


@pytest.mark.parametrize(
    ("law", "aim"), [("parfam_s_v", 1.3), ("parfam_s_load", None), ("parfam_s", 2.1)]
)
def test_a_step_of_stops_compared_with_lugre(
    law: str,
    aim: float | None,
    records: dict[str, list[FrictionRecord]],
    host: Path,
    tmp_path: Path,
    tell: Tell,
) -> None:
    def in_host(name: str) -> InHost:
        fmu = export_fmu(fitted(name, records), tmp_path / f"{name}.fmu")
        return InHost.of(host, fmu, tmp_path / name)

    own, lugres = least(in_host(law).time, in_host("lugre").time)
    goal = f" (aim: {aim})" if aim else ""
    tell(f"step of three joints of {law}: {own:.0f} ns, {own / lugres:.2f} of LuGre's{goal}")


def by_hand(model: FrictionModel, folder: Path, gcc: str) -> Path:
    """Compile by_hand.c for a model with one law structure, and return the library."""
    law = model.laws[0]
    stops = law.structure.get("stops", [])
    assert law.structure.get("viscous", ["1", "v", "c"]) == ["1", "v", "c"]
    rows = ("{" + ", ".join(map(repr, own.values.values())) + "}" for own in model.laws)
    widths = (repr(1.0 / float(f"{DEFLECTIONS[place]:.4g}")) for _, place in stops)
    aged = sum(kind == "age" for kind, _ in stops)
    (folder / "by_hand.h").write_text(
        f"#define LAW {('lugre', 'parfam_h', 'parfam_s_v').index(model.law)}\n"
        f"enum {{ COEFFICIENTS = {len(law.values)} }};\n"
        f"enum {{ STOPS = {len(stops) - aged}, AGED = {aged} }};\n"
        f"static const double start[JOINTS][COEFFICIENTS] = {{{', '.join(rows)}}};\n"
        f"static const double per_width[] = {{{', '.join((*widths, '0'))}}};\n",
        encoding="utf-8",
    )
    (folder / "fmi2.h").write_text(read_c_source("fmi2.h"), encoding="utf-8")
    source = Path(__file__).with_name("by_hand.c")
    return compiled(gcc, source, folder / "by_hand.so", f"-I{folder}")


def compiled(gcc: str, source: Path, library: Path, *flags: str) -> Path:
    """Compile a library as its user does."""
    usual = ("-std=c99", "-O2", "-fPIC", "-shared", "-o", str(library))
    subprocess.run([gcc, *usual, *flags, str(source), "-lm"], check=True)
    return library


@pytest.mark.parametrize("law", ["lugre", "parfam_h", "parfam_s_v"])
def test_a_step_compared_with_c_by_hand(
    law: str,
    model: FrictionModel,
    records: dict[str, list[FrictionRecord]],
    host: Path,
    tmp_path: Path,
    tell: Tell,
) -> None:
    """Target: 1.5 times the time of C by hand; from `sources/` 1.2 times that of the binary."""
    if not (gcc := shutil.which("gcc")):
        pytest.skip("gcc is not installed")
    if law != "parfam_h":
        model = fitted(law, {"sweep": records["sweep"]})
    model = replace(model, laws=(replace(model.laws[0], discretisation="exact"),) * 3)
    own = InHost.of(host, export_fmu(model, tmp_path / "F.fmu"), tmp_path)
    hand = replace(own, library=by_hand(model, tmp_path, gcc), tau=3)
    mine = replace(own, library=compiled(gcc, tmp_path / "sources" / "all.c", tmp_path / "own.so"))
    assert mine.torques() == own.torques()
    assert hand.torques() == pytest.approx(own.torques(), rel=1e-9, abs=1e-9)
    times = least(own.sample, hand.sample, mine.sample, own.time, hand.time, mine.time)
    whole, by, source, *steps = times
    tell(
        f"{law}: set, step and get {whole:.0f} ns, {whole / by:.2f} of C by hand (aim: 1.5); gcc "
        f"{source / whole:.2f} of that (aim: 1.2); steps {', '.join(f'{t:.0f}' for t in steps)} ns"
    )


def test_instantiation(benchmark: BenchmarkFixture, fmu: Path, tmp_path: Path) -> None:
    """Target: 1 ms without loading the library and reading the XML."""
    about = read_model_description(str(fmu))
    folder = extract(str(fmu), unzipdir=str(tmp_path))
    slave = FMU2Slave(
        guid=about.guid,
        modelIdentifier=about.coSimulation.modelIdentifier,
        unzipDirectory=folder,
        instanceName="one",
    )

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
        export_fmu,
        args=(model, tmp_path / "F.fmu"),
        kwargs={"platforms": [platforms]},
        rounds=3,
        warmup_rounds=1,
    )
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
