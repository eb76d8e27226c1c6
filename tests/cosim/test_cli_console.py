"""Verbosity and output of commands: --quiet, --verbose, --json, progress, 80-column tables."""

import json
import logging
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from containing import OneSentence
from small_study import Hesr, Run, hesr_here, hesr_in_a_process, uf850, write_study

from cosim.study.steps import checkpoint_folder
from cosim.workflow.run import _describe_checkpoints
from hesr_model.fitting.estimator import registry, select_laws

ROBOT = uf850("robot.toml")


@pytest.fixture
def hesr(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Hesr:
    return hesr_here(capsys, monkeypatch)


@pytest.fixture(scope="module")
def ran(study_run: Run) -> Run:
    assert study_run.answer.code == 0, study_run.answer.err
    return study_run


def scoring(ran: Run) -> list[object]:
    return [
        *("test", ran.law("parfam_h"), "--on", ran.log("trial")),
        *("--robot", ROBOT, "--rigid-body", ran.rigid_body),
    ]


# --- JSON --------------------------------------------------------------------------------------


@pytest.mark.ci
def test_json_is_the_only_output_of_a_run(study_run_for_programs: Run) -> None:
    ran = study_run_for_programs
    assert ran.answer.code == 0, ran.answer.err
    answer = json.loads(ran.answer.out)["result"]
    assert answer["folder"] == "results"
    assert set(answer["fmus"]) == {*select_laws("baseline"), "stribeck", "parfam_h"}
    for fmu in answer["fmus"].values():
        assert (ran.study.parent / fmu).is_file()
    saved = json.loads((ran.results / "evaluation.json").read_text(encoding="utf-8"))
    assert answer["evaluation"] == saved
    assert answer["closed_loop"] is None


def test_json_goes_to_standard_output_or_to_a_file(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    alone = hesr(*scoring(ran), "--json", "-")
    assert alone.code == 0, alone.err
    beside = hesr(*scoring(ran), "--json", tmp_path / "scores.json")
    assert beside.out.startswith("Best: parfam_h. Unexplained friction: joint1 ")
    assert json.loads(alone.out) == json.loads((tmp_path / "scores.json").read_text())
    assert not Path("-").exists()


def test_laws_are_listed_as_json(hesr: Hesr) -> None:
    answer = json.loads(hesr("fit", "--list", "--json", "-").out)["result"]
    assert list(answer) == list(registry())
    assert answer["parfam_h"]["title"] == "ParFam-H"


def test_an_error_leaves_standard_output_empty(hesr: Hesr, tmp_path: Path) -> None:
    answer = hesr("check", tmp_path / "none.fmu", "--json", "-")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith(f"hesr: {tmp_path / 'none.fmu'}")


def test_a_failed_check_still_prints_json(hesr: Hesr, tmp_path: Path) -> None:
    fmu = tmp_path / "none.fmu"
    fmu.write_text("no archive", encoding="utf-8")
    answer = hesr("check", fmu, "--json", "-")
    assert answer.code == 1
    envelope = json.loads(answer.out)
    assert list(envelope) == ["format", "passed", "findings", "result", "files"]
    assert not envelope["passed"]
    assert envelope["findings"][0]["where"] == str(fmu)
    assert envelope["result"][0]["problems"]


def test_an_unwritable_file_is_reported_before_the_run(hesr: Hesr, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    answer = hesr("run", write_study(tmp_path), "--json", tmp_path / "file" / "answer.json")
    assert answer.code == 2
    assert answer.err.startswith(f"hesr: {tmp_path / 'file' / 'answer.json'}: cannot be written")


# --- quiet and verbose ------------------------------------------------------------------------


def test_quiet_prints_nothing_on_success(ran: Run, tmp_path: Path, hesr: Hesr) -> None:
    for command in (
        [*scoring(ran), "--json", tmp_path / "scores.json"],
        ["export", "uf850-table1", "-o", tmp_path / "Friction.fmu"],
        ["fit", "--list"],
    ):
        answer = hesr(*command, "--quiet")
        assert (answer.code, answer.out, answer.err) == (0, "", "")
    assert (tmp_path / "scores.json").is_file()
    assert (tmp_path / "Friction.fmu").is_file()


def test_quiet_still_prints_errors(hesr: Hesr, tmp_path: Path) -> None:
    answer = hesr("export", "none.json", "-o", tmp_path / "Friction.fmu", "--quiet")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("hesr: none.json")


def test_quiet_and_verbose_exclude_each_other(hesr: Hesr) -> None:
    answer = hesr("fit", "--list", "--quiet", "--verbose")
    assert (answer.code, answer.out) == (2, "")
    assert answer.err == OneSentence("hesr: --quiet and --verbose are contradictory")


def test_verbose_logs_steps_with_times(ran: Run) -> None:
    lines = ran.answer.err.splitlines()
    pattern = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [A-Z]+ [a-z_.]+: .")
    assert [line for line in lines if not pattern.match(line)] == []
    for text in ("running the arm: 1 of 1", "fitting laws: 1500 of 1500", "building FMUs: 5 of 5"):
        assert any(line.endswith(text) for line in lines)


def test_verbose_shows_the_origin_of_an_error(hesr: Hesr) -> None:
    answer = hesr("export", "none.json", "-o", "Friction.fmu", "--verbose")
    assert answer.code == 2
    assert "Traceback" in answer.err
    assert answer.err.splitlines()[-1] == hesr("export", "none.json", "-o", "F.fmu").err.strip()


def test_logging_is_restored_after_a_command(hesr: Hesr) -> None:
    before = [(logging.getLogger(n).level, logging.getLogger(n).handlers[:]) for n in ("cosim",)]
    hesr("fit", "--list", "--verbose")
    assert [
        (logging.getLogger(n).level, logging.getLogger(n).handlers[:]) for n in ("cosim",)
    ] == before


# --- progress ---------------------------------------------------------------------------------


def on_a_terminal(*arguments: object) -> str:
    """Output of a command whose standard error is a terminal of 80 columns."""
    pty = pytest.importorskip("pty", reason="pseudo-terminals are for POSIX")
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", "from hesr.cli import main; main()", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=theirs,
        env=os.environ | {"COLUMNS": "80", "TERM": "xterm"},
    )
    os.close(theirs)
    drawn = b""
    while True:
        try:
            part = os.read(ours, 4096)
        except OSError:  # the other side is closed
            part = b""
        if not part:
            break
        drawn += part
    os.close(ours)
    assert process.wait() == 0, drawn.decode()
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", drawn.decode())


@pytest.mark.ci
def test_long_work_shows_progress_and_remaining_time(ran: Run, tmp_path: Path) -> None:
    results = ran.results
    drawn = on_a_terminal(
        *("fit", results / "logs" / "sweep.csv", "--robot", ROBOT),
        *("--rigid-body", results / "rigid_body.json", "--law", "lugre"),
        *("-o", tmp_path / "law.json"),
    )
    assert re.search(r"fitting lugre .* 0% \d:\d\d:\d\d spent, -:--:-- left", drawn)
    assert re.search(r"fitting lugre .* 100%", drawn)
    assert re.search(r"^  .*joint[123], lugre", drawn, re.MULTILINE)  # all jobs at work
    assert not re.search(r"reading logs [^\r\n]*\r?\nfitting lugre", drawn)  # one stage at a time
    # Sentences, such as findings in a log, are not wrapped.
    bars = [line for line in re.split(r"[\r\n]+|\x1b\[[\d;?]*[A-Za-z]", drawn) if "━" in line]
    assert max(map(len, bars)) <= 80


def test_uncountable_work_shows_that_it_is_running(tmp_path: Path) -> None:
    arguments = ("--robot", uf850("uf850.xml"))
    drawn = on_a_terminal("new", tmp_path / "loud", *arguments)
    assert re.search(r"making sample logs .* \d:\d\d:\d\d", drawn)
    assert on_a_terminal("new", tmp_path / "quiet", *arguments, "--quiet") == ""


def test_an_export_counts_its_platforms(hesr: Hesr, tmp_path: Path, empty_cache: Path) -> None:
    answer = hesr(
        *("export", "uf850-table1", "-o", tmp_path / "Friction.fmu", "--verbose"),
        *("--platform", "linux64", "--platform", "win64"),
    )
    assert answer.code == 0
    told = re.findall(r"building Friction\.fmu: (\d) of 2", answer.err)
    assert told == ["0", "1", "2"]


def test_no_progress_is_drawn_into_a_file(tmp_path: Path) -> None:
    answer = hesr_in_a_process("export", "uf850-table1", "-o", tmp_path / "Friction.fmu")
    assert (answer.code, answer.err) == (0, "")


# --- pipes and tables -------------------------------------------------------------------------


def test_tables_fit_80_columns_in_a_pipe(study_run: Run) -> None:
    """All output of a run of the small study and of its evaluation, as piped to `less`."""
    variables = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    printed = [study_run.answer.out]
    for command in ([*scoring(study_run), "--verbose"], ["fit", "--list"]):
        result = subprocess.run(
            [sys.executable, "-c", "from hesr.cli import main; main()", *map(str, command)],
            capture_output=True,
            text=True,
            env=variables,
            check=True,
        )
        printed.append(result.stdout)
    for text in printed:
        # Paths and sentences are not wrapped, so that they can be copied.
        whole = ("  /", "Report:", "FMUs:", "Rigid body:", "joint", "Written:")
        lines = [
            line
            for line in text.splitlines()
            if not line.startswith(whole) and not line.endswith((".", "]"))
        ]
        assert len(lines) > 20
        assert max(map(len, lines)) <= 80
        assert "…" not in text
        assert "\x1b" not in text


def test_a_closed_pipe_is_not_an_error() -> None:
    """As `hesr fit --list | head -1`."""
    process = subprocess.Popen(
        [sys.executable, "-c", "from hesr.cli import main; main()", "fit", "--list"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    process.stdout.close()
    assert process.stderr
    assert "Traceback" not in process.stderr.read()
    process.stderr.close()
    assert process.wait() == 1


def test_an_interrupted_run_counts_what_the_next_one_reuses(tmp_path: Path) -> None:
    results = tmp_path / "results"
    assert _describe_checkpoints(results) == ""
    kept = checkpoint_folder(results)
    (kept / "laws").mkdir(parents=True)
    for name in ("laws/a.json", "laws/b.json", "row.json"):
        (kept / name).write_text("{}", encoding="utf-8")
    said = _describe_checkpoints(results)
    assert said.startswith("2 laws of joints, 1 finished rows")
    assert said.endswith(str(kept))
