"""Any selection of folders of tests can be collected together."""

import ast
from collections import Counter
from pathlib import Path

TESTS = Path(__file__).parents[1]
MODULES = [path for path in sorted(TESTS.rglob("*.py")) if path.name != "conftest.py"]


def test_names_of_modules_are_unique() -> None:
    names = Counter(path.name for path in MODULES)
    assert [name for name, count in names.items() if count > 1] == []


def test_nothing_is_imported_from_a_conftest() -> None:
    importers = [
        path.relative_to(TESTS).as_posix()
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module == "conftest"
    ]
    assert importers == []
