"""What a release promises: its interface, its notes, and one version and address in all files.

`interface.txt` has the interface of the last release; `WRITE_INTERFACE=1` writes that of the next.
"""

import os
import re
import tomllib
from pathlib import Path

import yaml
from interface import interface

from hesr_model.support.extras import PUBLISHED

ROOT = Path(__file__).resolve().parents[2]
RECORDED = Path(__file__).with_name("interface.txt")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
WORKFLOWS = {
    path.stem: yaml.safe_load(path.read_text(encoding="utf-8"))
    for path in (ROOT / ".github" / "workflows").glob("*.yml")
}


def notes() -> dict[str, str]:
    """Return the text of each version in the changelog."""
    parts = re.split(r"^## (.+)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_the_interface_breaks_only_as_declared() -> None:
    """A line of the last release may go only if the notes of the next name it in backticks."""
    now = interface()
    if "WRITE_INTERFACE" in os.environ:
        RECORDED.write_text("\n".join(now) + "\n", encoding="utf-8")
    before = RECORDED.read_text(encoding="utf-8").splitlines()
    declared = next(iter(notes().values()))
    gone = [line for line in before if line not in set(now)]
    assert [line for line in gone if f"`{line}`" not in declared] == []
    assert len(before) > 400


def test_each_version_has_notes() -> None:
    assert [name for name, text in notes().items() if not text.strip()] == []


def test_files_agree_on_version_and_address() -> None:
    address = PROJECT["urls"]["Homepage"]
    assert CITATION["version"] == PROJECT["version"]
    assert CITATION["url"] == address
    assert all(url.startswith(address) for url in PROJECT["urls"].values())
    assert CITATION["authors"] == [{"name": a["name"]} for a in PROJECT["authors"]]


def test_only_one_place_says_how_extras_are_installed() -> None:
    """A release turns it; pages refer to the start of the readme."""
    stated = re.compile(r"pip install ['\"]?(?:hesr|\.)\[")
    files = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    for package in ("hesr", "hesr_model", "cosim", "fmu_src"):
        files += [*(ROOT / package).rglob("*.py"), *(ROOT / package).rglob("*.j2")]
    found = [file.name for file in files if stated.search(file.read_text(encoding="utf-8"))]
    assert found == ["extras.py"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert ("pip install hesr " in readme) == PUBLISHED
    assert ("pip install . " in readme) != PUBLISHED


def test_stated_versions_of_python_are_tested() -> None:
    stated = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if "Python :: 3." in c}
    for job in (WORKFLOWS["ci"]["jobs"]["tests"], WORKFLOWS["release"]["jobs"]["try"]):
        assert set(job["strategy"]["matrix"]["python"]) == stated
    assert PROJECT["requires-python"] == f">={min(stated)}"
    assert all(version in (ROOT / ".ci" / "run").read_text(encoding="utf-8") for version in stated)
