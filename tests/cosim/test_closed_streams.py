"""Closed standard streams, and readers that have gone."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from processes import COMMAND

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a shell closes the streams")

LIST = ("fit", "--list")


def run_in_shell(redirections: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command whose streams a shell has redirected."""
    return subprocess.run(
        ["sh", "-c", f'"$@" {redirections}', "sh", sys.executable, *COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "redirections",
    [
        ">&-",
        pytest.param("2>&-", marks=pytest.mark.ci),
        pytest.param("<&- >&- 2>&-", marks=pytest.mark.ci),
    ],
)
def test_a_command_with_closed_streams_does_its_work(redirections: str, tmp_path: Path) -> None:
    """A file that it opens must not take the number of a stream, and receive its text."""
    result = run_in_shell(redirections, *LIST, "--json", tmp_path / "laws.json")
    assert (result.returncode, result.stderr) == (0, "")
    assert json.loads((tmp_path / "laws.json").read_text(encoding="utf-8"))["format"]


@pytest.mark.ci
def test_a_refusal_needs_no_open_stream(tmp_path: Path) -> None:
    result = run_in_shell("2>&-", "export", tmp_path / "missing.json", "-o", tmp_path / "a.fmu")
    assert (result.returncode, result.stdout, result.stderr) == (2, "", "")


@pytest.mark.ci
def test_a_reader_that_has_gone_ends_a_command_quietly(tmp_path: Path) -> None:
    """What was written stays."""
    file = tmp_path / "laws.json"
    process = subprocess.Popen(
        [sys.executable, *COMMAND, *LIST, "--json", str(file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout
    assert process.stderr
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 1
    assert file.is_file()
