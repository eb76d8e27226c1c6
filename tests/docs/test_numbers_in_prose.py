"""Numbers in pages, docstrings and comments have a leading zero: 0.06 s."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

from documents import PAGES, ROOT

LAYERS = ("hesr_model", "fmu_src", "cosim", "hesr")
NUMBER = re.compile(r"(?<![^\s(\[±~<>=-])-?\.\d+\b")
"""A number without digits before its point, but no suffix or format."""


def prose_of_page(text: str) -> str:
    """Return a page without blocks of code."""
    return re.sub(r"(?ms)^```.*?^```$", "", text)


def prose_of_module(path: Path) -> Iterator[str]:
    """Yield the docstrings and comments of a module."""
    text = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield str(node.value.value)
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield token.string


def test_the_pattern_finds_numbers_only() -> None:
    assert NUMBER.findall("from .06 s, (.5), -.25 and >= .1") == [".06", ".5", "-.25", ".1"]
    assert NUMBER.findall("0.06 s, law.5, a .fmu, v1.2.3 and `.npz`") == []


def test_pages_have_leading_zeros() -> None:
    wrong = [
        (page.name, number)
        for page in PAGES
        for number in NUMBER.findall(prose_of_page(page.read_text(encoding="utf-8")))
    ]
    assert wrong == []


def test_docstrings_and_comments_have_leading_zeros() -> None:
    modules = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]
    wrong = [
        (str(path.relative_to(ROOT)), number)
        for path in modules
        for text in prose_of_module(path)
        for number in NUMBER.findall(text)
    ]
    assert len(modules) > 300
    assert wrong == []
