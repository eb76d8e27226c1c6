"""docs/architecture.md names today's folders, files and definitions.

tests/docs/test_inline_code.py looks for words anywhere in the sources; here they must be defined.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache

import pytest
from sources import MODULES, ROOT, tree

TEXT = (ROOT / "docs/architecture.md").read_text(encoding="utf-8")
SPANS = sorted({" ".join(span.split()) for span in re.findall(r"`([^`]+)`", TEXT)})
EXAMPLES = {"sweep.csv"}
"""Files of a user."""


def defined_names(name: str) -> Iterator[str]:
    """Yield the classes, functions, arguments, fields and constants of a module."""
    for node in ast.walk(tree(MODULES[name])):
        match node:
            case ast.ClassDef() | ast.FunctionDef():
                yield node.name
            case ast.arg():
                yield node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.id


@cache
def definitions() -> set[str]:
    """Return the names that the product defines, and its folders and those of the tests."""
    names = {name for module in MODULES for name in defined_names(module)}
    names |= {part for path in MODULES.values() for part in path.with_suffix("").parts}
    names |= {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    for path in (ROOT / "fmu_src/c").iterdir():
        text = path.read_text(encoding="utf-8")
        names |= set(re.findall(r"(?m)^(?! )(?:FMI[23]_STATUS\(|[\w *()]*?\b)(\w+)[()]", text))
    return names


def is_defined(span: str) -> bool:
    names = re.sub(r"\(\w+\)$", "", span).split(".")
    return set(names) <= definitions()


def test_names_are_defined() -> None:
    names = [span for span in SPANS if re.fullmatch(r"[A-Za-z_][\w.]*(\(\w+\))?", span)]
    assert [name for name in names if not (is_file(name) or is_defined(name))] == []
    assert {"Log.parts", "fmi2DoStep", "FrictionRecord"} <= {*names}


def is_file(span: str) -> bool:
    return bool(re.search(r"\.(c|h|py|toml|csv)$", span))


def test_files_exist() -> None:
    generated = {
        node.value
        for path in MODULES.values()
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value[-2:] == ".h"
    }
    files = [span for span in SPANS if is_file(span) and " " not in span]
    wrong = [
        span
        for span in files
        if span not in generated | EXAMPLES
        and not (list(ROOT.glob(span)) or list((ROOT / "hesr_model").rglob(span)))
        and not list((ROOT / "fmu_src").rglob(span))
    ]
    assert wrong == []
    assert len(files) > 60


@pytest.mark.parametrize("layer", ["cosim", "fmu_src", "hesr_model"])
def test_layers_list_their_folders(layer: str) -> None:
    row = re.search(rf"(?m)^    {layer}/ +(.*(?:\n {{10,}}.*)*)", TEXT)
    assert row is not None
    listed = set(re.split(r"[;,]\s+", row[1]))
    folders = {path.name for path in (ROOT / layer).iterdir() if any(path.glob("*.[pc]*"))}
    assert listed == folders - {"__pycache__"}


def test_targets_of_make_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = set(re.findall(r"(?m)^([\w-]+):", makefile))
    named = {span.removeprefix("make ") for span in SPANS if span.startswith("make ")}
    assert named
    assert named <= targets
