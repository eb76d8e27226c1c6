"""Names, attributes and arguments of the tutorial and the gallery exist; the pages do not run."""

import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from documents import ROOT

DOCS = ROOT / "docs"
# Pages omit guards for what is known there, such as a velocity that a log has.
LEFT_OUT = ("arg-type", "union-attr")


def write_cells(folder: Path) -> list[Path]:
    """Write the code of each page as a module."""
    codes = {}
    for page in DOCS.glob("gallery/*.md"):
        cells = re.findall(
            r"```\{code-cell\}[^\n]*\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL
        )
        codes[page.stem] = cells
    notebook = nbformat.read(DOCS / "tutorial.ipynb", as_version=4)
    codes["tutorial"] = [cell.source for cell in notebook.cells if cell.cell_type == "code"]
    files = []
    for name, cells in codes.items():
        assert len(cells) > 2, name
        path = folder / f"{name.replace('-', '_')}.py"
        path.write_text("\n".join(cells), encoding="utf-8")
        files.append(path)
    return files


@pytest.mark.ci
def test_the_code_of_pages_has_no_error_of_names_or_arguments(tmp_path: Path) -> None:
    settings = tmp_path / "mypy.ini"
    settings.write_text("[mypy]\nignore_missing_imports = true\n", encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", str(settings)]
    command += [f"--disable-error-code={code}" for code in LEFT_OUT]
    files = write_cells(tmp_path)
    done = subprocess.run(
        [*command, *map(str, files)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
