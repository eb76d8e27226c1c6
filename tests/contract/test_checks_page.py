"""The page of checks lists each hypothesis of the code, and each with its alternatives."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from documents import ROOT

import hesr_model.health

PAGE = ROOT / "docs" / "checks.md"
NAME = re.compile(r"`([a-z]+(?:-[a-z]+)*)`")


def read_checks() -> set[str]:
    """Return the names of checks that hypotheses and mistakes have."""
    names = set()
    for path in Path(hesr_model.health.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
                continue
            values = [keyword.value for keyword in node.keywords if keyword.arg == "check"]
            if node.func.id == "Mistake":
                values += node.args[:1]
            names |= {
                value.value
                for value in values
                if isinstance(value, ast.Constant) and isinstance(value.value, str)
            }
    return names


def read_table(header: str) -> Iterator[list[str]]:
    """Yield the cells of each row of the table with a header."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    first = lines.index(header) + 2
    for line in lines[first:]:
        if not line.startswith("|"):
            return
        yield [cell.strip() for cell in line.strip("|").split("|")]


def test_the_table_of_checks_is_complete() -> None:
    checks = read_checks()
    assert len(checks) > 40
    listed = {
        name for row in read_table("| check | compares | finds |") for name in NAME.findall(row[0])
    }
    assert listed == checks


def test_each_hypothesis_has_its_alternatives() -> None:
    rows = list(read_table("| hypothesis | alternatives | cannot tell if |"))
    listed = {name for row in rows for name in NAME.findall(row[0])}
    assert read_checks() - listed == set()
    assert listed - read_checks() == set()
    assert [row[0] for row in rows if not row[1]] == []
