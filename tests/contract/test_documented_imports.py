"""What pages and notebooks show comes from `import hesr`, and exists there."""

import ast
import doctest
import json
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from sources import ROOT

import hesr

INTERNAL = ("hesr_model", "fmu_src", "cosim")
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "docs/**/*.ipynb", "models/**/*.md", "models/**/*.py")
    for path in ROOT.glob(pattern)
)
FENCE = re.compile(r"(?ms)^ *(`{3,}|~{3,})\s*\{?([\w-]+)[^\n]*\n(.*?)^ *\1")
PYTHON = ("python", "py", "python3", "ipython3", "pycon", "code-cell", "code-block")
IMPORT = re.compile(
    r"^\s*(?:[\w.\\/-]*python\d? -c ['\"])?(?:from|import)\s+([\w.]+)", re.MULTILINE
)


def read_code(path: Path) -> Iterator[str]:
    """Yield the Python code that a document shows."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        yield text
    elif path.suffix == ".ipynb":
        for cell in json.loads(text)["cells"]:
            if cell["cell_type"] == "code":
                yield re.sub(r"(?m)^[%!].*$", "", "".join(cell["source"]))
    else:
        yield from (code for _, language, code in FENCE.findall(text) if language in PYTHON)


def find_internal_names(code: str) -> set[str]:
    """Return the modules and attributes of HESR in code that `import hesr` does not have."""
    if ">>> " in code:
        code = "".join(example.source for example in doctest.DocTestParser().get_examples(code))
    used: set[str] = set()
    for node in ast.walk(ast.parse(code)):
        match node:
            case ast.Import(names=names):
                used |= {name.name for name in names}
            case ast.ImportFrom(module=str(module), names=names):
                used |= {f"{module}.{name.name}" for name in names}
            case ast.Attribute(value=ast.Name(id="hesr"), attr=name):
                used.add(f"hesr.{name}")
    return {name for name in used if not is_public(name)}


@cache
def public_names() -> frozenset[str]:
    return frozenset({"hesr", "hesr.*", *(f"hesr.{name}" for name in dir(hesr))})


def is_public(name: str) -> bool:
    """Return whether a name is of another package, or in `import hesr`."""
    package = name.partition(".")[0]
    return package not in (*INTERNAL, "hesr") or name in public_names()


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_documents_use_public_names(path: Path) -> None:
    internal = [find_internal_names(code) for code in read_code(path)]
    assert set().union(*internal) == set()
    # Also in code that no fence calls Python.
    modules = IMPORT.findall(path.read_text(encoding="utf-8"))
    assert [name for name in modules if name.startswith((*INTERNAL, "hesr."))] == []


def test_notebooks_and_pages_are_read() -> None:
    using = {p.name for p in DOCUMENTS if any("import hesr" in code for code in read_code(p))}
    pages = {"tutorial.ipynb", "README.md", "api.md", "robots.md", "add-a-law.md"}
    gallery = {path.name for path in (ROOT / "docs" / "gallery").glob("*.md")}
    assert len(gallery) >= 5
    assert pages | gallery <= using


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("from fmu_src import model_file", {"fmu_src.model_file"}),
        ("import hesr\nimport hesr_model.laws.lugre as laws", {"hesr_model.laws.lugre"}),
        ("from hesr.extras.sweep.job import run_sweep", {"hesr.extras.sweep.job.run_sweep"}),
        ("import hesr\nhesr.fitt(1)\nhesr.fit(1)", {"hesr.fitt"}),
        (">>> from cosim import regressor\n>>> import numpy\n", {"cosim.regressor"}),
        ("from hesr import Log, Estimate\nimport numpy.random", {"hesr.Estimate"}),
    ],
)
def test_internal_names_are_found(code: str, found: set[str]) -> None:
    assert find_internal_names(code) == found


def test_code_is_read_from_every_kind_of_fence(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```python\na = 1\n```\n```{code-cell} ipython3\nb = 2\n```\n```text\nc\n```\n"
        "~~~pycon\n>>> d\n~~~\n```{code-block} python\ne = 5\n```\n"
    )
    assert list(read_code(page)) == ["a = 1\n", "b = 2\n", ">>> d\n", "e = 5\n"]
    assert IMPORT.findall("    import cosim.loop\nthe import fmu_src\nfrom x import y\n") == [
        "cosim.loop",
        "x",
    ]
