"""Tests compare codes, places and values; they do not repeat sentences of the product.

A repeated sentence must be edited with each change of wording, and protects no user. Compare the
code, place and key of a refusal, or the value or name that a sentence must mention: with `in`,
`match=` or `Containing`.
"""

import ast
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from itertools import chain, pairwise
from pathlib import Path

import pytest
from sentences import ROOT, literal, sentences

TESTS = ROOT / "tests"
MOST_WORDS = 6
"""Longest run of a product's words that a test may repeat."""

MOST_VALUES = 6
"""Most words of a value that a sentence contains."""

VALUE = ""
"""Stands for the placeholder of a sentence, and for a value or wildcard of a test."""

PLACEHOLDER = re.compile(r"\{[^{} ]*\}|\.[*+]\??")
EXEMPT = {
    "fmu/modelica/test_modelica_package.py": "generated Modelica",
    "fmu/plant/test_plant_states.py": "a program in C, which calls the functions it compares",
    "fmu/test_modelica_printer.py": "a pattern of generated Modelica",
}


def words(text: str) -> list[str]:
    """Return lower-case words without punctuation, and `VALUE` for each placeholder."""
    unescaped = re.sub(r"\\(.)", r"\1", text)
    found = []
    for word in PLACEHOLDER.sub("\0", unescaped).split():
        if "\0" in word:
            found.append(VALUE)
        elif plain := word.strip("'\"`.,:;()[]?!^$|").lower():
            found.append(plain)
    return found


def runs(sentence: list[str]) -> Iterator[tuple[str, ...]]:
    """Yield the shortest runs that are too long, which begin and end with a word."""
    places = [place for place, word in enumerate(sentence) if word != VALUE]
    for first, last in zip(places, places[MOST_WORDS:], strict=False):
        yield tuple(sentence[first : last + 1])


Runs = dict[tuple[str, str], set[tuple[str, ...]]]


def by_beginning(sentences_of_product: Iterable[str]) -> Runs:
    """Return the runs of sentences by their first two words."""
    found: Runs = defaultdict(set)
    for sentence in sentences_of_product:
        for run in runs(words(sentence)):
            found[run[0], run[1]].add(run)
    return found


@pytest.fixture(scope="module")
def product() -> Runs:
    modules = [texts for kind in sentences().values() for texts in kind.values()]
    return by_beginning(chain.from_iterable(modules))


def begins(text: list[str], place: int, run: tuple[str, ...]) -> bool:
    """Tell whether a run, some of whose words are any values, begins at a place of a text."""
    for k, word in enumerate(run):
        if word == VALUE:
            return any(begins(text, place + n, run[k + 1 :]) for n in range(1, MOST_VALUES + 1))
        if place >= len(text) or text[place] != word:
            return False
        place += 1
    return True


def repeated(text: str, product: Runs) -> str:
    """Return a run of words of the product that a text repeats, or an empty text."""
    found = words(text)
    for place, pair in enumerate(pairwise(found)):
        for key in (pair, (pair[0], VALUE)):
            for run in product.get(key, ()):
                if begins(found, place, run):
                    return " ".join(word or "{}" for word in run)
    return ""


def strings(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each literal, without docstrings."""
    source = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield from enumerate(source.splitlines(), 1)
        return
    tree = ast.parse(source)
    skipped = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            skipped.update(set(ast.walk(node)) - {node})
        if isinstance(node, ast.Expr):
            skipped.add(node.value)
    for node in ast.walk(tree):
        text = None if node in skipped else literal(node)
        if text:
            yield getattr(node, "lineno", 0), text


@pytest.mark.ci
def test_tests_do_not_repeat_sentences(product: Runs) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {run}"
        for path in sorted(TESTS.rglob("*.*"))
        if path.suffix in {".py", ".txt", ".yml"} and str(path.relative_to(TESTS)) not in EXEMPT
        for line, text in strings(path)
        if (run := repeated(text, product))
    ]
    assert not found, "\n".join(found)


@pytest.mark.ci
@pytest.mark.parametrize("path", EXEMPT)
def test_exempt_files_need_to_be(path: str, product: Runs) -> None:
    assert any(repeated(text, product) for _, text in strings(TESTS / path))


SENTENCE = "'{name}' cannot be varied: its FMU calculates {} of it at {time:g} s."


@pytest.mark.parametrize(
    ("text", "is_repeated"),
    [
        ("'a.y' cannot be varied: its FMU calculates", False),
        ("'a.y' cannot be varied: its FMU calculates most of it at", True),
        (r"varied: its FMU calculates .* of it at 0\.1 s", True),
        ("its FMU calculates the values of all its outputs, each of it at 1 s", False),
        ("its FMU; calculates of it", False),
    ],
)
def test_a_repeated_sentence_is_found(text: str, is_repeated: bool) -> None:
    assert bool(repeated(text, by_beginning([SENTENCE]))) == is_repeated
