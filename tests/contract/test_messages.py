"""Sentences that tests assert are those of the product, so that no test waits for an old one."""

import ast
import re
from collections.abc import Iterator
from itertools import pairwise

from sentences import ROOT, literal, sentences

FOREIGN = {
    "Input should be": "Pydantic",
    "File name too long": "operating system",
    "failed with status": "FMPy",
    "legal variable name": "FMPy",
    "The step passes": "FMU of a test",
    "integer multiple": "oracle",
}


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


def test_sentences_asserted_in_tests_are_in_the_product() -> None:
    known = [
        _pairs(text)
        for modules in sentences().values()
        for texts in modules.values()
        for text in texts
    ]
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
