"""User-visible sentences, listed by module in `messages.txt` so that changes show in a diff.

`make messages` writes the file.
"""

import ast
import os
import re
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SNAPSHOT = Path(__file__).with_name("messages.txt")
PACKAGES = ("hesr", "hesr_model", "fmu_src", "cosim")
# Literals that are code, markup or patterns, not sentences.
NOT_PROSE = re.compile(
    r"</?[a-z!]|/>|->|;\n|\(\?|\\[ndsbw(]|^\s*[\[(/#*]|==|&&|\bdouble\b|\breturn\b|[a-z]\(.*\);"
)

FOREIGN = {
    "Input should be": "Pydantic",
    "File name too long": "operating system",
    "failed with status": "FMPy",
    "legal variable name": "FMPy",
    "The step passes": "FMU of a test",
    "integer multiple": "oracle",
}


def literal(node: ast.AST) -> str | None:
    """Return a string with its placeholders as `{name}`, or `{}` for longer expressions."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_part, node.values))
    return None


def _part(part: ast.expr) -> str:
    if isinstance(part, ast.FormattedValue):
        name = ast.unparse(part.value)
        return f"{{{name}}}" if name.replace(".", "_").isidentifier() else "{}"
    return str(ast.literal_eval(part))


def _strings(path: Path) -> Iterator[str]:
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from filter(is_sentence, re.findall(r'"((?:[^"\\\n]|\\.)*)"', source))
        return
    tree = ast.parse(source)
    inner = {
        child
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr | ast.Expr)
        for child in ast.walk(node)
        if child is not node and (isinstance(node, ast.JoinedStr) or child is node.value)
        if isinstance(child, ast.Constant | ast.JoinedStr)
    }
    raised = {c for n in ast.walk(tree) if isinstance(n, ast.Raise) for c in ast.walk(n)}
    for node in ast.walk(tree):
        text = None if node in inner else literal(node)
        if text and is_sentence(text, 2 if node in raised else 3):
            yield text


def is_sentence(text: str, least: int = 3) -> bool:
    words = re.findall(r"(?<!\S)[A-Za-z'(][a-z’'-]*[,.;:)']*(?!\S)", text)
    return len(words) >= least and not NOT_PROSE.search(text)


@cache
def messages() -> dict[str, list[str]]:
    """Sentences by module, in alphabetical order."""
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.*")):
            if path.suffix not in {".py", ".c", ".h"}:
                continue
            texts = {" ".join(t.split()) for t in _strings(path)}
            if texts:
                found[str(path.relative_to(ROOT))] = sorted(texts)
    return found


def listed() -> str:
    parts = (f"# {module}\n" + "\n".join(texts) for module, texts in messages().items())
    return "\n\n".join(parts) + "\n"


def test_the_snapshot_is_up_to_date() -> None:
    if "WRITE_MESSAGES" in os.environ:
        SNAPSHOT.write_text(listed(), encoding="utf-8")
    assert SNAPSHOT.read_text(encoding="utf-8") == listed(), "run `make messages` and read the diff"


def _asserted() -> Iterator[tuple[str, str]]:
    """Patterns of `pytest.raises(.., match=..)` in the tests, with their places."""
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.keyword)
                and node.arg == "match"
                and (text := literal(node.value))
            ):
                yield f"{path.relative_to(ROOT)}:{node.value.lineno}", text


def _pairs(text: str) -> set[str]:
    """Pairs of consecutive words within the fixed parts of a text."""
    parts = re.split(r"\{.*?\}|\.[*+]|\\[^.()*+\[\]]|\[\^?[a-z0-9-]+\]|(?<!\w)'.*?'(?!\w)|\d", text)
    words = [re.findall(r"[a-z]+", part.lower()) for part in parts]
    return {" ".join(pair) for w in words for pair in pairwise(w)}


def test_sentences_asserted_in_tests_are_in_the_snapshot() -> None:
    known = [_pairs(text) for texts in messages().values() for text in texts]
    unknown, asserted = [], 0
    for place, text in _asserted():
        pairs = _pairs(text)
        if len(pairs) < 3 or any(words in text for words in FOREIGN):
            continue
        asserted += 1
        # Places and reasons, joined by colons, may come from different modules.
        clauses = [pairs, *filter(None, map(_pairs, text.split(": ")))]
        if not any(len(c & own) >= min(3, len(c) / 2) for c in clauses for own in known):
            unknown.append((place, text))
    assert asserted > 100
    assert unknown == []
