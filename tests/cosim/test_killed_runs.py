"""Runs killed at any time leave the whole old result or the whole new one."""

import hashlib
import json
import math
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import psutil
import pytest
from processes import assert_nothing_runs, started, wait_for
from small_study import contents, write_study

from fmu_src import model_file
from hesr_model.logs.signals import Motion
from hesr_model.logs.tables import write_table
from hesr_model.support.files import models_folder, written_together, written_whole
from hesr_model.support.open_folder import OpenFolder
from hesr_model.support.result_folder import LIST, hash_files, write_list

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")

FILES = 60
KILLS = int(os.environ.get("KILLS", "200"))  # in the soak test

WRITER = f"""
import os, sys
from itertools import count
from pathlib import Path
from hesr_model.support.result_folder import folder_written_whole

for version in count():
    with folder_written_whole(Path(sys.argv[1])) as folder:
        for k in range({FILES}):
            (folder / str(k % 7)).mkdir(exist_ok=True)
            (folder / str(k % 7) / str(k)).write_text(f"{{os.getpid()}} {{version}}")
"""


def begins_with(file: Path, text: str) -> bool:
    return file.exists() and file.read_text().startswith(text)


def assert_one_version(results: Path) -> None:
    """Check that a kill leaves all files of one version, without any repair."""
    found = contents(results)
    assert len(found.pop(LIST)) > FILES
    assert len(found) == FILES
    assert len(set(found.values())) == 1


@pytest.mark.ci
def test_a_kill_at_any_time_leaves_one_version(tmp_path: Path) -> None:
    results, rng = tmp_path / "results", random.Random(5)
    first = results / "0" / "0"
    for _ in range(6):
        with started(results, folder=tmp_path, program=("-c", WRITER)) as process:
            wait_for(partial(begins_with, first, str(process.pid)), process)
            time.sleep(0.05 * rng.random())
            process.send_signal(signal.SIGKILL)
            process.communicate()
        assert_one_version(results)


def test_files_that_belong_together_are_written_together(tmp_path: Path) -> None:
    names = [tmp_path / name for name in ("main", "a", "b")]
    for text in ("old", "new"):
        with written_together(names[0]) as file:
            for name in (names[1], names[0], names[2], names[1]):
                file(name).write_text(f"{text} {name.name}")
        assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
            name.name: f"{text} {name.name}" for name in names
        }
    with pytest.raises(ZeroDivisionError), written_together(names[0]) as file:  # noqa: PT012
        file(names[1]).write_text("newer")
        raise ZeroDivisionError
    assert sorted(path.read_text() for path in tmp_path.iterdir()) == ["new a", "new b", "new main"]


HALF = """
import os, signal, sys
from pathlib import Path
from hesr_model.support.files import scratch_folder, written_whole

with scratch_folder(), written_whole(Path(sys.argv[1])) as file:
    file.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_files_of_killed_processes_are_removed_and_others_are_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / ".other.abcdefgh").write_text("of the user")
    path = tmp_path / "figure.png"
    with started(path, folder=tmp_path, program=("-c", HALF)) as process:
        process.communicate()
    assert len(list(tmp_path.glob(".hesr-*/files/figure.png"))) == 1
    (left,) = (tmp_path / "tmp").iterdir()
    shutil.rmtree(left / "files")  # as a kill during its removal leaves it
    with written_whole(path) as alive:
        more = "import sys; sys.argv[1:] = ['b.txt']\n" + HALF.replace("    os.kill", "    print")
        with started(folder=tmp_path, program=("-c", more)) as process:
            assert process.communicate()
            assert process.returncode == 0
        assert alive.exists()
        assert set(tmp_path.glob(".*")) == {tmp_path / ".other.abcdefgh", alive.parents[1]}
        assert not list((tmp_path / "tmp").iterdir())
        alive.write_text("whole")
    assert path.read_text() == "whole"


OF_RUN = ("run.json", LIST)
"""Files of a result that list its others."""


@pytest.mark.quiet
@pytest.mark.parametrize(
    "kills",
    [
        pytest.param(2, marks=pytest.mark.ci),
        pytest.param(KILLS, marks=[pytest.mark.soak, pytest.mark.timeout(0)]),
    ],
)
def test_a_killed_run_leaves_the_old_result_or_the_new_one(tmp_path: Path, kills: int) -> None:
    """A third of the kills are in the last tenth of CPU time; each tenth run is resumed."""
    study, rng = write_study(tmp_path), random.Random(kills)
    results = tmp_path / "results"
    command = ("run", study, "--quick", "-o", "results")
    date = {"SOURCE_DATE_EPOCH": "1700000000"}
    with started(*command, folder=tmp_path, **date) as process:
        seconds = [used_until(process, math.inf)]  # CPU time of complete runs
        assert process.communicate()
        assert process.returncode == 0
    results.rename(tmp_path / "new")
    changed(tmp_path / "new", tmp_path / "old")
    whole = {name: hashes(tmp_path / name) for name in ("old", "new")}
    unfinished, seen = tmp_path / ".results-unfinished", set()
    k = 0
    while k < kills:
        shutil.rmtree(results, ignore_errors=True)
        shutil.copytree(tmp_path / "old", results)
        late = rng.random() < 1 / 3 or k == 1
        with started(*command, folder=tmp_path, **date) as process:
            share = 0.9 + 0.1 * rng.random() if late else rng.random()
            used = used_until(process, share * min(seconds[-5:]))
            ended = process.poll() is not None
            process.send_signal(signal.SIGKILL)
            process.communicate()
        assert_nothing_runs(process.pid)
        if ended:
            seconds.append(used)
            continue
        again = (*command,) if k % 10 == 0 else ("report", "results", "-o", "digest.md")
        with started(*again, folder=tmp_path, **date) as process:
            assert process.communicate()
            assert process.returncode == 0
        found = hashes(results)
        (name,) = (name for name, files in whole.items() if files == found)
        seen.add(name)
        assert name == "new" or again != command
        if again == command:
            assert not unfinished.exists()
        about = json.loads((results / "run.json").read_text(encoding="utf-8"))
        assert about["written"] == {n: h for n, h in found.items() if n not in OF_RUN}
        assert "report.html" in about["written"]
        assert not list((tmp_path / "tmp").iterdir())
        shutil.rmtree(unfinished, ignore_errors=True)
        k += 1
    assert "new" in seen
    if kills > 20:  # few may all come after the results are moved
        assert seen == {"old", "new"}


def changed(results: Path, other: Path) -> None:
    """Copy results that are as readable, and signed, but differ in every file."""
    shutil.copytree(results, other)
    for file in [*other.rglob("*")]:
        if file.is_file():
            file.write_bytes(file.read_bytes() + b"\n")
    about = json.loads((other / "run.json").read_text(encoding="utf-8"))
    about["written"] = {n: h for n, h in hashes(other).items() if n not in OF_RUN}
    (other / "run.json").write_text(json.dumps(about), encoding="utf-8")
    (other / LIST).unlink()
    with OpenFolder.open(other) as folder:
        write_list(folder, hash_files(folder))


def used_until(process: "subprocess.Popen[str]", seconds: float) -> float:
    """Wait for the end or that much CPU time of the process and its children; return the time.

    Other load changes the length of a run, but hardly its CPU time.
    """
    now, running = 0.0, psutil.Process(process.pid)
    while now < seconds and process.poll() is None:
        with suppress(psutil.Error):
            tree = (running, *running.children(recursive=True))
            now = max(now, sum(sum(one.cpu_times()[:4]) for one in tree))
        time.sleep(0.05)  # listing all processes also takes CPU time
    return now


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file, hidden ones included."""
    return {
        file.relative_to(folder).as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


KILLED = """
import os, signal, sys
from pathlib import Path

number, replace, *sys.argv[1:] = sys.argv[1:2], Path.replace, *sys.argv[2:]
left = [int(number[0])]

def killed(path, target):
    left[0] -= 1
    if left[0] < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return replace(path, target)

Path.replace = killed
from hesr.cli import main
main()
"""
LAW = ("export", "law.json", "--format", "c", "-o", "out/law.h")
MOTION = ("excite", "robot.toml", "--settings", "settings.toml", "-o", "out/law.csv")
READ = ("inspect", "log.csv", "--robot", "arm.xml")
INSPECT = (*READ, "--write", "out/robot.toml", "--study", "out/study.toml")


@pytest.mark.parametrize(
    "command",
    [LAW, *(pytest.param(words, marks=pytest.mark.ci) for words in (MOTION, INSPECT))],
    ids=["code", "motion", "robot and study"],
)
def test_a_killed_writer_of_several_files_leaves_no_mix(
    tmp_path: Path, command: tuple[str, ...], make_motion: Callable[..., Motion]
) -> None:
    """Its main file is absent while the others are replaced."""
    law = json.loads(model_file("uf850-table1").read_text(encoding="utf-8"))
    settings = "seed = {}\nharmonics = 2\nperiod = [4.0, 4.0]\nstarts = 1\n[limits]\n"
    settings += "velocity = [2.0, 2.0, 2.0]\ntorque = [80.0, 80.0, 80.0]\n"
    robot = models_folder() / "uf850" / "robot.toml"
    (tmp_path / "robot.toml").write_bytes(robot.read_bytes())
    (tmp_path / "uf850.xml").write_bytes(robot.with_name("uf850.xml").read_bytes())
    out, versions = tmp_path / "out", []
    for seed in (1, 2):
        law["joints"][0]["coefficients"]["c_0"]["value"] = float(seed)
        (tmp_path / "law.json").write_text(json.dumps(law), encoding="utf-8")
        (tmp_path / "settings.toml").write_text(settings.format(seed), encoding="utf-8")
        motion = make_motion(seconds=10.0 * seed, friction=0.8)
        columns = {"t": motion.t[::2]}
        degrees = 180.0 / math.pi if seed == 2 else 1.0
        for name, values in (
            ("q", degrees * motion.q),
            ("dq", degrees * motion.dq),
            ("tau", motion.tau),
        ):
            columns |= {f"{name}{k}": column[::2] for k, column in enumerate(values.T, start=1)}
        write_table(tmp_path / "log.csv", columns)
        if versions:
            break
        with started(*command, folder=tmp_path) as process:
            assert process.communicate()
            assert process.returncode == 0
        versions.append(contents(out))
    main, killed = Path(command[-1]).name, True
    for number in range(10):
        shutil.rmtree(out)
        out.mkdir()
        for name, content in versions[0].items():
            (out / name).write_bytes(content)
        with started(str(number), *command, folder=tmp_path, program=("-c", KILLED)) as process:
            process.communicate()
            killed = process.returncode == -signal.SIGKILL
        found = {name: file for name, file in contents(out).items() if not name.startswith(".")}
        if not killed:
            versions.append(found)
            break
        assert main not in found or found == versions[0]
    assert not killed
    assert number > 1
    assert versions[0].keys() == versions[1].keys()
    assert versions[1] != versions[0]
