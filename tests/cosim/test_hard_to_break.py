"""Real killed runs, concurrent runs, plain outputs and hostile files."""

import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from containing import Containing, OneSentence
from processes import COMMAND, assert_nothing_runs, started, wait_for
from small_study import Hesr, contents, hesr_here, uf850, write_study

from cosim.loop.excite import load_arm, record
from fmu_src.arm.plant import Plant
from hesr_model.errors import ArtifactError, ConfigError
from hesr_model.motions.trajectories import Sine
from hesr_model.support.files import sweep_folder
from hesr_model.support.result_folder import LIST, folder_written_whole

SECONDS = 0.01


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


Refused = Callable[..., str]


@pytest.fixture
def refused(hesr: Hesr) -> Refused:
    """Run a command that must be refused; return its sentence."""

    def call(*arguments: object) -> str:
        answer = hesr(*arguments)
        assert answer.code == 2, answer
        assert answer.out == ""
        assert len(answer.err.splitlines()) == 1
        return answer.err.removeprefix("hesr: ")

    return call


# --- killed and concurrent runs ----------------------------------------------------------------

SLEEPER = """
import sys, time
from pathlib import Path
from hesr_model.support.result_folder import folder_written_whole

with folder_written_whole(Path(sys.argv[1])) as folder:
    (folder / "half").write_text("half")
    time.sleep(600)
"""


def find_new_folders(results: Path) -> set[Path]:
    """Return the folders of unfinished results."""
    return set(results.parent.glob(f".hesr-*/files/{results.name}"))


def test_the_next_run_removes_files_of_a_killed_run(tmp_path: Path) -> None:
    results = tmp_path / "results"
    program = ("-c", SLEEPER)
    with started(results, folder=tmp_path, program=program) as process:
        wait_for(lambda: list(tmp_path.glob(".hesr-*/files/results/half")), process)
        # That process is alive, so its files are left alone.
        with (
            pytest.raises(ArtifactError, match="another run is writing here"),
            folder_written_whole(results),
        ):
            raise AssertionError
        (left,) = find_new_folders(results)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert left.is_dir()
    sweep_folder.cache_clear()  # it is done once per process
    with folder_written_whole(results) as folder:
        assert find_new_folders(results) == {folder}
        assert folder != left
        (folder / "whole").write_text("whole")
    assert contents(results, without=[LIST]) == {"whole": b"whole"}
    assert {path.name for path in tmp_path.iterdir()} == {"results", "tmp"}


@pytest.mark.ci
def test_a_second_run_into_the_same_folder_is_refused(tmp_path: Path) -> None:
    study, results = write_study(tmp_path), tmp_path / "results"
    with started("run", study, "-o", results, folder=tmp_path) as first:
        wait_for(lambda: find_new_folders(results), first)
        with started("run", study, "-o", results, folder=tmp_path) as second:
            out, err = second.communicate(timeout=120)
        assert second.returncode == 2
        assert (out, err) == (
            "",
            Containing(f"hesr: {results}: another run is writing"),
        )
        assert first.poll() is None
        assert find_new_folders(results)
        first.send_signal(signal.SIGKILL)
        first.communicate()
    assert_nothing_runs(first.pid)
    # A run first removes the files of the killed one.
    with started("run", study, "-o", results, folder=tmp_path) as third:
        left = find_new_folders(results)
        wait_for(lambda: not left & find_new_folders(results), third)


def test_reading_a_received_folder_moves_nothing(refused: Refused, tmp_path: Path) -> None:
    """Earlier versions completed what they took for a result of a killed run, through links."""
    results, home = tmp_path / "received", tmp_path / "home"
    planted = results / ".hesr-whole"
    for folder in (planted / "notes", planted / "laws", home):
        folder.mkdir(parents=True)
    (home / ".bashrc").write_text("mine", encoding="utf-8")
    for name in ("notes/.bashrc", "laws/.bashrc", "run.json"):
        (planted / name).write_text("planted", encoding="utf-8")
    (results / "notes").symlink_to(home)
    (results / "laws").symlink_to(home)
    before = contents(tmp_path)
    for command in ("report", "export"):
        more = ("--format", "loop", "-o", tmp_path / "loop") if command == "export" else ()
        refused(command, results, *more)
    refused("report", results, "-o", tmp_path / "digest.md")
    assert contents(tmp_path) == before


# --- outputs with a limited character set -------------------------------------------------------


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_marks_are_plain_for_a_plain_output(encoding: str) -> None:
    result = subprocess.run(
        [sys.executable, *COMMAND, "test", "uf850-table1", "--kind", "properties", "--verbose"],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONIOENCODING": encoding, "COLUMNS": "160"},
    )
    assert result.returncode == 0
    assert all(b" INFO " in line for line in result.stderr.splitlines())
    text = result.stdout.decode(encoding)
    assert "+ pass, x fail" in text
    assert "?" not in text.partition("x fail")[0]


# --- unwritable home ---------------------------------------------------------------------------

DRAWING = """
from hesr.cli import main
try:
    main()
finally:
    import matplotlib
    print(matplotlib.get_configdir())
"""


def test_other_packages_are_quiet_without_a_home(tmp_path: Path) -> None:
    env = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "MPLCONFIGDIR"))}
    result = subprocess.run(
        [sys.executable, "-c", DRAWING, "fit", "--list", "--quiet"],
        capture_output=True,
        text=True,
        check=False,
        env=env | {"HOME": "/dev/null", "TMPDIR": str(tmp_path)},
    )
    assert (result.returncode, result.stderr) == (0, "")
    place = Path(result.stdout.splitlines()[-1])
    assert place == tmp_path / f"hesr-cache-{os.getuid()}" / "matplotlib"
    assert place.is_dir()


# --- hostile files ----------------------------------------------------------------------------


@pytest.fixture(params=["pipe", "endless", "round"])
def odd(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[str], Path]:
    """A path that blocks on opening, an endless file and a link to itself, under a given name."""

    def make(name: str) -> Path:
        path = tmp_path / name
        if request.param == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to("/dev/zero" if request.param == "endless" else path)
        return path

    return make


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices in folders are those of POSIX")
def test_paths_other_than_regular_files_are_refused(
    odd: Callable[[str], Path], refused: Refused, tmp_path: Path
) -> None:
    robot, output = robot_file(tmp_path), tmp_path / "out.csv"
    for name in ("log.csv", "log.parquet", "log.mat", "log.bag", "log.mcap"):
        log = odd(name)
        assert refused("identify", log, "--robot", robot, "-o", output).startswith(f"{log}: ")
    for name, command, to in (
        ("law.json", "export", "out.fmu"),
        ("model.xml", "export", "out.fmu"),
        ("system.toml", "simulate", "out.csv"),
        ("loop.ssp", "simulate", "out.csv"),
        ("study.toml", "run", "out.csv"),
        ("sweep.toml", "simulate", "out.csv"),
    ):
        file = odd(name)
        sentence = refused(command, file, "-o", tmp_path / to)
        assert sentence.startswith(f"{file}: "), command
    system = tmp_path / "lags.toml"
    text = 'name = "s"\nstep = 0.1\nstop = 1.0\nobserve = ["a.y"]\n[[components]]\nname = "a"\n'
    system.write_text(f'{text}fmu = "{odd("Lag.fmu").name}"\n', encoding="utf-8")
    refused("simulate", system, "-o", output)
    assert not list(tmp_path.glob("out.*"))


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        (
            '<replicate count="100000000"><geom size="1"/></replicate>',
            "elements; at most 15000 can be compiled",
        ),
        (
            '<body><geom type="mesh" mesh="odd"/></body>',
            "names the file 'odd.stl'",
        ),
        ('<geom type="hfield" hfield="huge"/>', "cannot be compiled as an MJCF"),
    ],
)
def test_oversized_models_are_refused(
    more: str, reason: str, refused: Refused, tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "odd.stl")
    path, asset = tmp_path / "model.xml", '<mesh name="odd" file="odd.stl"/>' * ("mesh" in more)
    if "hfield" in more:  # MuJoCo detects this error itself
        asset = '<hfield name="huge" nrow="-1" ncol="100000" size="1 1 1 1"/>'
    path.write_text(
        f"<mujoco><asset>{asset}</asset><worldbody>{more}</worldbody></mujoco>", encoding="utf-8"
    )
    assert reason in refused("export", path, "-o", tmp_path / "Arm.fmu")


def test_file_names_stay_on_one_line(refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "a\n\x1b[2Jb.toml"
    sentence = refused("simulate", path, "-o", tmp_path / "out.csv")
    assert sentence == f"{tmp_path}/a\\n\\x1b[2Jb.toml: no such file.\n"
    sentence = refused("simulate", tmp_path / ("n" * 5000), "-o", tmp_path / "out.csv")
    assert len(sentence) < 5000


DEEP = 100_000


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[" * DEEP, "nested too deeply"),
        ('{"a":' * DEEP, "nested too deeply"),
        ('{"format": ' + "9" * 400 + "}", "it holds an integer of 400 digits"),
        ('{"format": ' + "9" * 5000 + "}", "it holds an integer of 5000 digits"),
        ('{"format": "\ud800"}', "codec can't decode byte 0xed"),
    ],
)
def test_hostile_json_is_refused(text: str, reason: str, refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    sentence = refused("export", path, "-o", tmp_path / "Friction.fmu")
    assert sentence.startswith(f"{path}: not a readable JSON file (")
    assert reason in sentence


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (f"laws = {'[' * DEEP}", "not valid TOML (it is nested too deeply)"),
        (f"laws = {'{a=' * DEEP}", "not valid TOML (it is nested too deeply)"),
        (f"{'a.' * DEEP}a = 1", "nested too deeply"),
        (f"seed = {'9' * 400}", "integer of more than 300"),
        (f"seed = {'9' * 5000}", "not valid TOML ("),
        (f"name = '{'x' * 100_000}'\nlaws = 3", "keys 'robot' and 'logs'"),
    ],
)
def test_hostile_toml_is_refused(text: str, reason: str, refused: Refused, tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    sentence = refused("run", path, "-o", tmp_path / "results")
    assert sentence.startswith(f"{path}: ")
    assert reason in sentence
    assert len(sentence) < 2100


@pytest.mark.parametrize(
    ("step", "stop", "reason"),
    [
        (1e-300, 1.0, "1e+300 communication steps of 1e-300 s"),
        (1e-3, 1e308, "inf communication steps of 0.001 s"),
        (5e-324, 1e308, "inf communication steps of"),
        (5e-324, -1e308, "must be a multiple"),
    ],
)
def test_too_many_steps_are_refused(
    step: float, stop: float, reason: str, refused: Refused, tmp_path: Path
) -> None:
    path = tmp_path / "system.toml"
    system = f'step = {step}\nstop = {stop}\n[[components]]\nname = "a"\nfmu = "a.fmu"\n'
    path.write_text(system, encoding="utf-8")
    assert reason in refused("simulate", path, "-o", tmp_path / "out.csv")


def robot_file(folder: Path, *, model: str = "", joint: str = "joint1") -> Path:
    path = folder / "robot.toml"
    model = model or str(uf850("uf850.xml"))
    path.write_text(f'name = "r"\nmodel = "{model}"\njoints = ["{joint}"]\n', encoding="utf-8")
    return path


def identify(log: Path, robot: Path) -> tuple[object, ...]:
    return ("identify", log, "--robot", robot, "-o", log.with_name("body.json"))


def columns(**changed: object) -> dict[str, object]:
    t = SECONDS * np.arange(500)
    return {"t": t, "q1": np.sin(t), "dq1": np.cos(t), "tau1": np.cos(t)} | changed


def test_invalid_time_stamps_are_refused(refused: Refused, tmp_path: Path) -> None:
    """Nanoseconds beyond the range of Python's dates, and a date as a position."""
    stamps = pyarrow.array(np.arange(500) + 1, pyarrow.timestamp("ns", tz="Nowhere/Never"))
    log = tmp_path / "log.parquet"
    for changed in ({"q1": stamps}, {"q1": pyarrow.array([{"a": 1.0}] * 500)}):
        pyarrow.parquet.write_table(pyarrow.table(columns(**changed)), log)
        assert "column 'q1'" in refused(*identify(log, robot_file(tmp_path)))
    pyarrow.parquet.write_table(pyarrow.table(columns(q1=stamps)), log)
    assert "row 1: '1970-01-01T00:00:00.000000001' where a number is needed." in refused(
        *identify(log, robot_file(tmp_path))
    )


@pytest.mark.parametrize("name", ["q1", "dq1", "tau1"])
@pytest.mark.parametrize("number", [1e300, -1.7e308])
def test_unusable_numbers_are_refused(
    name: str, number: float, refused: Refused, tmp_path: Path
) -> None:
    values = np.array(columns()[name])
    values[7] = number
    log = tmp_path / "log.csv"
    table = columns(**{name: values})
    np.savetxt(
        log,
        np.column_stack(list(table.values())),
        delimiter=",",
        header=",".join(table),
        comments="",
    )
    sentence = refused(*identify(log, robot_file(tmp_path)))
    assert sentence.startswith(f"{log}: row 9: ")
    assert f"{number:g}; numbers up to 1e+20 can" in sentence


def test_unusable_times_are_refused(refused: Refused, tmp_path: Path) -> None:
    log = tmp_path / "log.parquet"
    pyarrow.parquet.write_table(pyarrow.table(columns(t=1e300 * np.arange(500))), log)
    sentence = refused(*identify(log, robot_file(tmp_path)))
    assert "row 2: the time is 1e+300" in sentence


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_200_000_columns_are_handled_quickly(suffix: str, refused: Refused, tmp_path: Path) -> None:
    log = tmp_path / f"log{suffix}"
    names = [f"c{k}" for k in range(200_000)]
    if suffix == ".csv":
        row = ",".join(["1.5"] * len(names))
        log.write_text(f"{','.join(names)}\n{row}\n{row}\n", encoding="utf-8")
    else:
        few = names[:20_000]  # writing even these takes seconds
        pyarrow.parquet.write_table(pyarrow.table({name: [1.5] for name in few}), log)
        names = few
    assert refused(*identify(log, robot_file(tmp_path))) == (
        f"{log}: has {len(names)} columns; at most 10000 are allowed.\n"
    )


def test_messages_list_only_some_of_many_columns(refused: Refused, tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text(",".join(f"c{k}" for k in range(5000)) + "\n", encoding="utf-8")
    with log.open("a", encoding="utf-8") as file:
        file.write("\n".join([",".join(["1"] * 5000)] * 3) + "\n")
    sentence = refused(*identify(log, robot_file(tmp_path)))
    assert sentence.endswith(
        ": column 't' is missing; it has "
        + ", ".join(f"c{k}" for k in range(30))
        + ", and 4970 more.\n"
    )


MEASURED = """
import re, sys
from pathlib import Path
from hesr.cli import main
try:
    main()
finally:
    # Not ru_maxrss, which begins with what the process that starts this one takes.
    status = Path("/proc/self/status").read_text()
    print(re.search(r"VmHWM:\\s+(\\d+) kB", status)[1], file=sys.stderr)
"""


def sparse(path: Path, head: bytes) -> Path:
    with path.open("wb") as file:
        file.write(head)
        file.truncate(10 * 10**9)
    return path


@pytest.mark.parametrize(
    ("name", "head"),
    [
        ("log.csv", b""),
        ("log.csv", b"t;q1;dq1;tau1\n0;0,1;0;0\n"),
        ("log.mat", b""),
        ("log.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"),
        ("log.parquet", b"PAR1"),
        ("log.feather", b"ARROW1"),
        ("log.h5", b"\x89HDF\r\n\x1a\n"),
        ("log.npy", b"\x93NUMPY"),
        ("log.npz", b"PK\x03\x04"),
        ("log.xlsx", b"PK\x03\x04"),
        ("log.csv.gz", b"\x1f\x8b\x08"),
        ("law.json", b"{"),
        ("robot.toml", b"name = 'r'"),
    ],
)
def test_10_gb_of_zeros_take_no_memory(name: str, head: bytes, tmp_path: Path) -> None:
    path = sparse(tmp_path / name, head)
    if path.suffix == ".json":
        arguments: tuple[object, ...] = ("export", path, "-o", tmp_path / "Friction.fmu")
    elif path.suffix == ".toml":
        arguments = identify(tmp_path / "log.csv", path)
    else:
        arguments = identify(path, robot_file(tmp_path))
    with started(*arguments, folder=tmp_path, program=("-c", MEASURED)) as process:
        _, err = process.communicate(timeout=120)
    assert process.returncode == 2, err
    sentence, memory = err.splitlines()
    assert sentence.startswith(f"hesr: {path}: ")
    if path.suffix == ".gz":
        assert "is 10.0 GB long" in sentence
    elif path.suffix == ".csv":  # read line by line, up to zeros that a logger did not write
        assert ("has 1 rows of data" if head else "cannot be read as CSV text.") in sentence
    assert int(memory) < 500_000  # kB; the imports of the command take 230 MB


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (1100 * 2**20, 1100 * 2**20))


def test_insufficient_memory_is_one_sentence(tmp_path: Path) -> None:
    """A law of 60 MB of JSON in a process limited to 1,100 MB."""
    path = tmp_path / "law.json"
    path.write_text("[" + ",".join(["[1.5]"] * 10_000_000) + "]", encoding="utf-8")
    result = subprocess.run(
        [sys.executable, *COMMAND, "export", str(path), "-o", str(tmp_path / "Friction.fmu")],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limited,
    )
    assert (result.returncode, result.stderr) == (
        2,
        Containing("hesr: not enough memory"),
    )


@pytest.mark.parametrize("encoding", ["klingon", "utf-7", "idna"])
def test_unknown_encodings_are_refused(encoding: str, refused: Refused, tmp_path: Path) -> None:
    text = uf850("uf850.xml").read_text(encoding="utf-8")
    model = tmp_path / "model.xml"
    model.write_text(f'<?xml version="1.0" encoding="{encoding}"?>\n{text}', encoding="utf-8")
    pyarrow.parquet.write_table(pyarrow.table(columns()), tmp_path / "log.parquet")
    arguments = identify(tmp_path / "log.parquet", robot_file(tmp_path, model=str(model)))
    assert refused(*arguments).startswith(f"{model}: cannot be parsed as an MJCF (")


@pytest.mark.parametrize("letter", ["\\u0000", "\\u0007", "\\u202e"])
def test_unprintable_names_are_refused(letter: str, refused: Refused, tmp_path: Path) -> None:
    robot = robot_file(tmp_path, joint=f"joint{letter}1")
    assert "which cannot be printed" in refused(*identify(tmp_path / "log.csv", robot))
    data = json.loads(uf850("table1.json").read_text(encoding="utf-8"))
    data["joints"][0]["joint"] = json.loads(f'"joint{letter}1"')
    law = tmp_path / "law.json"
    law.write_text(json.dumps(data), encoding="utf-8")
    sentence = refused("export", law, "-o", tmp_path / "Friction.fmu")
    assert sentence.startswith(f"{law}: ")
    assert "which cannot be printed" in sentence


@pytest.mark.parametrize("number", [1e308, -1e101])
def test_absurd_coefficients_of_a_law_are_refused(
    number: float, refused: Refused, tmp_path: Path
) -> None:
    data = json.loads(uf850("table1.json").read_text(encoding="utf-8"))
    for change in ("start", "coefficient"):
        changed = json.loads(json.dumps(data))
        if change == "start":
            changed["joints"][0]["start"] = [number]
        else:
            next(iter(changed["joints"][0]["coefficients"].values()))["value"] = number
        law = tmp_path / "law.json"
        law.write_text(json.dumps(changed), encoding="utf-8")
        sentence = refused("export", law, "-o", tmp_path / "Friction.fmu")
        assert f"{number:g}; numbers up to 1e+100 can" in sentence
        assert not (tmp_path / "Friction.fmu").exists()


def test_decompression_bombs_as_logs_are_refused(refused: Refused, tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py is not installed")
    robot = robot_file(tmp_path)
    log = tmp_path / "log.parquet"
    zeros = np.zeros(4_200_000)
    table = pyarrow.table({f"c{k}": zeros for k in range(10)})
    pyarrow.parquet.write_table(table, log)
    assert "more than fits into the file" in refused(*identify(log, robot))
    log = tmp_path / "log.mat"
    with h5py.File(log, "w", userblock_size=512) as file:
        file.create_dataset("t", (10**9,), dtype=np.float64)
    sentence = refused(*identify(log, robot))
    assert "claims more data than fits into" in sentence


def test_an_endless_motion_is_refused() -> None:
    plant = Plant.read(uf850("plant.toml"))
    slow = Sine(offset=np.zeros(3), amplitude=np.ones(3), frequency=1e-300, periods=1)
    sentence = r"2e\+302 samples; at most 1e\+08 can be logged"
    with load_arm(plant) as arm, pytest.raises(ConfigError, match=sentence):
        record(arm, slow, 1, name="slow")


# --- environments -----------------------------------------------------------------------------

ENVIRONMENTS = {
    "date": (
        {"SOURCE_DATE_EPOCH": "x"},
        "",
        "'x'; expected whole seconds since 1970",
    ),
    "negative date": (
        {"SOURCE_DATE_EPOCH": "-1"},
        "",
        "'-1'; expected whole seconds since 1970",
    ),
    "memory": (
        {},
        "ulimit -v 300000",
        "memory is 307 MB; at least 1073",
    ),
    "files": (
        {},
        "ulimit -n 16",
        "files is 16; at least 64",
    ),
    "locale": ({"LC_ALL": "xx_XX", "LANG": "zz"}, "", ""),
}


@pytest.mark.parametrize("name", ENVIRONMENTS)
@pytest.mark.parametrize("command", ["export", "report"])
def test_odd_environments_are_named(tmp_path: Path, name: str, command: str) -> None:
    variables, limit, sentence = ENVIRONMENTS[name]
    output = tmp_path / "x.fmu"
    verb = f"export uf850-table1 -o {output}" if command == "export" else f"report {tmp_path}"
    result = subprocess.run(
        ["sh", "-c", f'{limit or ":"}; exec {sys.executable} {COMMAND[0]} "{COMMAND[1]}" {verb}'],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=os.environ | variables,
    )
    if sentence:
        assert (result.returncode, result.stderr) == (2, OneSentence("hesr: ", sentence))
        assert not output.exists()
    elif command == "export":
        assert result.returncode == 0, result.stderr
        assert output.exists()
    else:
        assert "no results of 'hesr run'" in result.stderr
