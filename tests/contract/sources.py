"""Source of every module of the product, for tests of its structure."""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import hesr_model

ROOT = Path(hesr_model.__file__).parents[1]

LAYERS = ("hesr_model", "fmu_src", "cosim", "hesr", "hesr.extras")
"""Layers, lowest first. Each may import the layers before it."""

# Scripts for interpreters with an FMI engine but possibly without HESR.
HOSTS = sorted(path.relative_to(ROOT) for path in ROOT.glob("tests/interop/hosts/*.py"))

MODULES = {
    ".".join(path.with_suffix("").parts).removesuffix(".__init__"): path
    for layer in LAYERS[:4]
    for path in sorted(found.relative_to(ROOT) for found in (ROOT / layer).rglob("*.py"))
    if path not in HOSTS
}
"""Path of each module by dotted name."""


def layer(name: str) -> str:
    """Layer of a module or of a dotted name in a module."""
    return max((one for one in LAYERS if f"{name}.".startswith(f"{one}.")), key=len, default="")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse((ROOT / path).read_text(encoding="utf-8"))


def imports(path: Path) -> Iterator[str]:
    """Yield the full names of imported modules, including imports inside functions."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in MODULES else node.module or ""


def top(name: str) -> str:
    return name.partition(".")[0]


def libraries(path: Path) -> set[str]:
    return {top(name) for name in imports(path)}
