"""A failing call of the system, or a kill there, leaves the old result or the new one."""

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from small_study import Run, contents, uf850

from hesr_model.support.compiler import compile_c
from hesr_model.support.result_folder import LIST, folder_written_whole

HERE = Path(__file__).parent

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(sys.platform != "linux", reason="libraries are preloaded on Linux"),
]

CODES = (errno.EIO, errno.ENOSPC, errno.EACCES, 0)  # 0 kills
KINDS = ("rename", "fsync", "open", "mkdir", "unlink", "write", "link")
RECORDED = ("run.json", "verdict.json", "laws/*.json", "fmus/stribeck.fmu", "findings.json")
COMMANDS = ("run", "export", "fit", "identify")


class Fault(NamedTuple):
    """A call by its number, and the error it returns."""

    point: int
    code: int


@dataclass(frozen=True)
class Server:
    """Process that runs commands with faults."""

    process: "subprocess.Popen[str]"
    folder: Path

    def ask(self, command: tuple[str, ...], fault: Fault, *, record: str = "") -> tuple[int, str]:
        """Run a command; return its exit code and what it prints on standard error."""
        errors = self.folder / "errors"
        request = {
            "command": command,
            "point": fault.point,
            "code": fault.code,
            "record": record,
            "watched": str(self.folder / "watched"),
            "folder": str(self.folder / "watched"),
            "output": str(self.folder / "output"),
            "errors": str(errors),
        }
        assert self.process.stdin
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        return int(self.answer()), errors.read_text(encoding="utf-8")

    def answer(self) -> Any:
        assert self.process.stdout
        return json.loads(self.process.stdout.readline())


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("faults")
    shutil.copyfile(HERE / "faulty_calls.c", folder / "faulty_calls.c")
    library = folder / "faulty_calls.so"
    compile_c(folder / "faulty_calls.c", ("-shared", "-fPIC", "-O1"), library)
    for name in ("tmp", "cache", "config"):
        (folder / "watched" / name).mkdir(parents=True)
    environment = {
        "LD_PRELOAD": str(library),
        "TMPDIR": str(folder / "watched" / "tmp"),
        "XDG_CACHE_HOME": str(folder / "watched" / "cache"),
        "XDG_CONFIG_HOME": os.environ.get("XDG_CONFIG_HOME", str(Path.home() / ".config")),
        "SOURCE_DATE_EPOCH": "1700000000",
        "OMP_NUM_THREADS": "1",
    }
    with subprocess.Popen(
        [sys.executable, HERE / "fault_server.py", library],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    ) as process:
        new_server = Server(process, folder)
        assert new_server.answer() == "ready"
        yield new_server
        assert process.stdin
        process.stdin.close()


@dataclass(frozen=True)
class Case:
    """A command with a way to lay its old result, and what it leaves without a fault."""

    command: tuple[str, ...]
    output: Path
    lay_old: Callable[[], None]
    old: dict[str, bytes]
    new: dict[str, bytes]
    calls: list[str]

    def read(self) -> dict[str, bytes]:
        """Return what is at the output; the signed list by its first letter only."""
        return read_output(self.output)


def read_output(output: Path) -> dict[str, bytes]:
    if output.is_dir():
        return {name: data for name, data in contents(output).items() if name != LIST}
    return {"": output.read_bytes()} if output.exists() else {}


@pytest.fixture
def case(request: pytest.FixtureRequest, server: Server, study_run: Run) -> Case:
    watched = server.folder / "watched"
    robot = ("--robot", str(uf850("robot.toml")))
    output = watched / request.param
    command: tuple[str, ...]
    if request.param == "run":
        recorded = server.folder / "recorded"
        record_run(study_run, recorded)
        command = ("replay", str(recorded), str(output))
    elif request.param == "export":
        output = watched / "Friction.fmu"
        command = ("export", "uf850-table1", "-o", str(output))
    elif request.param == "fit":
        known = ("--rigid-body", str(study_run.rigid_body))
        law = ("--law", "coulomb_viscous", "-o", str(output))
        command = ("fit", str(study_run.log("sweep")), *robot, *known, *law)
    else:
        command = ("identify", str(study_run.log("excitation")), *robot, "-o", str(output))

    def lay_old() -> None:
        shutil.rmtree(output, ignore_errors=True)
        output.unlink(missing_ok=True)
        for leftover in watched.glob(".hesr-*"):
            if leftover.is_dir():
                shutil.rmtree(leftover)
            else:  # the lock of a killed run
                leftover.unlink()
        shutil.rmtree(watched / "tmp")
        (watched / "tmp").mkdir()
        if request.param != "run":
            output.write_bytes(b"old")
            return
        with folder_written_whole(output) as folder:
            for name in ("run.json", "laws/dahl.json"):
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_text("old", encoding="utf-8")
        (output / "notes.txt").write_text("mine", encoding="utf-8")

    for _ in range(2):  # the first run fills the cache
        lay_old()
        old = read_output(output)
        record = server.folder / "calls"
        code, error = server.ask(command, Fault(-1, 0), record=str(record))
        assert (code, error) == (0, "")
    calls = [line.split()[0] for line in record.read_text(encoding="utf-8").splitlines()]
    assert not list(watched.glob(".hesr-*"))
    return Case(command, output, lay_old, old, read_output(output), calls)


def record_run(study_run: Run, recorded: Path) -> None:
    """Copy some files of a run, of each kind that it writes."""
    for pattern in RECORDED:
        for file in study_run.results.glob(pattern):
            target = recorded / file.relative_to(study_run.results)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file, target)


def judge_fault(server: Server, case: Case, fault: Fault) -> tuple[int, str]:
    """Return the exit code after a fault, and what is wrong with the rest that it leaves."""
    case.lay_old()
    code, error = server.ask(case.command, fault)
    left = case.read()
    expected_codes = (-9,) if fault.code == 0 else (0, 2)
    is_refusal = error.startswith("hesr: ") and len(error.splitlines()) == 1
    wrong = ""
    if left not in (case.old, case.new):
        wrong = f"a mixture of {sorted(left)}"
    elif code not in expected_codes:
        wrong = f"exit code {code}"
    elif code == 0 and left != case.new:  # a scratch folder that cannot be removed may stay
        wrong = "no new result"
    elif code == 2 and not is_refusal:
        wrong = "no sentence"
    elif code == 2 and list((server.folder / "watched").glob(".hesr-*")):
        wrong = "leftovers"
    call = case.calls[fault.point]
    return code, f"{wrong} after {fault} at {call}: {error}" if wrong else ""


def judge_recovery(server: Server, case: Case) -> str:
    """Return what is wrong after the next run, which removes all leftovers of a killed one."""
    watched = server.folder / "watched"
    code, error = server.ask(case.command, Fault(-1, 0))
    leftovers = [*watched.glob(".hesr-*"), *watched.glob("tmp/hesr-*")]
    if code or error or leftovers or case.read() != case.new:
        return f"exit code {code}, {error!r}, {[path.name for path in leftovers]}"
    return ""


@pytest.mark.parametrize("case", COMMANDS, indirect=True)
def test_a_fault_leaves_the_old_result_or_the_new_one(case: Case, server: Server) -> None:
    """Twenty points; commands that compute for long have the last renaming and the last writing."""
    points = [last_call(case, "rename"), last_call(case, "write")]
    if case.command[0] in ("replay", "export"):
        points = [case.calls.index(kind) for kind in KINDS if kind in case.calls] + points
    faults = [Fault(point, CODES[k % len(CODES)]) for k, point in enumerate(points)]
    answers = [judge_fault(server, case, fault) for fault in (*faults, Fault(points[-1], 0))]
    assert [wrong for _, wrong in answers if wrong] == []
    assert judge_recovery(server, case) == ""


def last_call(case: Case, kind: str) -> int:
    return len(case.calls) - 1 - case.calls[::-1].index(kind)


@pytest.mark.nightly("hostile")
@pytest.mark.timeout(0)
@pytest.mark.parametrize("case", COMMANDS, indirect=True)
def test_every_fault_leaves_the_old_result_or_the_new_one(case: Case, server: Server) -> None:
    answers = []
    for point in range(len(case.calls)):
        answers += [judge_fault(server, case, Fault(point, code)) for code in CODES]
        answers.append((0, judge_recovery(server, case)))
    assert [wrong for _, wrong in answers if wrong] == []
    assert {0, 2, -9} <= {code for code, _ in answers}
