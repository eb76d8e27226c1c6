"""Public functions and classes are typed for a stranger's script: no error and no Any."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("stranger.py")
STRICT = ("--strict", "--disallow-any-expr", "--no-error-summary")


@pytest.mark.ci
def test_a_script_of_a_stranger_passes_the_strictest_checks(tmp_path: Path) -> None:
    """From a folder of its own, where nothing of HESR's configuration holds."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.read_text(encoding="utf-8"), encoding="utf-8")
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", *STRICT, "--cache-dir", str(tmp_path / "cache"), script],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    # Mappings of JSON data and shapes of arrays contain Any by nature; no expression is one.
    ours = [
        line
        for line in checked.stdout.splitlines()
        if line.startswith("script.py") and "Expression type contains" not in line
    ]
    assert ours == [], "\n".join(ours)
    assert "import-untyped" not in checked.stdout


def test_the_packages_say_that_they_are_typed() -> None:
    root = Path(__file__).parents[2]
    for package in ("hesr", "cosim", "fmu_src", "hesr_model"):
        assert (root / package / "py.typed").is_file()
