"""A study of the digital twin that takes seconds, and the command line to run it."""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from small_twin import MOTIONS

from hesr_model.support.files import models_folder

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

MAIN = "from hesr.cli import main; main()"


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
    """Output and exit code of a command."""

    code: int
    out: str
    err: str


def hesr_in_a_process(*arguments: object, cwd: Path | None = None) -> Answer:
    """Run the command line in a separate process."""
    result = subprocess.run(
        [sys.executable, "-c", MAIN, *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
        env=os.environ | {"COLUMNS": "120"},
    )
    return Answer(code=result.returncode, out=result.stdout, err=result.stderr)


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run of the small study in a separate process."""

    study: Path
    results: Path
    answer: Answer

    @classmethod
    def make(cls, folder: Path, *options: object, program: str = MAIN) -> None:
        """Run the study in a folder; `of` reads that folder."""
        (folder / "study").mkdir()
        study = write_study(folder / "study")
        command = (sys.executable, "-c", program, "run", study)
        said = subprocess.run(
            [*map(str, command), *map(str, options)],
            capture_output=True,
            text=True,
            cwd=study.parent,
            env={name: value for name, value in os.environ.items() if name != "COLUMNS"},
            check=False,
        )
        for name, text in (("out", said.stdout), ("err", said.stderr), ("code", said.returncode)):
            (folder / name).write_text(str(text), encoding="utf-8")

    @classmethod
    def of(cls, folder: Path) -> "Run":
        """Files that a run has left in a folder."""
        said = {
            name: (folder / name).read_text(encoding="utf-8") if (folder / name).exists() else ""
            for name in ("out", "err", "code")
        }
        answer = Answer(code=int(said["code"] or -1), out=said["out"], err=said["err"])
        study = folder / "study"
        return cls(study=study / "study.toml", results=study / "results", answer=answer)

    def require_success(self) -> None:
        """Raise an error if the run failed."""
        if self.answer.code != 0:
            raise RuntimeError(f"the study ended with {self.answer.code}: {self.answer.err}")

    def log(self, name: str) -> Path:
        return self.results / "logs" / f"{name}.csv"

    def law(self, name: str) -> Path:
        return self.results / "laws" / f"{name}.json"

    @property
    def rigid_body(self) -> Path:
        return self.results / "rigid_body.json"


Hesr = Callable[..., Answer]


def hesr_here(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    """The command line in this process, by its entry point."""
    from hesr.cli import main

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
    """Bytes of every file below a folder, including hidden ones."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in without
    }
