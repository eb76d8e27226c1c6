"""Scripts of `.ci`: failed tests that need quiet are repeated, the summary says what failed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

CASE = '<testcase classname="tests.test_it" name="{name}" file="tests/test_it.py" time="1">{body}'
QUIET = '<properties><property name="quiet" value="true"/></properties>'
FAILURE = '<failure message="assert 1 == 2&#10;more">text</failure>'


def report(folder: Path, step: str, **bodies: str) -> None:
    """Write a report of a step with a body for each test."""
    cases = "".join(
        CASE.format(name=name, body=body) + "</testcase>" for name, body in bodies.items()
    )
    text = f"<testsuites><testsuite>{cases}</testsuite></testsuites>"
    (folder / f"{step}.xml").write_text(text, encoding="utf-8")


def run(script: str, *arguments: object, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a script of `.ci`."""
    return subprocess.run(
        [sys.executable, ROOT / ".ci" / script, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | variables,
    )


@pytest.mark.parametrize(
    ("bodies", "code"),
    [
        ({"a": QUIET + FAILURE, "b": ""}, 0),
        ({"a": QUIET + FAILURE, "b": FAILURE}, 1),
        ({"a": QUIET}, 1),  # what has failed the step is not in its report
    ],
)
def test_a_step_may_fail_by_tests_that_need_quiet(
    tmp_path: Path, bodies: dict[str, str], code: int
) -> None:
    report(tmp_path, "rest", **bodies)
    assert run("repeat", tmp_path, "rest").returncode == code


def test_a_step_without_a_report_or_without_time_has_failed(tmp_path: Path) -> None:
    assert run("repeat", tmp_path, "rest").returncode == 1
    (tmp_path / "rest.xml").write_text("<testsuites>", encoding="utf-8")
    assert run("repeat", tmp_path, "rest").returncode == 1
    report(tmp_path, "rest", a=QUIET + FAILURE)
    assert run("repeat", tmp_path, "rest", started="0", LIMIT="5100").returncode == 1


def test_the_summary_lists_failures_with_commands_and_warnings(tmp_path: Path) -> None:
    (tmp_path / "phases.tsv").write_text("1\ttests\t0\t12\n2\trest\t2\t34\n", encoding="utf-8")
    report(tmp_path, "test", loud=QUIET + FAILURE, good="")
    report(tmp_path, "rest", bad=FAILURE)
    report(tmp_path, "repeated", loud=QUIET)
    (tmp_path / "hard.xml").write_text("<testsuites>", encoding="utf-8")
    lines = run("summary", tmp_path, 99).stdout.splitlines()
    assert "1      tests         passed       12" in lines
    assert "2      rest          exit 2       34" in lines
    assert "unreadable report: hard.xml" in lines
    warning = lines.index("- [test] tests/test_it.py::loud")
    failure = lines.index("- [rest] tests/test_it.py::bad")
    assert warning < failure
    assert lines[failure + 1 : failure + 3] == [
        "  assert 1 == 2",
        "  .venv/bin/pytest 'tests/test_it.py::bad'",
    ]
    assert (tmp_path / "summary.txt").read_text(encoding="utf-8").splitlines() == lines
