"""Every sentence with which HESR refuses something is shown in a test with its text.

The sentences are those with which a `HesrError` is made, found in the sources. A test shows one if
a string in it holds words of the sentence that no other sentence has: four in a row, or all of them
where they are fewer. Strings of tests are read as they are and as the regular expressions that they
may be. Nothing is excepted by hand; what has no words of its own (`f"{path}: {error}"`) passes on
what another sentence says.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cosim
import fmu_src
import hesr_model
from hesr_model import errors

ROOT = Path(hesr_model.__file__).parents[1]

WORDS = 4
"""In a row; fewer are in a hundred sentences."""

LETTERS = 10
"""Least length of such a row."""

HOLE = "\0"
"""Stands for what a sentence fills in."""


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """A sentence as the sources have it, with holes."""

    file: Path
    line: int
    text: str
    clause: bool

    def __str__(self) -> str:
        return f"{self.file.relative_to(ROOT)}:{self.line} {self.text.replace(HOLE, '{}')}"

    @property
    def rows(self) -> set[str]:
        """Rows of words between holes by which a test can show the sentence."""
        return {row for part in self.text.split(HOLE) for row in _rows(part)}


def _rows(part: str) -> Iterator[str]:
    words = part.strip(" :;,'\"()").split()
    count = min(WORDS, len(words))
    for k in range(len(words) - count + 1):
        row = " ".join(words[k : k + count])
        if count and len(row) >= LETTERS:
            yield row


def text_of(node: ast.AST) -> str | None:
    """The text of a string that is written in place, with holes; None for anything else."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(v.value) if isinstance(v, ast.Constant) else HOLE for v in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        parts = [text_of(node.left), text_of(node.right)]
        return None if parts == [None, None] else "".join(p or HOLE for p in parts)
    return None


def parsed(folder: Path) -> dict[Path, ast.Module]:
    return {
        file: ast.parse(file.read_text(encoding="utf-8")) for file in sorted(folder.rglob("*.py"))
    }


@cache
def sources() -> dict[Path, ast.Module]:
    folders = [Path(package.__file__).parent for package in (hesr_model, fmu_src, cosim)]
    return {file: tree for folder in folders for file, tree in parsed(folder).items()}


@cache
def error_classes() -> frozenset[str]:
    """`HesrError` and all that derive from it."""
    known = {name for name, value in vars(errors).items() if isinstance(value, type)}
    classes = [
        n for tree in sources().values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)
    ]
    while more := {c.name for c in classes if {ast.unparse(b) for b in c.bases} & known} - known:
        known |= more
    return frozenset(known)


def written(node: ast.AST, tree: ast.Module) -> Iterator[str]:
    """Texts that an argument stands for: its own, those of a variable, those a function returns."""
    text = text_of(node)
    if text is not None:
        yield text
    elif isinstance(node, ast.IfExp):
        yield from written(node.body, tree)
        yield from written(node.orelse, tree)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        for function in ast.walk(tree):
            if isinstance(function, ast.FunctionDef) and function.name == node.func.id:
                for found in ast.walk(function):
                    if isinstance(found, ast.Return) and found.value is not None:
                        yield from written(found.value, tree)
    elif isinstance(node, ast.Name):
        for found in ast.walk(tree):
            if isinstance(found, ast.Assign) and node.id in map(ast.unparse, found.targets):
                yield from written(found.value, tree)


@cache
def sentences() -> tuple[Sentence, ...]:
    """Every sentence once, with the place where it stands first."""
    found = {}
    for file, tree in sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in error_classes():
                for argument in node.args[:1]:
                    for text in written(argument, tree):
                        own = ast.unparse(node.func) not in vars(errors)
                        found.setdefault(
                            text, Sentence(file=file, line=node.lineno, text=text, clause=own)
                        )
    return tuple(found.values())


@cache
def shown() -> str:
    """All strings of the tests but those of this file, as they are and without escapes."""
    texts = []
    for file, tree in parsed(ROOT / "tests").items():
        if file != Path(__file__):
            texts += [t for node in ast.walk(tree) if (t := text_of(node)) is not None]
    plain = [re.sub(r"\\([^\w\s])", r"\1", text) for text in texts]
    return "\n".join(" ".join(text.split()) for text in dict.fromkeys(texts + plain))


def own_rows(sentence: Sentence) -> set[str]:
    """Rows that no other sentence has; all of them, where it has none of its own."""
    return {row for row in sentence.rows if _counts()[row] == 1} or sentence.rows


@cache
def _counts() -> Counter[str]:
    return Counter(row for sentence in sentences() for row in sentence.rows)


def test_the_search_finds_the_sentences() -> None:
    assert len(sentences()) > 200
    assert len({s.file for s in sentences()}) > 50
    assert {"ConfigError", "LogError", "FitError"} < error_classes()


def test_every_sentence_is_shown_in_a_test() -> None:
    missing = [
        str(sentence)
        for sentence in sentences()
        if sentence.rows and not any(row in shown() for row in own_rows(sentence))
    ]
    assert missing == []


def test_every_sentence_is_one_line_and_ends() -> None:
    """Errors that a module derives for itself may carry a clause, which their catcher completes."""
    for sentence in sentences():
        assert "\n" not in sentence.text, str(sentence)
        if sentence.rows and not sentence.clause:
            assert sentence.text.endswith((".", HOLE)), str(sentence)


def test_every_error_says_something() -> None:
    """An error is made with a text, or passes on that of another."""
    silent = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for file, tree in sources().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        and ast.unparse(node.func) in error_classes()
        and not (node.args and any(True for _ in written(node.args[0], tree)))
    ]
    assert silent == []
