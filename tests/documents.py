"""The documentation for tests: its code blocks, and a folder for running them."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import hesr_model

ROOT = Path(hesr_model.__file__).parents[1]

PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))

_FENCE = re.compile(r"(?ms)^```(\w+)\n(.*?)^```$")
_NOT_RUN = "not run here"


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    page : file of the block.
    line : its first line.
    language : language given by the fence.
    text : text between the fences.
    runs : False if the preceding paragraph or heading says that it has not been run.
    """

    page: Path
    line: int
    language: str
    text: str
    runs: bool

    def __str__(self) -> str:
        return f"{self.page.name}:{self.line}"


def blocks(language: str) -> list[Block]:
    """All blocks of a language."""
    return [block for page in PAGES for block in _of(page) if block.language == language]


def block(page: str, language: str) -> str:
    """The only block of a language on a page of the documentation."""
    (only,) = (b.text for b in _of(ROOT / "docs" / page) if b.language == language)
    return only


def _of(page: Path) -> Iterator[Block]:
    text = page.read_text(encoding="utf-8")
    for match in _FENCE.finditer(text):
        above = text[: match.start()].rstrip()
        heading = above.rpartition("\n## ")[2].partition("\n")[0]
        yield Block(
            page=page,
            line=text.count("\n", 0, match.start()) + 1,
            language=match[1],
            text=match[2],
            runs=_NOT_RUN not in heading + above.rpartition("\n\n")[2],
        )
