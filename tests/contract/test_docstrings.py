"""Consistency of docstrings: the parameters, errors and names in them exist.

Ruff checks that every public object has a docstring.
"""

import ast
import builtins
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np

import cosim
import fmu_src
import hesr
import hesr_model
from hesr_model import errors

SOURCES = [
    path
    for package in (hesr_model, fmu_src, cosim, hesr)
    for path in sorted(Path(package.__file__).parent.rglob("*.py"))
]
Node = ast.ClassDef | ast.FunctionDef
# Example names that are generated or come from other libraries.
FOREIGN = {"q1", "q2", "a_0", "theta1_dq", "der", "R7", "ParfamH", "__dir__", "__getattr__"}


@cache
def trees() -> dict[Path, ast.Module]:
    """Return every module, parsed."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


def documented() -> Iterator[tuple[Path, Node, str]]:
    """Yield classes and functions with their docstrings."""
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, Node) and (text := ast.get_docstring(node)):
                yield path, node, text


def described(text: str, title: str) -> set[str]:
    """Return the names described in a section of a docstring."""
    section = re.search(rf"(?ms)^{title}\n-+\n(.*?)(?:^\w[\w ]*\n-+\n|\Z)", text)
    heads = re.findall(r"(?m)^(\S.*?)(?: : .*)?$", section[1]) if section else []
    return {name.strip("* ") for head in heads for name in head.split(",")}


def parameters(node: Node) -> set[str]:
    """Return the parameters of a function, or of a class's methods together with its fields."""
    own = [n for n in node.body if isinstance(n, ast.FunctionDef)] if _is_class(node) else [node]
    arguments = {a.arg for function in own for a in ast.walk(function) if isinstance(a, ast.arg)}
    return arguments | {ast.unparse(n.target) for n in node.body if isinstance(n, ast.AnnAssign)}


def words(tree: ast.AST) -> set[str]:
    """Return the words in the code of a module, including strings except docstrings."""
    docstrings = {
        id(n.body[0].value)
        for n in ast.walk(tree)
        if isinstance(n, Node | ast.Module)
        and ast.get_docstring(n)
        and isinstance(n.body[0], ast.Expr)
    }
    texts = []
    for node in ast.walk(tree):
        if id(node) not in docstrings:
            texts += [v for _, v in ast.iter_fields(node) if isinstance(v, str)]
    return set(re.findall(r"\w+", " ".join(texts)))


def _is_class(node: Node) -> bool:
    return isinstance(node, ast.ClassDef)


def test_described_parameters_exist() -> None:
    found = [
        (f"{path}:{node.lineno}", described(text, title) - known)
        for path, node, text in documented()
        for title, known in (("Parameters", parameters(node)), ("Attributes", words(node)))
    ]
    assert [(place, unknown) for place, unknown in found if unknown] == []


def test_names_in_docstrings_exist() -> None:
    """Each name is a word of its module or defined elsewhere."""
    defined = set(FOREIGN)
    for tree in trees().values():
        nodes = list(ast.walk(tree))
        defined |= {n.name for n in nodes if isinstance(n, Node)}
        defined |= {n.arg for n in nodes if isinstance(n, ast.arg)}
        defined |= {ast.unparse(n.target) for n in nodes if isinstance(n, ast.AnnAssign)}
        defined |= {ast.unparse(n.targets[0]) for n in tree.body if isinstance(n, ast.Assign)}
        # Names of options and variables.
        texts = [n.value for n in nodes if isinstance(n, ast.Constant)]
        defined |= {text for text in texts if isinstance(text, str) and text.isidentifier()}
    for path in Path(fmu_src.__file__).parent.rglob("*.[ch]"):
        defined |= set(re.findall(r"\w+", path.read_text(encoding="utf-8")))
    of_module = {path: words(tree) for path, tree in trees().items()}
    named = 0
    unknown = []
    for path, node, text in documented():
        names = set(re.findall(r"`([A-Za-z_]\w*)`", text))
        named += len(names)
        unknown += [f"{path}:{node.lineno} {n}" for n in names - of_module[path] - defined]
    assert named > 500
    assert unknown == []


def test_described_errors_exist() -> None:
    known = {name for holder in (builtins, errors, np.linalg) for name in vars(holder)}
    known |= {n.name for _, n, _ in documented() if _is_class(n)} | {"Exit"}  # from typer
    found = []
    for path, node, text in documented():
        names = described(text, "Raises") | set(re.findall(r"\b[A-Z]\w*Error\b", text))
        found += [(f"{path}:{node.lineno}", name.rpartition(".")[2]) for name in names]
    assert len(found) > 100
    assert [(place, name) for place, name in found if name not in known] == []
