"""A study of the digital twin that takes seconds, and the command line to run it by."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from small_twin import MOTIONS

from hesr_model.files import models_folder

STUDY = """
name = "small"
robot = "{robot}"
seed = 3
laws = ["stribeck", "parfam_h"]

[options.parfam_h]
cells = 2
starts = 4
candidates = 2
functions = ["tanh"]

[twin]
plant = "{plant}"
motions = "motions.toml"

[logs]
identification = ["excitation"]
reversed = ["excitation_reversed"]
friction = ["sweep"]

[logs.test]
unseen = ["trial"]
"""


def uf850(name: str) -> Path:
    """A file of the shipped robot."""
    return models_folder() / "uf850" / name


def write_study(folder: Path) -> Path:
    """Write the study and its motions."""
    (folder / "motions.toml").write_text(MOTIONS, encoding="utf-8")
    study = folder / "study.toml"
    text = STUDY.format(robot=uf850("robot.toml"), plant=uf850("plant.toml"))
    study.write_text(text, encoding="utf-8")
    return study


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a command said and how it ended."""

    code: int
    out: str
    err: str


def hesr_in_a_process(*arguments: object, cwd: Path | None = None) -> Answer:
    """Run the command line in a process of its own."""
    result = subprocess.run(
        [sys.executable, "-c", "from cosim.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
        env=os.environ | {"COLUMNS": "120"},
    )
    return Answer(code=result.returncode, out=result.stdout, err=result.stderr)


Hesr = Callable[..., Answer]


def hesr_here(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    """The command line in this process: its own entry point, without a process to start."""
    from cosim.cli import main

    def call(*arguments: object) -> Answer:
        monkeypatch.setenv("COLUMNS", "120")
        monkeypatch.setattr(sys, "argv", ["hesr", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        code = ended.value.code
        return Answer(code=code if isinstance(code, int) else 1, out=said.out, err=said.err)

    return call


def contents(folder: Path, *, without: Sequence[str] = ()) -> dict[str, bytes]:
    """Bytes of every file below a folder, hidden ones too."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in without
    }
