"""User mistakes through the real command line.

Each mistake ends with exit code 2, one sentence with the file, the column or key and the row where
it applies, no traceback, and nothing written.
"""

import json
import os
import re
import signal
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from containing import Containing, OneSentence
from processes import HANG, assert_nothing_runs, started, wait_for, wait_for_line
from small_study import Hesr, contents, hesr_here, hesr_in_a_process, uf850, write_study

from cosim.loop.excite import excite
from cosim.loop.motions import Motions
from fmu_src import export_fmu, model_file
from fmu_src.arm.plant import Plant
from hesr_model.fitting.estimator import select_laws
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.identification import identify
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support.files import models_folder

JOINTS = ("joint1", "joint2", "joint3")


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Valid files, to be damaged one at a time."""

    folder: Path
    robot: Path
    rigid_body: Path
    law: Path
    fmu: Path
    excitation: Path
    log: Path
    trial: Path

    def command(
        self, name: str, *, output: Path, log: Path | None = None, study: Path | None = None
    ) -> list[object]:
        """A command that works, or would if `log` were valid; a study is next to the output."""
        log = log or self.log
        if name == "run":
            return ["run", self.study(study or output.parent, log), "-o", output]
        common = ["--robot", self.robot, "--rigid-body", self.rigid_body]
        return {
            "identify": ["identify", log, "--robot", self.robot, "-o", output / "body.json"],
            "fit": ["fit", log, *common, "--law", "stribeck", "-o", output / "law.json"],
            "test law": ["test", self.law, "--on", log, *common, "--json", output / "scores.json"],
            "test fmu": ["test", self.fmu, "--on", log, *common, "--json", output / "scores.json"],
            "export": ["export", self.law, "-o", output / "Friction.fmu"],
        }[name]

    def study(self, folder: Path, log: Path, *, more: str = "") -> Path:
        path = folder / "study.toml"
        path.write_text(
            f"name = 'bad'\nrobot = '{self.robot}'\nlaws = ['stribeck']\n{more}\n"
            f"[logs]\nidentification = ['{self.excitation}']\nfriction = ['{log}']\n"
            f"[logs.test]\nunseen = ['{self.trial}']\n",
            encoding="utf-8",
        )
        return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    folder = tmp_path_factory.mktemp("bench")
    write_study(folder)
    logs = excite(Motions.read(folder / "motions.toml"), Plant.read(uf850("plant.toml")), folder)
    robot = folder / "robot.toml"
    text = uf850("robot.toml").read_text(encoding="utf-8")
    robot.write_text(text.replace('"uf850.xml"', f'"{uf850("uf850.xml")}"'), encoding="utf-8")
    description = RobotDescription.read(robot)
    model = Robot(description)
    read = {name: Log.read(path, description) for name, path in logs.items()}
    body = identify([read["excitation"]], model, reversed_logs=[read["excitation_reversed"]])
    body.write(folder / "body.json")
    records = [[r] for r in friction_records(read["sweep"], model, body)]
    fitted = fit_models(["stribeck"], records, robot="uf850", seed=0, workers=1)["stribeck"]
    fitted.write(folder / "law.json")
    return Bench(
        folder=folder,
        robot=robot,
        rigid_body=folder / "body.json",
        law=folder / "law.json",
        fmu=export_fmu(fitted, folder / "Friction.fmu"),
        excitation=logs["excitation"],
        log=logs["sweep"],
        trial=logs["trial"],
    )


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


def without_finished(files: dict[str, bytes]) -> dict[str, bytes]:
    """Files other than laws that a run finished before it ended: the next run reuses them."""
    law = re.compile(r"\.\w+-unfinished/laws/\w+\.\w+\.\w+\.json")
    finished = {name for name in files if law.fullmatch(name)}
    assert all(json.loads(files[name])["format"] for name in finished)
    return {name: data for name, data in files.items() if name not in finished}


@pytest.fixture
def refused(hesr: Hesr, tmp_path: Path) -> Callable[..., str]:
    """Run a command that must fail and return its sentence; existing files must not change."""

    def call(*arguments: object) -> str:
        before = contents(tmp_path)
        answer = hesr(*arguments)
        assert answer.code == 2, answer
        assert answer.out == ""
        lines = answer.err.strip().splitlines()
        assert len(lines) == 1, answer.err
        assert lines[0].startswith("hesr: ")
        sentence = lines[0].removeprefix("hesr: ")
        assert sentence.endswith((".", "?"))
        assert without_finished(contents(tmp_path)) == before
        assert {path.name for path in tmp_path.rglob(".*")} <= {".output-unfinished"}
        return sentence

    return call


# --- logs -------------------------------------------------------------------------------------

Rows = list[list[str]]


def cell(row: int, column: str, value: str) -> Callable[[Rows], None]:
    """Set a cell; rows are counted as in an editor, the header being row 1."""

    def change(rows: Rows) -> None:
        rows[row - 1][rows[0].index(column)] = value

    return change


def without(*columns: str) -> Callable[[Rows], None]:
    def change(rows: Rows) -> None:
        kept = [k for k, name in enumerate(rows[0]) if name not in columns]
        rows[:] = [[row[k] for k in kept] for row in rows]

    return change


def shifted(row: int, seconds: float) -> Callable[[Rows], None]:
    """Shift the time of a row and of all later rows."""

    def change(rows: Rows) -> None:
        for line in rows[row - 1 :]:
            line[0] = repr(float(line[0]) + seconds)

    return change


def fourth_joint(rows: Rows) -> None:
    rows[:] = [[*row, name if k == 0 else "0.0"] for k, row in enumerate(rows) for name in ["q4"]]


def in_milliseconds(rows: Rows) -> None:
    for row in rows[1:]:
        row[0] = repr(1e3 * float(row[0]))


def few(rows: Rows) -> None:
    """First row with all joints in motion."""
    q = np.array([row[1:4] for row in rows[1:]], dtype=float)
    k = int(np.argmax(np.abs(q[18:] - q[:-18]).min(axis=1)))
    rows[1:] = rows[k + 1 : k + 20]


LOG_FAULTS: dict[str, tuple[Callable[[Rows], object], str]] = {
    "a missing column": (without("q2"), "column 'q2' is missing; it has t, q1, q3, dq1, dq2,"),
    "no torque": (
        without("tau1", "tau2", "tau3"),
        "column 'tau1' (torque) or 'i1' (current)",
    ),
    "no time": (without("t"), "column 't' is missing; it has q1,"),
    "no velocity": (without("dq1", "dq2", "dq3"), "column 'dq1' is missing; it has t,"),
    "NaN": (cell(17, "dq2", "nan"), "column 'dq2', row 17: an empty cell or NaN where a finite"),
    "an empty cell": (cell(301, "tau3", ""), "column 'tau3', row 301: an empty cell or NaN where"),
    "infinity": (cell(2, "q1", "inf"), "row 2: infinity where a finite"),
    "minus infinity": (cell(40, "tau1", "-inf"), "column 'tau1', row 40: infinity where a finite"),
    "text": (cell(99, "tau2", "high"), "row 99: 'high' where a number"),
    "constant time": (
        lambda rows: cell(52, "t", rows[50][0])(rows),
        "column 't', row 52: time must increase, but",
    ),
    "time that goes back": (shifted(500, -0.5), "column 't', row 500: time must increase, but"),
    "a short row": (lambda rows: rows[41].pop(), "row 42 has 12 cells"),
    "a long row": (
        lambda rows: rows[41].append("1"),
        "row 42 has 14 cells",
    ),
    "more joints than the robot": (
        fourth_joint,
        "has column 'q4', but",
    ),
    "fewer joints than the robot": (
        without("q3", "dq3", "tau3"),
        "column 'q3' is missing; it has",
    ),
    "two columns of one name": (
        cell(1, "q3", "q2"),
        "column 'q2' occurs twice; names must differ.",
    ),
    "time in milliseconds": (
        in_milliseconds,
        "200 Hz means 0.005 s",
    ),
    "a header alone": (lambda rows: rows.__delitem__(slice(1, None)), "has no rows of data below"),
    "one row": (lambda rows: rows.__delitem__(slice(2, None)), "has 1 rows of data"),
    "a few rows": (few, "15 Hz needs more than 42"),
}

READERS = ("identify", "fit", "test law", "test fmu", "run")
FIT_IN_CI = pytest.param("fit", marks=pytest.mark.ci)


def spoiled(bench: Bench, folder: Path, change: Callable[[Rows], object]) -> Path:
    text = bench.log.read_text(encoding="utf-8").replace('"', "")
    rows = [line.split(",") for line in text.splitlines()]
    change(rows)
    path = folder / "spoiled.csv"
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    return path


@pytest.mark.ci
def test_commands_work_on_valid_files(bench: Bench, hesr: Hesr, tmp_path: Path) -> None:
    """Guards the tests below against passing for the wrong reason."""
    log = spoiled(bench, tmp_path, len)
    for name in (*READERS, "export"):
        output = tmp_path / f"output_{name}"
        answer = hesr(*bench.command(name, output=output, log=log))
        assert answer.code == 0, answer.err
        assert contents(output)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize("fault", LOG_FAULTS)
def test_a_damaged_log_is_refused(
    fault: str, command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    change, expected = LOG_FAULTS[fault]
    log = spoiled(bench, tmp_path, change)
    arguments = bench.command(command, output=tmp_path / "output", log=log)
    assert refused(*arguments) == OneSentence(f"{log}: ", expected)


@pytest.mark.parametrize("command", ["identify", "fit", "test law"])
@pytest.mark.parametrize("copied", [False, True])
def test_a_repeated_log_is_refused(
    command: str, copied: bool, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = spoiled(bench, tmp_path, len)
    again = tmp_path / "copy.csv" if copied else log
    again.write_bytes(log.read_bytes())
    arguments = bench.command(command, output=tmp_path / "output", log=log)
    option = ["--on"] if command == "test law" else []
    arguments[arguments.index(log) :] = [
        log,
        *option,
        again,
        *arguments[arguments.index(log) + 1 :],
    ]
    assert f"same content as {log}; leave one" in refused(*arguments)


@pytest.mark.parametrize("command", READERS)
@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (None, "no such log file."),
        (b"", "log needs a header and rows"),
        (b"\x00\xff\xfe\x89PNG", "cannot be read as CSV text."),
    ],
)
def test_a_file_other_than_a_log_is_refused(
    content: bytes | None,
    expected: str,
    command: str,
    bench: Bench,
    refused: Callable[..., str],
    tmp_path: Path,
) -> None:
    log = tmp_path / "log.csv"
    if content is not None:
        log.write_bytes(content)
    arguments = bench.command(command, output=tmp_path / "output", log=log)
    assert refused(*arguments) == OneSentence(f"{log}: ", expected)


def test_an_invalid_parquet_file_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = tmp_path / "log.parquet"
    log.write_bytes(b"PAR1 not really")
    assert refused(*bench.command("fit", output=tmp_path / "o", log=log)) == (
        f"{log}: cannot be read as Parquet."
    )


def rewritten(bench: Bench, folder: Path, change: Callable[[Log], Log]) -> Path:
    """A well-formed log of an unsuitable motion."""
    log = Log.read(bench.log, RobotDescription.read(bench.robot))
    path = folder / "log.csv"
    change(log).write(path)
    return path


def one_way(log: Log) -> Log:
    """Joint 2 always moves forwards."""
    q, dq = log.q.copy(), log.dq.copy()
    q[:, 1] = np.linspace(-0.5, 1.0, len(log.t)) + 0.02 * np.sin(log.t)
    dq[:, 1] = 1.5 / log.t[-1] + 0.02 * np.cos(log.t)
    return replace(log, q=q, dq=dq)


def constant(log: Log) -> Log:
    """Joint 3 is at rest."""
    q, dq = log.q.copy(), log.dq.copy()
    q[:, 2], dq[:, 2] = -1.9, 0.0
    return replace(log, q=q, dq=dq)


def test_a_log_without_a_velocity_reversal_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = rewritten(bench, tmp_path, one_way)
    sentence = refused(*bench.command("fit", output=tmp_path / "output", log=log))
    assert sentence == OneSentence("log log", "joint 'joint2' never reverses")


def test_a_constant_joint_cannot_be_identified(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = rewritten(bench, tmp_path, constant)
    sentence = refused(*bench.command("identify", output=tmp_path / "output", log=log))
    assert sentence == Containing(f"{log}: the position", "'joint3' is constant")


def test_the_friction_of_a_constant_joint_cannot_be_fitted(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = rewritten(bench, tmp_path, constant)
    sentence = refused(*bench.command("fit", output=tmp_path / "output", log=log))
    assert "joint 'joint3'" in sentence
    assert "log" in sentence


@pytest.mark.ci
@pytest.mark.parametrize(("change", "joint"), [(one_way, "joint2"), (constant, "joint3")])
def test_a_run_without_a_velocity_reversal_recommends_a_baseline(
    change: Callable[[Log], Log], joint: str, bench: Bench, hesr: Hesr, tmp_path: Path
) -> None:
    """Other laws are left out with their reason."""
    log = rewritten(bench, tmp_path, change)
    answer = hesr(*bench.command("run", output=tmp_path / "output", log=log))
    assert answer.code == 0, answer.err
    assert answer.err == Containing("'stribeck' is left out", f"joint '{joint}'")
    saved = json.loads((tmp_path / "output" / "verdict.json").read_text(encoding="utf-8"))
    laws = [one["law_name"] for one in saved["choice"]["joints"]]
    assert set(laws) <= set(select_laws("baseline"))


@pytest.mark.parametrize(
    ("command", "rows", "expected"),
    [
        (
            "identify",
            18,
            "log spoiled: 18 samples cannot determine",
        ),
        ("fit", 10, "joint 'joint1': 10 rows for 11"),
    ],
)
def test_fewer_samples_than_parameters_are_refused(
    command: str,
    rows: int,
    expected: str,
    bench: Bench,
    refused: Callable[..., str],
    tmp_path: Path,
) -> None:
    """Few, slow rows of the whole motion, with a low-pass filter that accepts them."""

    def thin(lines: Rows) -> None:
        lines[1:] = lines[1 :: len(lines) // rows][:rows]

    log = spoiled(bench, tmp_path, thin)
    robot = tmp_path / "robot.toml"
    text = bench.robot.read_text(encoding="utf-8").replace("sample_rate = 200.0", "")
    robot.write_text(text.replace("filter_cutoff = 15.0", "filter_cutoff = 0.45"))
    arguments = replace(bench, robot=robot).command(command, output=tmp_path / "output", log=log)
    arguments = ["parfam_h" if a == "stribeck" else a for a in arguments]
    if command == "identify":  # otherwise the model file's body needs no samples
        arguments += ["--body", "free"]
    assert refused(*arguments) == OneSentence(expected)


# --- TOML files -------------------------------------------------------------------------------


def toml_fault(bench: Bench, folder: Path, old: str, new: str, *, source: Path, name: str) -> Path:
    text = source.read_text(encoding="utf-8")
    assert old in text
    path = folder / name
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "[log]",
            '[log.units]\nq = "grad"\n[log]',
            "key 'log.units.q' is 'grad': known units are 'rad', 'deg', 'rev', 'm', 'mm'.",
        ),
        (
            "[log]",
            '[log.units]\ntau = "kgf.m"\n[log]',
            "key 'log.units.tau' is 'kgf.m': known units are 'N.m', 'mN.m', 'N'.",
        ),
        (
            "[log]",
            '[log.units]\nt = "min"\n[log]',
            "key 'log.units.t' is 'min': known units are 's', 'ms', 'us', 'ns'.",
        ),
        ("[log]", "[log]\nrates = 1.0", "unknown key 'log.rates'; did you mean 'log.rate'"),
        ("gravity", "gravitation", "unknown key 'gravitation'; did you mean "),
        ("sample_rate = 200.0", "sample_rate = -1.0", "key 'log.sample_rate' is -1.0: "),
        ("sample_rate = 200.0", "sample_rate = nan", "key 'log.sample_rate' is nan: "),
        ("sample_rate = 200.0", "sample_rate = 200.0.0", "not valid TOML ("),
        ('name = "uf850"\n', "", "key 'name' is missing."),
        (
            "[log]",
            "[log]\ntorque_per_ampere = [1.0, 2.0]",
            "'log.torque_per_ampere' of robot 'uf850' has 2",
        ),
    ],
)
@pytest.mark.parametrize("command", ["identify", "fit", "run"])
def test_an_invalid_robot_file_is_refused(
    command: str,
    old: str,
    new: str,
    expected: str,
    bench: Bench,
    refused: Callable[..., str],
    tmp_path: Path,
) -> None:
    robot = toml_fault(bench, tmp_path, old, new, source=bench.robot, name="robot.toml")
    spoiled_bench = replace(bench, robot=robot)
    sentence = refused(*spoiled_bench.command(command, output=tmp_path / "output"))
    assert sentence == OneSentence(f"{robot}: ", expected)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"joint1", ', '"joint9", ', "has no joint 'joint9'; it has "),
        ('"joint1", "joint2"', '"joint2", "joint1"', "the joints joint2, joint1, joint3 must be"),
        ("uf850.xml", "none.xml", "no such model file."),
        ("uf850.xml", "LICENSE.figures", "cannot be parsed as a URDF ("),
    ],
)
def test_a_robot_that_contradicts_its_model_is_refused(
    old: str, new: str, expected: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    robot = toml_fault(bench, tmp_path, old, new, source=bench.robot, name="robot.toml")
    sentence = refused(*replace(bench, robot=robot).command("fit", output=tmp_path / "output"))
    model = new if new.endswith((".xml", ".figures")) else "uf850.xml"
    assert sentence.startswith(f"{uf850(model)}: {expected}")


def test_a_log_of_another_joint_count_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    """The log has three joints, the robot has two."""
    robot = toml_fault(
        bench, tmp_path, '"joint2", "joint3"', '"joint2"', source=bench.robot, name="robot.toml"
    )
    text = robot.read_text(encoding="utf-8")
    robot.write_text(re.sub(r"(?m)^gear_ratio.*$", "", text), encoding="utf-8")
    sentence = refused(*replace(bench, robot=robot).command("identify", output=tmp_path / "o"))
    assert f"{bench.log}: has column 'q3'" in sentence


TRACKING = """
[tracking]
seeds = [1]
duration = 2.0
harmonics = 3
peak_velocity = [0.5, 0.5, 0.5]
offset = [0.0, 0.3, -1.9]
Kx = 5.0
sources = ["lugre"]

[tracking.gains]
Kp = [0.0, 0.0, 0.0]
Kd = [0.0, 0.0, 0.0]
decay = 4.0
Kv = [90.5, 150.8, 52.8]
Ki = [905.0, 1508.0, 528.0]
latency = 0.01

"""
SIGNALS = f'signals = "{models_folder() / "uf850" / "arm.toml"}"'

STUDY_FAULTS = {
    "a loop without an arm": (
        "[logs]\n",
        f"{TRACKING}[logs]\n",
        "'tracking' needs the keys 'twin'",
    ),
    "a loop with a law that the study has not": (
        "[twin]\n",
        f"{TRACKING}[twin]\n{SIGNALS}\n",
        "key 'tracking.sources': law 'lugre'",
    ),
    "an unknown key": ("seed = 3", "sead = 3", "unknown key 'sead'; did you mean 'seed'"),
    "an unknown key in a table": (
        "[twin]",
        "[twin]\nplan = 1",
        "unknown key 'twin.plan'; did you mean 'twin.plant'?",
    ),
    "no logs": ("[logs]", "[log]", "unknown key 'log'; did you mean 'logs'"),
    "an unknown law": (
        '["stribeck", "parfam_h"]',
        '["lugree"]',
        "key 'laws': law 'lugree' is unknown; known are ",
    ),
    "options of an unknown law": (
        "[options.parfam_h]",
        "[options.lugree]",
        "key 'options.lugree': law 'lugree' is unknown; known are ",
    ),
    "an unknown option": (
        "cells = 2",
        "sells = 2",
        "unknown key 'options.parfam_h.sells'; did you mean 'cells'?",
    ),
    "an option of no use": (
        "cells = 2",
        "cells = 0",
        "ParFam option 'cells' is 0; expected",
    ),
    "a negative seed": ("seed = 3", "seed = -3", "key 'seed' is -3: "),
    "an invalid name": ('"small"', '"../small"', "key 'name' is '../small': "),
    "a test set that is trained on": (
        '["trial"]',
        '["sweep"]',
        "log 'sweep' of test set 'unseen'",
    ),
    "a log that no motion gives": (
        '["trial"]',
        '["tiral"]',
        "key 'logs': 'tiral'",
    ),
}


@pytest.mark.parametrize("fault", STUDY_FAULTS)
def test_an_invalid_study_is_refused(
    fault: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    old, new, expected = STUDY_FAULTS[fault]
    study = write_study(tmp_path)
    study = toml_fault(bench, tmp_path, old, new, source=study, name="study.toml")
    sentence = refused("run", study, "-o", tmp_path / "output")
    assert sentence.startswith(f"{study}: ")
    assert expected in sentence


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        (
            "motions.toml",
            "harmonics = 5",
            "harmonic = 5",
            "unknown key 'motions.0.fourier.harmonic'; did you mean 'motions.0.fourier.harmonics'",
        ),
        ("motions.toml", 'kind = "sweep"', 'kind = "swoop"', "'swoop'"),
        ("motions.toml", "period = 6.0", "period = -6.0", "period' is -6.0"),
        ("plant.toml", "[noise]", "[nose]", "unknown key 'nose'; did you mean 'noise'"),
        ("plant.toml", "seed = 1", "seed = 1\nlevel = 2", "noise.level"),
    ],
)
def test_an_invalid_twin_file_is_refused(
    file: str,
    old: str,
    new: str,
    expected: str,
    bench: Bench,
    refused: Callable[..., str],
    tmp_path: Path,
) -> None:
    study = write_study(tmp_path)
    source = tmp_path / file if file == "motions.toml" else uf850(file)
    path = toml_fault(bench, tmp_path, old, new, source=source, name=file)
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace(str(uf850("plant.toml")), str(path), file == "plant.toml"))
    sentence = refused("run", study, "-o", tmp_path / "output")
    assert sentence.startswith(f"{path}: ")
    assert expected in sentence


@pytest.mark.parametrize("key", ["robot", "plant", "motions"])
def test_missing_files_of_a_study_are_reported(
    key: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    study = write_study(tmp_path)
    text = study.read_text(encoding="utf-8")
    study.write_text(re.sub(rf'(?m)^{key} = ".*"$', f'{key} = "none.toml"', text))
    sentence = refused("run", study, "-o", tmp_path / "output")
    assert sentence == f"{tmp_path / 'none.toml'}: no such file."


def test_a_missing_study_is_reported(refused: Callable[..., str], tmp_path: Path) -> None:
    assert refused("run", tmp_path / "none.toml") == f"{tmp_path / 'none.toml'}: no such file."
    # "paper" alone is a shipped study.
    assert refused("run", "a/paper") == "a/paper: no such file."


# --- laws and platforms -----------------------------------------------------------------------


def test_the_known_laws_are_listed_for_an_unknown_one(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    arguments = bench.command("fit", output=tmp_path / "output")
    arguments[arguments.index("stribeck")] = "lugree"
    expected = r"law 'lugree' is unknown; known are .*stribeck.*\."
    assert re.fullmatch(expected, refused(*arguments))


@pytest.mark.parametrize("command", ["export", "run"])
def test_an_unknown_platform_is_refused(
    command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    arguments = bench.command(command, output=tmp_path / "output")
    assert "platform 'solaris' is unknown" in refused(*arguments, "--platform", "solaris")


def test_an_fmu_of_another_name_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    output = tmp_path / "Friction.zip"
    assert f"{output}: the name of an FMU" in refused("export", bench.law, "-o", output)


def test_an_unknown_method_is_refused(bench: Bench, hesr: Hesr, tmp_path: Path) -> None:
    arguments = bench.command("identify", output=tmp_path / "output")
    answer = hesr(*arguments, "--method", "guess")
    assert (answer.code, answer.out) == (2, "")
    assert "'--method': 'guess' is not one of 'stacked', 'paper'." in answer.err
    assert not (tmp_path / "output").exists()


def test_an_invalid_counterpart_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    arguments = bench.command("identify", output=tmp_path / "output")
    assert refused(*arguments, "--method", "paper").startswith(
        "1 logs come with 0 time-reversed ones"
    )
    sentence = refused(*arguments, "--method", "paper", "--reversed", bench.excitation)
    assert "time-reversed counterpart of sweep" in sentence


# --- artifacts --------------------------------------------------------------------------------


def changed_json(path: Path, folder: Path, **values: object) -> Path:
    data = json.loads(path.read_text(encoding="utf-8"))
    data.update(values)
    changed = folder / path.name
    changed.write_text(json.dumps(data), encoding="utf-8")
    return changed


def test_swapped_model_and_rigid_body_are_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    swapped = replace(bench, rigid_body=bench.law, law=bench.rigid_body)
    for command in ("fit", "test fmu"):
        assert refused(*swapped.command(command, output=tmp_path / "output")) == (
            f"{bench.law}: 'format' is 'hesr-friction-model-1', expected 'hesr-rigid-body-1'."
        )
    for command in ("test law", "export"):
        assert refused(*swapped.command(command, output=tmp_path / "output")) == (
            f"{bench.rigid_body}: 'format' is 'hesr-rigid-body-1', expected "
            "'hesr-friction-model-1'."
        )


@pytest.mark.parametrize("content", ["", "{", "[1, 2]", "null"])
@pytest.mark.parametrize("command", ["fit", "test law", "test fmu"])
def test_an_invalid_rigid_body_is_refused(
    command: str, content: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    path = tmp_path / "body.json"
    path.write_text(content)
    arguments = replace(bench, rigid_body=path).command(command, output=tmp_path / "output")
    sentence = refused(*arguments)
    assert sentence.startswith(
        (f"{path}: not a readable JSON file (", f"{path}: 'format' is None, expected ")
    )


@pytest.mark.parametrize("command", ["test law", "export"])
def test_a_model_of_an_unknown_law_is_refused(
    command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    data = json.loads(bench.law.read_text(encoding="utf-8"))
    for joint in data["joints"]:
        joint["law"] = "lugree"
    path = changed_json(bench.law, tmp_path, joints=data["joints"])
    arguments = replace(bench, law=path).command(command, output=tmp_path / "output")
    assert refused(*arguments).startswith(f"{path}: law 'lugree' is unknown; known are ")


def test_missing_artifacts_are_reported(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    for key, command in (
        ("rigid_body", "fit"),
        ("law", "test law"),
        ("law", "export"),
    ):
        missing = tmp_path / "none.json"
        arguments = replace(bench, **{key: missing}).command(command, output=tmp_path / "output")
        assert refused(*arguments) == f"{missing}: no such file."


def test_a_model_for_other_joints_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    data = json.loads(bench.law.read_text(encoding="utf-8"))
    for joint, name in zip(data["joints"], ("a", "b", "c"), strict=True):
        joint["joint"] = name
    path = changed_json(bench.law, tmp_path, joints=data["joints"])
    sentence = refused(*replace(bench, law=path).command("test law", output=tmp_path / "output"))
    assert "for the joints a, b, c" in sentence


def test_a_rigid_body_of_another_robot_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    data = json.loads(bench.rigid_body.read_text(encoding="utf-8"))
    parameters = {name.replace("joint", "axis"): v for name, v in data["parameters"].items()}
    base = [name.replace("joint", "axis") for name in data["base"]]
    path = changed_json(bench.rigid_body, tmp_path, parameters=parameters, base=base)
    sentence = refused(*replace(bench, rigid_body=path).command("fit", output=tmp_path / "output"))
    assert "rigid body of 'uf850' with 33" in sentence


def test_a_prediction_needs_a_log_and_a_rigid_body(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    sentence = refused("test", bench.law, "--kind", "prediction", "--rigid-body", bench.rigid_body)
    assert sentence == "--kind prediction needs --on, a log."
    sentence = refused("test", bench.law, "--on", bench.log, "--robot", bench.robot)
    assert sentence == "--kind prediction needs --rigid-body, the result of 'hesr identify'."
    assert "is neither a friction model" in refused("test", bench.log)


# --- FMUs -------------------------------------------------------------------------------------


def test_invalid_fmus_are_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    missing, other = tmp_path / "none.fmu", tmp_path / "log.fmu"
    other.write_bytes(bench.log.read_bytes())
    for path in (missing, other):
        arguments = replace(bench, fmu=path).command("test fmu", output=tmp_path / "output")
        assert refused(*arguments).startswith(f"{path}: ")


def test_an_fmu_for_another_number_of_joints_is_refused(
    bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    whole = FrictionModel.read(model_file("uf850-table1"))
    model = replace(whole, joints=whole.joints[:2], laws=whole.laws[:2], trained=whole.trained[:2])
    fmu = export_fmu(model, tmp_path / "Two.fmu")
    sentence = refused(*replace(bench, fmu=fmu).command("test fmu", output=tmp_path / "output"))
    assert sentence.startswith(f"{fmu}: ")
    assert "2 joints" in sentence


# --- unwritable outputs ------------------------------------------------------------------------


@pytest.mark.parametrize("command", [*READERS, "export"])
def test_an_output_below_a_regular_file_is_refused(
    command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    """Independent of permissions, so that it also fails for root."""
    blocking = tmp_path / "file"
    blocking.write_text("mine")
    output = blocking / "output"
    sentence = refused(*bench.command(command, output=output, study=tmp_path))
    assert re.match(
        rf"{re.escape(str(output))}\S*: cannot be written there \(Not a directory\)\.", sentence
    )


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="this system has no /proc")
@pytest.mark.parametrize(
    "command", ["identify", FIT_IN_CI, "test law", "test fmu", "run", "export"]
)
def test_a_read_only_file_system_is_reported(
    command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    output = Path("/proc/hesr")
    sentence = refused(*bench.command(command, output=output, study=tmp_path))
    assert sentence.startswith("/proc/hesr")
    assert ": cannot be written there (" in sentence


@pytest.mark.parametrize("command", ["identify", FIT_IN_CI, "test law", "export"])
def test_a_folder_as_output_file_is_refused(
    command: str, bench: Bench, refused: Callable[..., str], tmp_path: Path
) -> None:
    arguments = bench.command(command, output=tmp_path)
    Path(str(arguments[-1])).mkdir()
    assert refused(*arguments) == f"{arguments[-1]}: cannot be written there (Is a directory)."


# --- separate processes ------------------------------------------------------------------------


@pytest.mark.ci
def test_the_installed_command_gives_the_same_error(bench: Bench, tmp_path: Path) -> None:
    log = spoiled(bench, tmp_path, cell(17, "dq2", "nan"))
    for command in ("identify", "run"):
        arguments = bench.command(command, output=tmp_path / "o", log=log)
        before = contents(tmp_path)
        answer = hesr_in_a_process(*arguments)
        assert (answer.code, answer.out) == (2, "")
        assert answer.err.strip() == Containing(f"hesr: {log}: column 'dq2', row 17: an empty")
        assert contents(tmp_path) == before


def second_law_is_fitted(line: str) -> bool:
    """Return whether a line of progress says that the search of three joints is under way.

    Each law has 300 steps. Those of the baselines and of the linear law take a moment.
    """
    steps = re.search(r"fitting laws: (\d+) of 1500$", line)
    return steps is not None and int(steps[1]) > 1200


@pytest.mark.ci
@pytest.mark.skipif(os.name != "posix", reason="interrupts are sent to a group of processes")
@pytest.mark.parametrize("moment", ["workers start", "fit runs"])
def test_an_interrupt_ends_a_run_quietly_and_at_once(moment: str, tmp_path: Path) -> None:
    """Ctrl-C reaches the command and its workers, here during a fit of ten minutes."""
    study = write_study(tmp_path)
    text = study.read_text(encoding="utf-8")
    assert "starts = 4\n" in text
    study.write_text(text.replace("cells = 2", "cells = 50").replace("starts = 4", "starts = 3000"))
    results = tmp_path / "results"
    results.mkdir()
    (results / "evaluation.json").write_text("old")
    before = contents(tmp_path)
    verbose = ["--verbose"] if moment == "fit runs" else []
    with started("run", study, "-o", results, *verbose, folder=tmp_path) as process:
        if moment == "fit runs":
            wait_for_line(process, second_law_is_fitted)
        else:  # the body is written just before the fits start
            wait_for(lambda: list(tmp_path.glob(".hesr-*/files/results/rigid_body.json")), process)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=HANG)
    assert process.returncode == 130
    assert out == ""
    assert "Traceback" not in err
    sentences = [line for line in err.splitlines() if "INFO hesr.cli.console: fitting" not in line]
    assert len(sentences) <= 1
    assert without_finished(contents(tmp_path)) == before
    assert_nothing_runs(process.pid)
    assert not list((tmp_path / "tmp").iterdir())
