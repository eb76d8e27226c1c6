"""Types of public functions and classes: a user script passes without errors and without Any."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("stranger.py")
STRICT = ("--strict", "--disallow-any-expr", "--no-error-summary")


@pytest.mark.ci
def test_a_user_script_passes_strict_checks(tmp_path: Path) -> None:
    """The script runs from a separate folder, outside HESR's configuration."""
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.read_text(encoding="utf-8"), encoding="utf-8")
    checked = subprocess.run(
        [sys.executable, "-m", "mypy", *STRICT, "--cache-dir", str(tmp_path / "cache"), script],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    # Mappings of JSON data and shapes of arrays contain Any by nature; no expression is Any.
    ours = [
        line
        for line in checked.stdout.splitlines()
        if line.startswith("script.py") and "Expression type contains" not in line
    ]
    assert ours == [], "\n".join(ours)
    assert "import-untyped" not in checked.stdout


def test_the_packages_are_marked_as_typed() -> None:
    root = Path(__file__).parents[2]
    for package in ("hesr", "cosim", "fmu_src", "hesr_model"):
        assert (root / package / "py.typed").is_file()
