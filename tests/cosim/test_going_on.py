"""A killed run resumes from its finished parts and gives the results of an uninterrupted one."""

import json
import os
import re
import signal
from pathlib import Path

import pytest
from processes import assert_nothing_runs, started, wait_for
from small_study import write_study

pytestmark = [
    pytest.mark.ci,
    pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX"),
]


def laws(folder: Path) -> dict[str, object]:
    """Laws that the run fitted; the twin's logs have the same rows in every run."""
    found = {}
    for file in sorted((folder / "laws").glob("*.json")):
        data = json.loads(file.read_text(encoding="utf-8"))
        found[file.stem] = data["joints"]
    return found


@pytest.mark.soak
def test_a_killed_run_resumes_with_the_same_results(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    # Fits long enough to report progress.
    text = study.read_text(encoding="utf-8")
    assert "starts = 4\n" in text
    study.write_text(text.replace("starts = 4\n", "starts = 60\n"), encoding="utf-8")
    kept = tmp_path / ".results-unfinished" / "laws"
    command = ("run", study, "--quick", "-o", "results", "--verbose")
    with started(*command, folder=tmp_path) as process:
        wait_for(lambda: len(list(kept.glob("*.json"))) >= 2, process)
        process.send_signal(signal.SIGKILL)
        process.communicate()
    assert_nothing_runs(process.pid)
    assert not list(tmp_path.glob("results/[!.]*"))
    before = {file: file.stat().st_mtime_ns for file in kept.glob("*.json")}
    assert len(before) >= 2
    # A damaged fit is repeated.
    damaged = max(before)
    damaged.write_text("{", encoding="utf-8")
    with started(*command, folder=tmp_path) as process:
        wait_for(lambda: (tmp_path / "results" / "laws").is_dir(), process)
        _, told = process.communicate()
        assert process.returncode == 0, told
    assert not kept.parent.exists()
    # Half a fit counts as a fraction of the whole.
    shares = [int(n) for n in re.findall(r"fitting laws: (\d+) of 900", told)]
    assert shares[-1] == 900
    assert any(share % 100 for share in shares)
    with started(*command[:-3], "-o", "whole", folder=tmp_path) as process:
        process.communicate()
        assert process.returncode == 0
    assert laws(tmp_path / "results") == laws(tmp_path / "whole")
