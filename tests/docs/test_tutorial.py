"""The tutorial notebook runs unchanged in `make docs` and is stored without outputs."""

import re

import nbformat
import pytest
from documents import ROOT

NOTEBOOK = ROOT / "docs" / "tutorial.ipynb"
EXECUTED = ROOT / "jupyter_execute" / "docs" / "tutorial.ipynb"


def notebook() -> nbformat.NotebookNode:
    return nbformat.read(NOTEBOOK, as_version=4)


def code_cells(book: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [cell for cell in book.cells if cell.cell_type == "code"]


def test_the_notebook_has_no_outputs() -> None:
    book = notebook()
    nbformat.validate(book)
    assert len(code_cells(book)) > 10
    for cell in code_cells(book):
        assert not cell.outputs
        assert cell.execution_count is None
        assert not cell.metadata
    assert set(book.metadata) == {"kernelspec", "language_info"}
    assert set(book.metadata.kernelspec) == {"display_name", "language", "name"}


def test_the_notebook_has_no_machine_paths() -> None:
    for cell in notebook().cells:
        assert not re.search(r"(?<![\w.)\]}])/\w+/|~/|\b[A-Z]:[\\/]", cell.source), cell.source


@pytest.mark.skipif(not EXECUTED.exists(), reason="make docs has not executed the notebook")
def test_the_notebook_runs_and_draws() -> None:
    book = nbformat.read(EXECUTED, as_version=4)
    outputs = [output for cell in code_cells(book) for output in cell.outputs]
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    assert len(pictures) == NOTEBOOK.read_text(encoding="utf-8").count("plt.show()")
    said = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    assert not [o for o in outputs if o.output_type == "stream" and o.name == "stderr"]
    errors = {
        line.split()[0]: [float(figure) for figure in line.split()[1:]]
        for line in said.splitlines()
        if re.match(r"(stribeck|lugre|parfam_\w+)( +\d+\.\d+){3}$", line)
    }
    assert set(errors) == {"stribeck", "lugre", "parfam_h", "parfam_hx"}
    for law in ("lugre", "parfam_h", "parfam_hx"):
        assert all(a < b for a, b in zip(errors[law], errors["stribeck"], strict=True))
