"""Odd files as the value of each path on the command line: one sentence, and nothing is written.

Options are those that the commands have, so that a new one fails here until `USES` names a command
line that reaches it.
"""

import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import adaptive_models
import click
import pytest
from small_fmus import LAGS
from small_study import Hesr, Run, hesr_here, uf850

from hesr.cli.app import app

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="pipes in folders are those of POSIX"),
]

Use = Mapping[str, str | bool]

USES: dict[str, tuple[Use, ...]] = {
    "new": (
        {"folder": "{out}/project", "robot": "{mjcf}"},
        {"folder": "{out}/project", "public": "{clone}"},
    ),
    "inspect": (
        {
            "logs": "{log}",
            "robot": "{robot}",
            "output": "{out}/page.html",
            "write": "{out}/robot.toml",
            "study": "{out}/study.toml",
        },
        {
            "logs": "{log}",
            "robot": "{robot}",
            "torque_constants": True,
            "loaded": "{trial}",
            "payload": "1,0,0,0.1",
        },
    ),
    "excite": (
        {"robot": "{robot}", "output": "{out}/motion.csv", "settings": "{limits}"},
        {
            "robot": "{robot}",
            "output": "{out}/motion.csv",
            "settings": "{limits}",
            "after": "{results}",
        },
    ),
    "identify": (
        {
            "logs": "{excitation}",
            "robot": "{robot}",
            "reversed_logs": "{reversed}",
            "method": "paper",
            "output": "{out}/body.json",
        },
        {
            "logs": "{excitation}",
            "robot": "{robot}",
            "friction": "{law}",
            "rigid_body": "{body}",
        },
        {"logs": "{excitation}", "robot": "{robot}", "payload": "{body}"},
    ),
    "fit": (
        {
            "logs": "{log}",
            "law": "stribeck",
            "robot": "{robot}",
            "rigid_body": "{body}",
            "output": "{out}/law.json",
        },
        {"logs": "{log}", "robot": "{robot}", "rigid_body": "{body}", "prior": "{law}"},
    ),
    "test": (
        {"laws": "{law}", "on": "{trial}", "robot": "{robot}", "rigid_body": "{body}"},
        {"laws": "{law}", "kind": "properties", "output": "{out}/properties.json"},
        {"laws": "{fmu}", "kind": "properties"},
    ),
    "export": (
        {"source": "{law}", "output": "{out}/Friction.fmu"},
        {"source": "{mjcf}", "output": "{out}/Arm.fmu", "signals": "{signals}"},
        {"source": "{system}", "output": "{out}/system.ssp"},
        {
            "source": "{law}",
            "output": "{out}/joints.xml",
            "format": "mjcf-joint",
            "robot": "{robot}",
            "rigid_body": "{body}",
            "log": "{log}",
            "test_log": "{trial}",
            "into": "{mjcf}",
        },
        {
            "source": "{law}",
            "output": "{out}/Friction.fmu",
            "format": "observer",
            "robot": "{robot}",
            "rigid_body": "{body}",
            "calibration": "{trial}",
        },
    ),
    "check": (
        {"fmus": "{fmu}", "junit": "{out}/check.xml", "sarif": "{out}/check.sarif"},
        {"fmus": "{fmu}", "vdmcheck": "{out}"},
    ),
    "simulate": (
        {"system": "{system}", "output": "{out}/result.csv"},
        {"system": "{fmu}", "stop": "1", "input": "{inputs}"},
        {"system": "system.ssp"},
    ),
    "run": (
        {"study": "{study}", "output": "{out}/results"},
        {"study": "paper", "measured": "{study}"},
    ),
    "report": (
        {"results": "{results}", "output": "{out}/page.html"},
        {"results": "{results}", "output": "{out}/page.md"},
    ),
    "monitor": (
        {
            "logs": "{log}",
            "law": "{lugre}",
            "robot": "{robot}",
            "rigid_body": "{body}",
            "output": "{out}/page.html",
        },
    ),
}
"""Command lines by verb; names in braces are files of `bench`."""

LOG_SUFFIXES = (
    *(".csv", ".csv.gz", ".txt", ".parquet", ".feather", ".npy", ".npz", ".xlsx", ".mat", ".h5"),
    *(".bag", ".db3", ".mcap"),
)

NO_PATHS = {"NAME", "CHECK"}
"""Values of options, as the help shows them, that are no paths."""

NEW_FOLDERS = {("new", "folder"), ("run", "output")}
"""Paths whose value may be an empty folder."""


def list_paths() -> list[tuple[str, str]]:
    """Return verb and parameter of each path on the command line."""
    paths = []
    for verb in app.list_commands(click.Context(app)):
        paths += [(verb, str(parameter.name)) for parameter in list_path_parameters(verb)]
    return paths


def list_path_parameters(verb: str) -> list[click.Parameter]:
    """Return the parameters of a verb whose values are paths."""
    parameters = find_command(verb).params
    return [
        parameter
        for parameter in parameters
        if parameter.type is click.STRING and parameter.metavar not in NO_PATHS
    ]


def find_command(verb: str) -> click.Command:
    command = app.get_command(click.Context(app), verb)
    assert command is not None
    return command


@pytest.fixture(scope="module")
def bench(
    study_run: Run, lag_fmu: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """Valid files."""
    folder = tmp_path_factory.mktemp("bench")
    limits = folder / "limits.toml"
    limits.write_text(
        "[limits]\nvelocity = [1.0, 1.0, 1.0]\nacceleration = [3.0, 3.0, 3.0]\n", encoding="utf-8"
    )
    inputs = folder / "inputs.csv"
    inputs.write_text("t,u\n0,1\n1,2\n", encoding="utf-8")
    system = folder / "system.toml"
    system.write_text(LAGS.replace("FMU", str(lag_fmu)), encoding="utf-8")
    lugre = folder / "lugre.json"
    adaptive_models.model(*[adaptive_models.lugre()] * 3).write(lugre)
    return {
        "log": study_run.log("sweep"),
        "excitation": study_run.log("excitation"),
        "reversed": study_run.log("excitation_reversed"),
        "trial": study_run.log("trial"),
        "robot": uf850("robot.toml"),
        "mjcf": uf850("uf850.xml"),
        "signals": uf850("arm.toml"),
        "body": study_run.rigid_body,
        "law": study_run.law("stribeck"),
        "lugre": lugre,
        "fmu": lag_fmu,
        "system": system,
        "inputs": inputs,
        "limits": limits,
        "clone": folder,
        "study": study_run.study,
        "results": study_run.results,
    }


# --- odd files ----------------------------------------------------------------------------------


def make_pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def make_socket(path: Path) -> Path:
    here = Path.cwd()
    os.chdir(path.parent)  # names of sockets have at most 107 letters
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(path.name)
    finally:
        os.chdir(here)
    return path


def link(target: Callable[[Path], str | Path]) -> Callable[[Path], Path]:
    def make(path: Path) -> Path:
        path.symlink_to(target(path))
        return path

    return make


def make_folder(path: Path) -> Path:
    path.mkdir()
    return path


def below(make: Callable[[Path], Path]) -> Callable[[Path], Path]:
    return lambda path: make(path.with_name("parent")) / path.name


def to_itself(path: Path) -> Path:
    return path


def to_nothing(path: Path) -> Path:
    """Return a path in an existing folder, where a link that is followed makes a file."""
    elsewhere = path.with_name("elsewhere")
    elsewhere.mkdir()
    return elsewhere / "nothing"


KINDS: dict[str, Callable[[Path], Path]] = {
    "pipe": make_pipe,
    "socket": make_socket,
    "endless device": link(lambda _: "/dev/zero"),
    "full device": link(lambda _: "/dev/full"),
    "folder": make_folder,
    "link to a pipe": link(lambda path: make_pipe(path.with_name("pipe"))),
    "link to itself": link(to_itself),
    "link to nothing": link(to_nothing),
    "below a pipe": below(make_pipe),
    "below a link to itself": below(link(to_itself)),
    "below a link to nothing": below(link(to_nothing)),
}


# --- commands -----------------------------------------------------------------------------------


def list_entries(folder: Path) -> dict[str, tuple[Any, ...]]:
    """Return kind, identity and time of all entries, without opening any."""
    entries = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        time = 0 if path.is_dir() else status.st_mtime_ns  # temporary files come and go in folders
        entries[str(path.relative_to(folder))] = (status.st_mode, status.st_ino, time)
    return entries


def build_line(verb: str, values: Mapping[str, Any]) -> list[object]:
    """Return the command line with values of parameters."""
    arguments: list[object] = [verb]
    options: list[object] = []
    for parameter in find_command(verb).params:
        value = values.get(str(parameter.name))
        if value is None:
            continue
        if isinstance(parameter, click.Argument):
            arguments.append(value)
        elif value is True:
            options.append(parameter.opts[-1])
        else:
            options += [parameter.opts[-1], value]
    return [*arguments, *options]


def refuse_odd_files(
    hesr: Hesr, bench: Mapping[str, Path], folder: Path, verb: str, name: str, use: Use
) -> None:
    """Check that a command refuses each kind of file as the value of a parameter."""
    for kind, make in KINDS.items():
        if kind == "folder" and (verb, name) in NEW_FOLDERS:
            continue
        place = folder / kind
        (place / "out").mkdir(parents=True)
        values = {
            parameter: value.format(out=place / "out", **bench) if isinstance(value, str) else value
            for parameter, value in use.items()
        }
        suffix = Path(str(values.get(name, "answer.json"))).suffix
        values[name] = str(make(place / f"odd{suffix}"))
        before = list_entries(place)
        answer = hesr(*build_line(verb, values))
        assert answer.code == 2, (kind, answer)
        assert answer.out == "", kind
        assert len(answer.err.splitlines()) == 1, (kind, answer.err)
        assert answer.err.startswith("hesr: "), kind
        assert f"odd{suffix}" in answer.err, (kind, answer.err)
        assert list_entries(place) == before, kind


def select_uses(verb: str, name: str) -> list[Use]:
    """Return the uses of a command with a new path as the value of a parameter, or the first."""
    uses: dict[str, Use] = {}
    for use in USES[verb]:
        value = str(use.get(name, ""))
        if "{" in value or Path(value).suffix:
            uses.setdefault(value, use)
    return list(uses.values()) or [USES[verb][0]]


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.mark.timeout(120)
@pytest.mark.parametrize(("verb", "name"), list_paths())
def test_odd_files_are_refused(
    verb: str, name: str, hesr: Hesr, bench: dict[str, Path], tmp_path: Path
) -> None:
    for number, use in enumerate(select_uses(verb, name)):
        refuse_odd_files(hesr, bench, tmp_path / str(number), verb, name, use)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("suffix", LOG_SUFFIXES)
def test_odd_logs_are_refused(
    suffix: str, hesr: Hesr, bench: dict[str, Path], tmp_path: Path
) -> None:
    """Each format of logs has a reader of its own."""
    use = {"logs": f"log{suffix}", "robot": "{robot}"}
    refuse_odd_files(hesr, bench, tmp_path, "inspect", "logs", use)
