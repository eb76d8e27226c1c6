"""Skips fail in CI unless they are listed, and failures that need quiet are repeated."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import skips

ROOT = Path(__file__).parents[2]

TESTS = """
import pytest

def test_tool():
    pytest.skip("gcc is not installed")

@pytest.mark.skipif(True, reason="root may write anywhere")
def test_root():
    pass

@pytest.mark.xfail(reason="gcc is not installed", strict=True)
def test_known():
    assert False
"""


# Fails the first time, as a test that another process disturbs.
DISTURBED = """
from pathlib import Path
import pytest

@pytest.mark.quiet
def test_disturbed():
    mark = Path("repeated")
    mark.touch() if not mark.exists() else mark.write_text("passed")
    assert mark.read_text() == "passed"

def test_steady():
    pass
"""


def run_tests(folder: Path, tools: str) -> str:
    program = (
        f"import os, sys; sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        f"os.environ['ALL_TOOLS'] = {tools!r}\n"
        "import pytest, ci_reports\n"
        "options = ['-q', '-p', 'no:cacheprovider', '-W', 'ignore', '--confcutdir=.']\n"
        "pytest.main([*options, 'test_it.py'], plugins=[ci_reports])"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=folder, check=False
    )
    return ended.stdout


@pytest.mark.parametrize("workers", ["0", "2"])
def test_a_failure_that_needs_quiet_is_known_from_the_report(tmp_path: Path, workers: str) -> None:
    (tmp_path / "test_it.py").write_text(DISTURBED, encoding="utf-8")
    report = tmp_path / "out" / "rest.xml"
    options = (f"--junitxml={report}", "-o", "junit_family=xunit1")
    parallel = ("-p", "xdist", "-n", workers, "-p", "ci_reports") if workers != "0" else ()
    environment = os.environ | {"PYTHONPATH": str(ROOT / "tests"), "ALL_TOOLS": "false"}
    subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "ci_reports", *options, *parallel, "test_it.py"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        check=False,
    )
    repeat = [sys.executable, str(ROOT / ".ci" / "repeat"), str(report.parent), "rest"]
    ended = subprocess.run(repeat, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, (ended.stderr, report.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("tools", "outcome"), [("true", "1 failed"), ("false", "2 skipped")])
def test_a_skip_for_a_missing_tool_fails_in_ci(tmp_path: Path, tools: str, outcome: str) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    last = run_tests(tmp_path, tools).splitlines()[-1]
    assert outcome in last
    assert "1 xfailed" in last


def test_reasons_are_those_of_the_list() -> None:
    for reason in (
        "needs hesr[mutation]",
        "the measured log is not next to the repository, at ../x.csv",
        "its solver takes minutes for this law: `make soak` runs it",
    ):
        assert skips.refusal_of(("test_it.py", 3, f"Skipped: {reason}")) is None
    refusal = skips.refusal_of(("test_it.py", 3, "Skipped: valgrind is not installed"))
    assert refusal is not None
    assert "valgrind is not installed" in refusal
