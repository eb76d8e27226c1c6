"""Docstrings do not mislead: what they name among parameters and errors exists.

That everything public has one is ruff's to see.
"""

import ast
import builtins
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import cosim
import fmu_src
import hesr_model
from hesr_model import errors

SOURCES = [
    path
    for package in (hesr_model, fmu_src, cosim)
    for path in sorted(Path(package.__file__).parent.rglob("*.py"))
]
Node = ast.ClassDef | ast.FunctionDef


def documented(title: str) -> Iterator[tuple[str, Node, set[str]]]:
    """Classes and functions with such a section, and the names that it describes."""
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, Node):
                text = ast.get_docstring(node) or ""
                section = re.search(rf"(?ms)^{title}\n-+\n(.*?)(?:^\w[\w ]*\n-+\n|\Z)", text)
                heads = re.findall(r"(?m)^(\S.*?)(?: : .*)?$", section[1]) if section else []
                names = {name.strip("* ") for head in heads for name in head.split(",")}
                yield f"{path}:{node.lineno} {node.name}", node, names


def parameters(node: Node) -> set[str]:
    """Of a function, or of what makes objects of a class; its fields among them."""
    own = [n for n in node.body if isinstance(n, ast.FunctionDef)] if _is_class(node) else [node]
    arguments = {a.arg for function in own for a in ast.walk(function) if isinstance(a, ast.arg)}
    return arguments | {ast.unparse(n.target) for n in node.body if isinstance(n, ast.AnnAssign)}


def _is_class(node: Node) -> bool:
    return isinstance(node, ast.ClassDef)


def test_parameters_that_are_described_exist() -> None:
    found = [(place, names, parameters(node)) for place, node, names in documented("Parameters")]
    assert sum(bool(names) for _, names, _ in found) > 100
    assert [(place, names - known) for place, names, known in found if names - known] == []


def test_errors_that_are_described_exist() -> None:
    known = {name for holder in (builtins, errors, np.linalg) for name in vars(holder)}
    known |= {n.name for _, n, _ in documented("Raises") if _is_class(n)} | {"Exit"}  # typer's
    found = [(place, names) for place, _, names in documented("Raises")]
    assert sum(bool(names) for _, names in found) > 100
    last = [(place, {name.rpartition(".")[2] for name in names}) for place, names in found]
    assert [(place, names - known) for place, names in last if names - known] == []
