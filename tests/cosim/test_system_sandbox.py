"""All untrusted FMUs of a system run in one process, with the results of trusted ones."""

import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hostile import archived, infected
from processes import list_children
from small_fmus import LAGS, lag
from small_study import Hesr, hesr_here

from cosim.systems.signals import Signals
from cosim.systems.simulation import Master
from cosim.systems.system import SystemSpec
from fmu_src.run import sandbox
from fmu_src.run.fmu import POOL
from fmu_src.run.master import PythonStepper
from fmu_src.run.sandbox import SandboxStepper, SystemSandbox
from hesr_model.errors import SimulationError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="processes are those of POSIX")


@pytest.fixture(scope="module")
def hostile_lag(lag_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return infected(lag_fmu, tmp_path_factory.mktemp("hostile") / "Lag.fmu")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def foreign(fmu: Path, copy: Path) -> Path:
    with zipfile.ZipFile(fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    return archived(members | {"extra/note.txt": b"mine"}, copy)


def spec(a: Path, b: Path, folder: Path, *, change: tuple[str, str] = ("", "")) -> SystemSpec:
    """Two lags, of which b steps every other time."""
    text = LAGS.replace("FMU", str(a), 1).replace("FMU", str(b)).replace(*change)
    path = folder / "lags.toml"
    path.write_text(text, encoding="utf-8")
    return SystemSpec.read(path)


def children() -> int:
    return len(list_children())


def run(own: SystemSpec, runs: int = 1, **options: bool) -> Signals:
    with Master(own, **options) as master:
        return [master.run() for _ in range(runs)][-1]


def assert_same(one: Signals, other: Signals) -> None:
    assert one.t.tobytes() == other.t.tobytes()
    assert {n: v.tobytes() for n, v in one.signals.items()} == {
        n: v.tobytes() for n, v in other.signals.items()
    }
    assert str(one.failure) == str(other.failure)


CHANGES = {
    "plain": ("", ""),
    "long": ("stop = 1.0", "stop = 60.0"),
    "jacobi": ("step = 0.1", 'order = "jacobi"\nstep = 0.1'),
    "fails": ("start = { u = 2.0,", "start = { u = 2.0, refused = 0.35,"),
    "limits": ("[connections]", '[limits]\n"b.y" = [0.0, 0.45]\n[connections]'),
    "limits at once": ("[connections]", '[limits]\n"a.y" = [0.3, 1.0]\n[connections]'),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
@pytest.mark.parametrize("compiled", [True, False])
def test_results_and_errors_are_those_of_trusted_fmus(
    lag_fmu: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    change: tuple[str, str],
    compiled: bool,
) -> None:
    ours = run(spec(lag_fmu, lag_fmu, tmp_path, change=change), runs=2)
    if not compiled:
        monkeypatch.setattr(sandbox, "write_library", lambda _folder: None)
    copy = foreign(lag_fmu, tmp_path / "Lag.fmu")
    own, before = spec(copy, copy, tmp_path, change=change), children()
    with Master(own) as master:
        assert type(master._stepper) is SandboxStepper
        assert children() == before + 1
        theirs = [master.run() for _ in range(2)][-1]
    assert children() == before
    assert_same(ours, theirs)
    assert_same(ours, run(own, isolate=True))


def test_fmus_of_fmi_3_share_a_process_too(lag_fmu: Path, tmp_path: Path) -> None:
    new = foreign(lag(tmp_path, fmi=3), tmp_path / "New.fmu")
    assert_same(run(spec(lag_fmu, lag_fmu, tmp_path)), run(spec(new, new, tmp_path)))


def test_isolated_fmus_have_a_process_each(lag_fmu: Path, tmp_path: Path) -> None:
    copy, before = foreign(lag_fmu, tmp_path / "Lag.fmu"), children()
    with Master(spec(copy, copy, tmp_path), isolate=True) as master:
        assert type(master._stepper) is PythonStepper
        assert children() == before + 2
    assert children() == before


def test_trusted_fmus_stay_in_this_process(lag_fmu: Path, tmp_path: Path) -> None:
    copy, before = foreign(lag_fmu, tmp_path / "Lag.fmu"), children()
    with Master(spec(copy, lag_fmu, tmp_path)) as master:
        assert children() == before + 1
        found = master.run()
    assert_same(found, run(spec(lag_fmu, lag_fmu, tmp_path)))


def test_pools_keep_no_fmu_of_an_ended_process(lag_fmu: Path, tmp_path: Path) -> None:
    own = spec(foreign(lag_fmu, tmp_path / "Lag.fmu"), lag_fmu, tmp_path)
    try:
        found = []
        for _ in range(2):
            with Master(own, loaded=POOL) as master:
                found.append(master.run())
        assert_same(*found)
    finally:
        POOL.clear()


@pytest.mark.parametrize(
    ("deed", "rows"), [("fmi2DoStep segfault", 2), ("fmi2DoStep exit", 2), ("fmi2SetReal abort", 0)]
)
def test_a_crash_names_its_fmu_and_keeps_earlier_rows(
    lag_fmu: Path,
    hostile_lag: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    deed: str,
    rows: int,
) -> None:
    monkeypatch.setenv("DEED", deed)
    own, before = spec(foreign(lag_fmu, tmp_path / "Lag.fmu"), hostile_lag, tmp_path), children()
    with Master(own) as master:
        found = master.run()
        again = master.run()
    call = deed.split()[0]
    assert str(found.failure).startswith(f"Lag.fmu ('b') at t = 0 s: {call} ")
    assert len(found.t) == rows
    assert again.failure
    assert len(again.t) == 0
    assert children() == before


@pytest.mark.parametrize("deed", ["talk", "dribble", "half a word", "loop", "fork", "hang up"])
def test_nonsense_ends_a_system(
    hostile_lag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deed: str
) -> None:
    monkeypatch.setenv("DEED", f"fmi2DoStep {deed}")
    monkeypatch.setattr("cosim.systems.simulation.SECONDS", 5.0)
    own, before = spec(hostile_lag, hostile_lag, tmp_path), children()
    failure = str(run(own).failure or "")
    assert children() == before
    if deed != "fork":  # refused, so that nothing has happened
        # It may have changed the record of the running call.
        assert re.match(r"Lag\.fmu \('[ab]'\) at t = -?[\d.]+ s: fmi2\w+ \w+ .* ended\.$", failure)


def test_each_step_has_the_limit_and_the_run_another(
    hostile_lag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DEED", "fmi2DoStep doze")  # 1 s
    for total, said in ((20.0, "None"), (2.5, "ran for more than 2.5 s")):
        monkeypatch.setattr(
            "cosim.systems.simulation.SystemSandbox",
            lambda _seconds, total=total: SystemSandbox(3.0, total),
        )
        change = ("stop = 1.0", "stop = 0.4")
        failure = str(run(spec(hostile_lag, hostile_lag, tmp_path, change=change)).failure)
        assert said in failure


@pytest.mark.parametrize("deed", ["fmi2Instantiate sleep", "load sleep"])
def test_an_fmu_that_never_loads_is_ended(
    hostile_lag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deed: str
) -> None:
    monkeypatch.setenv("DEED", deed)
    monkeypatch.setattr("cosim.systems.simulation.SECONDS", 2.0)
    own, before = spec(hostile_lag, hostile_lag, tmp_path), children()
    with pytest.raises(SimulationError, match="answer within 2 s and"):
        run(own)
    assert children() == before


def test_results_that_are_not_finite_are_refused(
    lag_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copy = foreign(lag_fmu, tmp_path / "Lag.fmu")
    with Master(spec(copy, copy, tmp_path)) as master:
        shared = sandbox.Sandbox.read_shared

        def falsified(own: sandbox.Sandbox, begin: int, size: int) -> bytes:
            data = shared(own, begin, size)
            return data if begin < 40 else np.full(size // 8, np.nan).tobytes()

        monkeypatch.setattr(sandbox.Sandbox, "read_shared", falsified)
        failure = str(master.run().failure)
    assert "steps gave an invalid answer" in failure


def test_isolation_is_an_option_for_systems(lag_fmu: Path, tmp_path: Path, hesr: Hesr) -> None:
    copy = foreign(lag_fmu, tmp_path / "Lag.fmu")
    spec(copy, copy, tmp_path)
    path = tmp_path / "lags.toml"
    written = []
    for number, options in enumerate([(), ("--isolate",)]):
        out = tmp_path / f"{number}.csv"
        assert hesr("simulate", path, "-o", out, *options).code == 0
        written.append(out.read_bytes())
    assert written[0] == written[1]
    sweep = tmp_path / "sweep.toml"
    sweep.write_text('name = "s"\nsystem = "lags.toml"\n[outputs]\n', encoding="utf-8")
    refused = hesr("simulate", sweep, "--isolate")
    assert refused.code == 2
    assert "--isolate is for a system; " in refused.err
