"""Foreign FMUs run in a separate process and cannot harm this one."""

import os
import re
import signal
import tempfile
import zipfile
from contextlib import suppress
from errno import EACCES, EPERM
from pathlib import Path

import numpy as np
import psutil
import pytest
from hostile import archived, infected
from processes import HANG, list_children, started, wait_for
from small_fmus import LAGS
from small_study import Hesr, hesr_here

from cosim.systems.simulation import Master, System
from cosim.systems.system import SystemSpec
from fmu_src.check.run import check
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.instance import Instance
from fmu_src.run.sandbox import Sandbox
from fmu_src.run.trust import hash_folder, is_trusted, remember
from hesr_model.errors import SimulationError
from hesr_model.support import child, child_main, rights
from hesr_model.support.files import sha256

is_restricted = rights.get_landlock_version() >= 6 and rights.has_seccomp()
linux = pytest.mark.skipif(not is_restricted, reason="needs Landlock 6 and seccomp")
pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits are those of POSIX")


@pytest.fixture(scope="session")
def hostile_lag(lag_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return infected(lag_fmu, tmp_path_factory.mktemp("hostile") / "Lag.fmu")


@pytest.fixture(scope="session")
def hostile_friction(friction_fmu: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return infected(friction_fmu, tmp_path_factory.mktemp("hostile") / "Friction.fmu")


@pytest.fixture
def foreign_lag(lag_fmu: Path, tmp_path: Path) -> Path:
    """The same binary with another hash."""
    with zipfile.ZipFile(lag_fmu) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    return archived(members | {"extra/hesr/note.txt": b"mine"}, tmp_path / "Lag.fmu")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def go(fmu: Path, *, seconds: float = 20.0) -> None:
    """Run an FMU through its whole life cycle."""
    with FmuInstance(fmu, name="a", seconds=seconds) as lag:
        inputs, outputs = lag.buffer(["u"]), lag.buffer(["y"])
        lag.initialise(start={"u": 2.0})
        for k in range(3):
            inputs.values[:] = k
            inputs.write()
            lag.step(0.1 * k, 0.1)
            outputs.read()


def children() -> list[int]:
    return [child.pid for child in list_children()]


def test_only_foreign_fmus_run_in_a_separate_process(lag_fmu: Path, foreign_lag: Path) -> None:
    before = children()
    with FmuInstance(lag_fmu):
        assert children() == before
    with FmuInstance(foreign_lag):
        (own,) = set(children()) - set(before)
        assert "hesr_model.support.child_main" in " ".join(psutil.Process(own).cmdline())
    assert children() == before


def test_a_foreign_fmu_gives_bitwise_equal_results(lag_fmu: Path, foreign_lag: Path) -> None:
    text = LAGS.replace("[connections]", '[connections]\n"a.u" = "b.y"')
    for order in ("gauss_seidel", "jacobi"):
        found = []
        for fmu in (lag_fmu, foreign_lag):
            path = foreign_lag.with_name(f"{order}.toml")
            own = text.replace("FMU", str(fmu)).replace(
                "step = 0.1", f'order = "{order}"\nstep = 0.1'
            )
            path.write_text(own, encoding="utf-8")
            found.append(System.read(path).run())
        for name, values in found[0].signals.items():
            np.testing.assert_array_equal(values, found[1].signals[name])


def test_a_step_is_one_message(foreign_lag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = []
    ask = Sandbox.ask

    def counted(sandbox: Sandbox, request: object, most: int, *, stepping: bool) -> object:
        sent.append(request)
        return ask(sandbox, request, most, stepping=stepping)

    monkeypatch.setattr(Sandbox, "ask", counted)
    with FmuInstance(foreign_lag) as lag:
        inputs, outputs = lag.buffer(["u"]), lag.buffer(["y"])
        lag.initialise()
        lag.step(0.0, 0.1)
        outputs.read()
        sent.clear()
        for k in range(1, 11):
            inputs.values[:] = k
            inputs.write()
            lag.step(0.1 * k, 0.1)
            outputs.read()
        assert len(sent) == 10


def test_errors_of_foreign_fmus_read_as_those_of_trusted_ones(
    lag_fmu: Path, foreign_lag: Path
) -> None:
    said = []
    for fmu in (lag_fmu, foreign_lag):
        with FmuInstance(fmu, name="a") as lag:
            lag.initialise(start={"refused": 0.25, "u": 1.0})
            lag.step(0.0, 0.2)
            with pytest.raises(SimulationError) as caught:
                lag.step(0.2, 0.1)
            said.append((str(caught.value), lag.messages))
            lag.reset()
            with pytest.raises(SimulationError, match="it must be positive"):
                lag.initialise(start={"T": -1.0})
    assert said[0] == said[1]
    assert "where it is refused" in said[0][0]


CRASH = r"crashed with signal 11 \(SIGSEGV\)\."
EXIT = r"ended its process with exit code 0\."


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        ("load exit", rf"loading it {EXIT}"),
        ("load segfault", f"loading it {CRASH}"),
        ("fmi2Instantiate exit", rf"loading it {EXIT}"),
        ("fmi2ExitInitializationMode exit", f"fmi2ExitInitializationMode {EXIT}"),
        ("fmi2SetReal segfault", f"fmi2SetReal {CRASH}"),
        ("fmi2DoStep exit", f"fmi2DoStep {EXIT}"),
        ("fmi2DoStep segfault", f"fmi2DoStep {CRASH}"),
        ("fmi2GetReal exit", f"fmi2GetReal {EXIT}"),
        ("fmi2DoStep abort", r"fmi2DoStep crashed with signal 6 \(SIGABRT\)\."),
        ("fmi2DoStep crash beside", f"fmi2DoStep {CRASH}"),
        ("fmi2DoStep memory", r"fmi2DoStep crashed with signal 6 \(SIGABRT\)\."),
        ("fmi2DoStep file", r"fmi2DoStep ended its process with exit code 9\."),
        # Into every file, including the one that records the current call.
        ("fmi2DoStep talk", r"fmi2\w+ gave an invalid answer.*"),
        ("fmi2DoStep pull away", f"fmi2DoStep {EXIT}"),
        ("fmi2DoStep hang up", "fmi2DoStep closed its connection and was ended."),
    ],
)
def test_a_crash_of_its_process_is_one_sentence(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, deed: str, said: str
) -> None:
    here, before = Path.cwd(), children()
    monkeypatch.setenv("DEED", deed)
    with pytest.raises(SimulationError, match=rf"^Lag\.fmu \('a'\) at t = 0(\.1)? s: {said}$"):
        go(hostile_lag)
    assert Path.cwd() == here
    assert children() == before


@pytest.mark.parametrize(
    "deed",
    [
        pytest.param("load loop", marks=pytest.mark.ci),
        "fmi2DoStep loop",
        "fmi2DoStep half a word",
        "fmi2DoStep dribble",
    ],
)
def test_a_call_that_never_returns_is_ended(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, deed: str
) -> None:
    monkeypatch.setenv("DEED", deed)
    what = {"load": "loading it"}.get(deed.split()[0], r"fmi2\w+")
    before = children()
    with pytest.raises(SimulationError, match=f"{what} gave no answer within 4 s"):
        go(hostile_lag, seconds=4.0)
    assert children() == before


@pytest.mark.parametrize(
    "deed",
    [
        *("fmi2DoStep chdir", "fmi2DoStep flood", "fmi2DoStep dig", "fmi2DoStep fork"),
        *("fmi2DoStep deafen", "fmi2DoStep multiply", "fmi2DoStep litter"),
        *("fmi2FreeInstance segfault", "fmi2FreeInstance exit", "fmi2FreeInstance sleep"),
        *("fmi2Terminate abort", "fmi2Terminate sleep"),
    ],
)
def test_harmless_side_effects_are_allowed(
    hostile_lag: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    deed: str,
) -> None:
    here, before = Path.cwd(), children()
    monkeypatch.setenv("DEED", deed)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("fmu_src.run.sandbox._FREE_TIMEOUT", 1.0)
    go(hostile_lag)
    assert Path.cwd() == here
    assert children() == before
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


def test_all_its_child_processes_are_ended(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "pid"
    monkeypatch.setenv("PID_FILE", str(file))
    monkeypatch.setenv("DEED", "fmi2DoStep flee")
    with pytest.raises(SimulationError, match=rf"fmi2DoStep {EXIT}"):
        go(hostile_lag)
    if is_restricted:  # no process starts
        assert not file.exists()
        return
    with suppress(psutil.NoSuchProcess):
        # Where orphans are not reaped, a killed process remains as a zombie.
        assert psutil.Process(int(file.read_text())).status() == psutil.STATUS_ZOMBIE


REFUSED = {
    **dict.fromkeys(
        ("read", "read by a link", "write", "create", "truncate", "remove", "move"), EACCES
    ),
    **dict.fromkeys(("permit", "socket 1", "socket 2", "execute", "fork", "trace"), EPERM),
    **dict.fromkeys(("signal", "signal all", "signal by a file"), EPERM),
}
"""What foreign code tries, and the error it gets."""


@linux
@pytest.mark.parametrize("deed", REFUSED)
@pytest.mark.parametrize("place", ["load", "fmi2DoStep"])
def test_foreign_code_has_few_rights(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, deed: str, place: str
) -> None:
    home = tmp_path / "home"
    home.mkdir()
    target = home / "secret"
    if deed != "create":
        target.write_text("secret")
        target.chmod(0o600)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("TARGET", str(target))
    monkeypatch.setenv("DEED", f"{place} try {deed}")
    with pytest.raises(SimulationError, match=rf"exit code {REFUSED[deed]}\b"):
        go(hostile_lag)
    assert not target.exists() if deed == "create" else target.read_text() == "secret"


@linux
@pytest.mark.ci
@pytest.mark.parametrize("deed", ["write", "fork"])
def test_foreign_code_has_few_rights_on_older_kernels(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, deed: str
) -> None:
    """Without file descriptors of processes, each foreign FMU starts a Python of its own."""
    monkeypatch.delattr(os, "pidfd_open")
    before = set(children())
    with FmuInstance(hostile_lag):
        (own,) = set(children()) - before
        assert "python" in psutil.Process(own).cmdline()[0]
        assert psutil.Process(own).ppid() == os.getpid()
    (tmp_path / "secret").write_text("secret")
    monkeypatch.setenv("TARGET", str(tmp_path / "secret"))
    monkeypatch.setenv("DEED", f"fmi2DoStep try {deed}")
    with pytest.raises(SimulationError, match=rf"exit code {REFUSED[deed]}\b"):
        go(hostile_lag)
    assert (tmp_path / "secret").read_text() == "secret"


@linux
@pytest.mark.parametrize("deed", ["read", "create"])
def test_foreign_code_has_its_scratch_folder(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, deed: str
) -> None:
    """A control: the same attempts succeed there, so that the errors above mean something."""
    monkeypatch.setenv("TARGET", "own" if deed == "create" else "/usr/lib/os-release")
    monkeypatch.setenv("DEED", f"fmi2DoStep try {deed}")
    with pytest.raises(SimulationError, match=r"exit code 99\b"):
        go(hostile_lag)


@linux
@pytest.mark.parametrize("deed", ["read", "execute", "signal"])
def test_readers_of_untrusted_files_have_few_rights_too(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, deed: str
) -> None:
    (tmp_path / "secret").write_text("secret")
    monkeypatch.setenv("TARGET", str(tmp_path / "secret"))
    monkeypatch.setenv("DEED", f"fmi2DoStep try {deed}")
    (hostile,) = check(hostile_lag, kinds=["hostile"]).problems[-1:]
    assert f"exit code {REFUSED[deed]}" in str(hostile.found)


@pytest.mark.parametrize("missing", rights.MECHANISMS)
def test_what_a_missing_mechanism_permits_is_said_once(
    missing: rights.Mechanism, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(child, "_told_risks", set())
    held = [mechanism.name for mechanism in rights.MECHANISMS if mechanism != missing]
    child.warn_of_risks([*held, missing.name])
    assert caplog.messages == []
    child.warn_of_risks(held)
    child.warn_of_risks(held)
    (warning,) = caplog.messages
    assert missing.risk in warning
    assert f"no {missing.name}" in warning
    assert not any(other.risk in warning for other in rights.MECHANISMS if other != missing)


STATUSES = {-1: "illegal return code", 6: "illegal return code", 2147483647: "illegal return code",
            4: "fatal"}  # fmt: skip


@pytest.mark.parametrize("call", ["fmi2DoStep", "fmi2SetReal", "fmi2ExitInitializationMode"])
@pytest.mark.parametrize("status", STATUSES)
@pytest.mark.parametrize("place", ["sandbox", "python", "native"])
def test_an_undefined_status_is_an_error(
    hostile_lag: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    call: str,
    status: int,
    place: str,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("FREED", str(tmp_path / "freed"))
    if place != "sandbox":
        remember(hostile_lag)
    monkeypatch.setenv("DEED", f"{call} status {status}")
    path = tmp_path / "lags.toml"
    path.write_text(LAGS.replace("FMU", str(hostile_lag)), encoding="utf-8")
    try:
        with Master(SystemSpec.read(path), path, native=place == "native") as master:
            failure = str(master.run().failure)
    except SimulationError as error:  # in the initialisation
        failure = str(error)
    assert failure.endswith(f"{call} failed with status {status} ({STATUSES[status]}).")


def test_an_instance_is_not_called_after_a_fatal_status(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("FREED", str(tmp_path / "freed"))
    remember(hostile_lag)
    for status, is_freed in ((4, False), (-7, False), (3, True)):
        monkeypatch.setenv("DEED", f"fmi2DoStep status {status}")
        with pytest.raises(SimulationError, match=f"status {status} "):
            go(hostile_lag)
        assert (tmp_path / "freed").exists() is is_freed


def test_a_negative_status_of_saving_a_state_is_an_error(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    remember(hostile_lag)
    with FmuInstance(hostile_lag) as lag:
        lag.initialise()
        monkeypatch.setenv("DEED", "fmi2GetFMUstate status -1")
        assert isinstance(lag._instance, Instance)
        with pytest.raises(SimulationError, match=r"fmi2GetFMUstate failed with status -1 \(ille"):
            lag._instance.ask("getFMUstate")


@pytest.mark.parametrize(
    "number",
    [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.ci), signal.SIGKILL],
)
def test_signals_end_a_run_at_once(
    hostile_lag: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, number: int
) -> None:
    monkeypatch.setenv("DEED", "fmi2DoStep loop")
    system, output = tmp_path / "lags.toml", tmp_path / "lags.csv"
    system.write_text(LAGS.replace("FMU", str(hostile_lag)), encoding="utf-8")
    with started("simulate", system, "-o", output, folder=tmp_path) as process:
        parent = psutil.Process(process.pid)

        def looping() -> bool:
            with suppress(psutil.NoSuchProcess):  # other processes start and end meanwhile
                return any(
                    child.cpu_times().user > 1.5 for child in parent.children(recursive=True)
                )
            return False

        wait_for(looping, process)
        descendants = parent.children(recursive=True)
        process.send_signal(number)
        _, err = process.communicate(timeout=HANG)  # the loop has no end
        if number == signal.SIGKILL:
            assert process.returncode == -number
        else:
            assert process.returncode == 128 + number
            assert err.endswith("no file is half-written.\n")
            assert not list((tmp_path / "tmp").iterdir())
        assert psutil.wait_procs(descendants, timeout=HANG)[1] == []
    assert not output.exists()


def test_commands_report_a_crash_in_one_sentence(
    hostile_friction: Path,
    hostile_lag: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    hesr: Hesr,
) -> None:
    monkeypatch.setenv("DEED", "fmi2DoStep exit")
    system = tmp_path / "lags.toml"
    system.write_text(LAGS.replace("FMU", str(hostile_lag)), encoding="utf-8")
    answer = tmp_path / "answer.json"
    for command in (
        ("simulate", system, "-o", answer.with_suffix(".csv")),
        ("check", hostile_friction, "--kind", "convention", "--json", answer),
    ):
        ended = hesr(*command)
        assert ended.code == 2, (command, ended)
        name = command[1].name.replace("lags.toml", "Lag.fmu")
        last = ended.err.splitlines()[-1]
        assert re.search(rf"{name} .* fmi2DoStep ended its process with exit code 0", last), ended
        assert "Traceback" not in ended.err
        assert not answer.exists()
    # The physics checks state for each experiment whether it could be run.
    ended = hesr("test", hostile_friction, "--kind", "properties", "--verbose")
    assert ended.code == 0
    assert all(" INFO " in line for line in ended.err.splitlines()), ended.err
    assert "fmi2DoStep ended its process with exit code 0" in " ".join(ended.out.split())


def test_non_finite_outputs_are_reported(
    hostile_friction: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fmu_src.friction.convention import measure
    from fmu_src.friction.replay import replay

    monkeypatch.setenv("DEED", "fmi2GetReal nan")
    t = 0.005 * np.arange(5)
    with pytest.raises(SimulationError) as caught:
        replay(hostile_friction, t + 1.0, np.ones((5, 3)))
    assert "t = 1 s tau[1] is not" in str(caught.value)
    with pytest.raises(SimulationError, match=r"t = 0 s tau\[1\] is not"):
        measure(hostile_friction)


def test_a_marker_that_anyone_can_make_trusts_nothing(
    lag_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the plain hash of earlier versions, nor a marker of another user or FMU counts."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    foreign = archived({"a": b"b"}, tmp_path / "Foreign.fmu")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "attacker"))
    remember(lag_fmu)
    assert is_trusted(lag_fmu)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "victim"))
    (hash_folder() / sha256(lag_fmu)).touch(0o600)
    assert not is_trusted(lag_fmu)
    remember(lag_fmu)
    assert is_trusted(lag_fmu)
    assert not is_trusted(foreign)
    changed = bytearray(lag_fmu.read_bytes())
    changed[-1] ^= 1
    (tmp_path / "Changed.fmu").write_bytes(changed)
    assert not is_trusted(tmp_path / "Changed.fmu")


def test_unwritable_hashes_leave_an_fmu_foreign(
    lag_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An FMU whose hash cannot be stored still runs, as a foreign one."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert not is_trusted(lag_fmu)
    hash_folder().write_text("a file where the folder should be")
    remember(lag_fmu)
    assert not is_trusted(lag_fmu)
    with FmuInstance(lag_fmu) as lag:
        lag.initialise(start={"x_start": 0.5})
        assert lag.get(["y"]) == [0.5]
    hash_folder().unlink()
    remember(lag_fmu)
    assert is_trusted(lag_fmu)


def test_trust_is_persistent(
    foreign_lag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hesr: Hesr
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    system = tmp_path / "lags.toml"
    system.write_text(LAGS.replace("FMU", str(foreign_lag)), encoding="utf-8")
    outputs = []
    for option in ((), ("--trust",), ()):
        known = is_trusted(foreign_lag)
        outputs.append(tmp_path / f"{len(outputs)}.csv")
        assert hesr("simulate", system, "-o", outputs[-1], *option).code == 0
        assert known == (len(outputs) == 3)
    assert is_trusted(foreign_lag)
    assert len({output.read_bytes() for output in outputs}) == 1


def test_old_hashes_are_forgotten(
    lag_fmu: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("fmu_src.run.trust._MAX_HASHES", 10)
    remember(lag_fmu)
    place = hash_folder()
    for k in range(10):
        (place / f"{k:064x}").touch()
        os.utime(place / f"{k:064x}", (k, k))
    remember(lag_fmu)
    assert len(list(place.iterdir())) == 6
    assert is_trusted(lag_fmu)


def test_limits_are_those_of_the_page() -> None:
    page = Path(__file__).parents[2].joinpath("docs/security.md").read_text(encoding="utf-8")
    limits = (
        f"{child.MAX_MEMORY_BYTES >> 30} GiB of address space beyond Python's own",
        f"{child_main.MAX_FILE_BYTES >> 30} GiB per file",
        f"{child_main.MAX_OPEN_FILES} open files",
    )
    assert ", ".join(limits) in page
