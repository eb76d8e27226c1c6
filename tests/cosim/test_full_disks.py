"""Real full disks: one error message and no partial files."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from processes import COMMAND
from small_fmus import LAGS
from small_study import Hesr, Run, contents, hesr_here, uf850, write_study

from hesr_model.errors import ArtifactError
from hesr_model.logs.robot_log import Log
from hesr_model.support.files import written_whole

pytestmark = pytest.mark.ci

FULL = "cannot be written there (No space left on device).\n"

SWEEP = """
name = "lags"
system = "lags.toml"
design = "sobol"
runs = 4
seed = 3

[[inputs]]
variables = ["a.u"]
low = 1.0
high = 3.0

[[outputs]]
name = "end"
signal = "b.y"
measure = "final"
"""


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture
def full(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB with 40 kB left."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "hesr-test", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    if mounted.returncode:
        pytest.skip(f"no file system can be mounted here: {mounted.stderr.strip()}")
    try:
        (folder / "filled").write_bytes(bytes(1024 * 984))
        yield folder
    finally:
        # A process that has just ended may hold a file briefly.
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(folder: Path) -> None:
    """Fill the last bytes of a disk."""
    with suppress(OSError), (folder / "filled").open("ab") as file:
        file.write(bytes(2**20))


def refuse(hesr: Hesr, full: Path, output: Path, *arguments: object) -> None:
    """Check that a command reports `output` as unwritable and leaves the disk unchanged."""
    before = contents(full)
    answer = hesr(*arguments)
    assert (answer.code, answer.err) == (2, f"hesr: {output}: {FULL}"), (arguments, answer)
    assert contents(full) == before
    assert {path.name for path in full.rglob("*")} == {"filled"}


@pytest.mark.parametrize("command", ["export", "new", "run"])
def test_a_disk_that_fills_up_is_one_sentence(
    command: str, full: Path, tmp_path: Path, hesr: Hesr
) -> None:
    output = full / "out"
    if command == "run":
        arguments: tuple[object, ...] = ("run", write_study(tmp_path), "-o", output)
    elif command == "new":
        arguments = ("new", output, "--robot", uf850("uf850.xml"))
    else:
        output = full / "Friction.fmu"
        arguments = ("export", "uf850-table1", "-o", output)
    refuse(hesr, full, output, *arguments)


def test_a_full_disk_is_one_sentence(full: Path, lag_fmu: Path, tmp_path: Path, hesr: Hesr) -> None:
    fill(full)
    system, study = tmp_path / "lags.toml", tmp_path / "study.toml"
    text = LAGS.replace("step = 0.2\n", "").replace("FMU", str(lag_fmu))
    system.write_text(text, encoding="utf-8")
    study.write_text(SWEEP, encoding="utf-8")
    for name, *arguments in (
        ("laws.json", "fit", "--list", "--quiet", "--json"),
        ("out.csv", "simulate", system, "-o"),
        ("out.parquet", "simulate", system, "-o"),
        ("out.ssp", "export", system, "-o"),
        ("run.csv", "simulate", study, "--only", 1, "-o"),
        ("check.json", "check", lag_fmu, "--kind", "references", "--quiet", "--json"),
        ("model.h", "export", "uf850-table1", "--format", "c", "-o"),  # and model.csv
        ("Friction.mo", "export", "uf850-table1", "--format", "modelica", "-o"),
        ("properties.json", "test", "uf850-table1", "--kind", "properties", "--quiet", "-o"),
        ("arm.fmu", "export", uf850("uf850.xml"), "-o"),
    ):
        refuse(hesr, full, full / str(name), *arguments, full / str(name))
    sweep = full / "sweep"
    refuse(hesr, full, sweep / "sweep.json", "simulate", study, "--workers", 1, "-o", sweep)


@pytest.mark.soak
def test_a_full_disk_is_one_sentence_for_results_of_logs(
    full: Path, study_run: Run, tmp_path: Path, hesr: Hesr
) -> None:
    fill(full)
    robot = ("--robot", uf850("robot.toml"))
    known = (*robot, "--rigid-body", study_run.rigid_body)
    law, log = study_run.law("parfam_h"), study_run.log("trial")
    lugre, warm = tmp_path / "lugre.json", tmp_path / "warm.csv"
    cold = Log.read(log, uf850("robot.toml"))
    temperature = np.linspace(20.0, 40.0, len(cold.t))[:, None] * np.ones(cold.q.shape[1])
    replace(cold, temperature=temperature).write(warm)
    fitted = hesr("fit", study_run.log("sweep"), *known, "--law", "lugre", "-o", lugre)
    assert fitted.code == 0, fitted.err
    settings = study_run.results.parent / "settings.toml"
    settings.write_text("[limits]\nvelocity = [2.0, 2.0, 2.0]\n", encoding="utf-8")
    for name, *arguments in (
        ("body.json", "identify", study_run.log("excitation"), *robot, "-o"),
        ("law.json", "fit", study_run.log("sweep"), *known, "--law", "stribeck", "-o"),
        ("scores.json", "test", law, "--on", log, *known, "--quiet", "--json"),
        ("log.html", "inspect", log, *robot, "-o"),
        ("log.json", "inspect", log, *robot, "--quiet", "--json"),
        ("robot.toml", "inspect", log, *robot, "--write"),
        ("results.md", "report", study_run.results, "-o"),
        ("report.html", "report", study_run.results, "-o"),
        ("motion.csv", "excite", uf850("robot.toml"), "--settings", settings, "-o"),
        ("warm.json", "fit", warm, "--law", lugre, "--add", "temperature", *known, "-o"),
        ("friction.html", "monitor", log, "--law", lugre, *known, "-o"),
    ):
        refuse(hesr, full, full / str(name), *arguments, full / str(name))


def test_the_reported_file_is_the_requested_one(full: Path) -> None:
    """Includes nested temporary files; no folder is left."""
    fill(full)
    output = full / "new" / "folder" / "out.csv"
    with (
        pytest.raises(ArtifactError) as caught,
        written_whole(output) as outer,
        written_whole(outer) as inner,
    ):
        inner.write_bytes(b"more than there is")
    assert str(caught.value) == f"{output}: {FULL.strip()}"
    assert {path.name for path in full.iterdir()} == {"filled"}


@pytest.mark.parametrize(
    "arguments",
    [("export", "uf850-table1", "-o"), ("test", "uf850-table1", "--kind", "properties")],
)
def test_a_full_disk_for_temporary_files_is_one_sentence(
    arguments: tuple[str, ...], full: Path, tmp_path: Path
) -> None:
    """The compiler's folder is full, not the compiler missing."""
    output = tmp_path / "Friction.fmu"
    result = subprocess.run(
        [sys.executable, *COMMAND, *arguments, *([str(output)] if "-o" in arguments else [])],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"TMPDIR": str(full), "XDG_CACHE_HOME": str(tmp_path / "cache")},
    )
    assert result.returncode == 2, result
    assert result.stderr.startswith(f"hesr: {full}")
    assert result.stderr.endswith("cannot be written there (No space left on device).\n")
    assert len(result.stderr.splitlines()) == 1
    assert not output.exists()
    assert {path.name for path in full.iterdir()} == {"filled"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    "arguments", [("fit", "--list"), ("fit", "--list", "--json", "-"), ("--help",)]
)
def test_a_full_standard_output_is_one_sentence(arguments: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as output:
        result = subprocess.run(
            [sys.executable, *COMMAND, *arguments],
            stdout=output,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert result.returncode == 2
    assert result.stderr == ("hesr: the system reports an error (No space left on device).\n")
