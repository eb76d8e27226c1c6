"""Skips fail in CI unless they are listed."""

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


@pytest.mark.parametrize(("tools", "outcome"), [("true", "1 failed"), ("false", "2 skipped")])
def test_a_skip_for_a_missing_tool_fails_in_ci(tmp_path: Path, tools: str, outcome: str) -> None:
    (tmp_path / "test_it.py").write_text(TESTS, encoding="utf-8")
    program = (
        f"import os, sys; sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        f"os.environ['ALL_TOOLS'] = {tools!r}\n"
        "import pytest, ci_reports\n"
        "options = ['-q', '-p', 'no:cacheprovider', '-W', 'ignore', '--confcutdir=.']\n"
        "pytest.main([*options, 'test_it.py'], plugins=[ci_reports])"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    last = ended.stdout.splitlines()[-1]
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
