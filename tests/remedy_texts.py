"""Texts of the product that print a remedy: a command, an option, or a line of a file."""

import ast
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

_VERBS = (
    "add|adapt|choose|fit|give|identify|leave|list|map|name|needs?|omit|remove|rename|repeat|rerun"
    "|select|set|state|use|write|takes|selects"
)
# Keys and options are quoted or in brackets: 'robot', 'log.columns.t', [limits].
_KEY = r"'[a-z_]+(?:\.[a-z_{}]+)*'|\[[a-z_]+\]"
_KEYS = re.compile(rf"\b(?:{_VERBS})\b[^.;:]*(?:{_KEY})", re.IGNORECASE)
_COMMANDS = re.compile(r"\bhesr (?!\w+')[a-z]+ |'hesr [a-z]+'|(?<![\w-])--[a-z]|\bpip install\b")
_LINES = re.compile(r"\b[a-z_]+ = (?:[\"'\[\d]|true|false)|\baccept=|\bset [A-Z]{3,}")
REMEDIES = (_KEYS, _COMMANDS, _LINES)
_DOCUMENTATION = {"description", "help", "title", "caption", "doc", "summary"}


def read_texts(path: Path) -> Iterator[str]:
    """Yield the texts of a module, with gaps for values; documentation is left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = set(_find_documentation(tree))
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.JoinedStr):
            skipped |= {id(piece) for piece in ast.walk(node)}
            parts = node.values
            yield "".join(str(p.value) if isinstance(p, ast.Constant) else "{}" for p in parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def _find_documentation(tree: ast.Module) -> Iterator[int]:
    """Yield the strings that document code, by their identity."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            yield id(node.value)
        elif isinstance(node, ast.keyword) and node.arg in _DOCUMENTATION:
            yield from (id(piece) for piece in ast.walk(node))


def find_remedies(paths: Iterable[Path]) -> set[str]:
    """Return the sentences of modules that print a command, an option, or a line of a file."""
    texts = {text for path in paths for text in read_texts(path)}
    sentences = {text for text in texts if " " in text and "\n" not in text}
    return {text for text in sentences if any(remedy.search(text) for remedy in REMEDIES)}
