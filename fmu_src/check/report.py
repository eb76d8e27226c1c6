"""What a check says: problems, validators that were not run, and how both are worded."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MOST_PROBLEMS = 1000
"""Of one check; an FMU with more has them for one and the same reason."""


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong.

    Attributes
    ----------
    check : name of the check that found it.
    text : one sentence that names the variable or the file.
    """

    check: str
    text: str


@dataclass(frozen=True)
class Report:
    """What all checks found in one FMU.

    Attributes
    ----------
    path : the FMU.
    problems : in the order of the checks.
    skipped : one sentence for each validator that was not run, saying why.
    """

    path: Path
    problems: tuple[Problem, ...]
    skipped: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One line."""
        count = len(self.problems)
        return f"{count} problem{'s' if count > 1 else ''} found." if count else "no problem found."

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {
            "fmu": str(self.path),
            "problems": [{"check": p.check, "text": p.text} for p in self.problems],
            "skipped": list(self.skipped),
        }


def problems_of(check: str, texts: Iterable[str]) -> list[Problem]:
    """Return the problems of one check, the same one once and not more than a reader can use."""
    kept: dict[str, None] = {}
    more = 0
    for text in texts:
        if len(kept) < MOST_PROBLEMS:
            kept[text] = None
        elif text not in kept:
            more += 1
    problems = [Problem(check, text) for text in kept]
    if more:
        problems.append(Problem(check, f"{more} more problems of this check are not listed."))
    return problems
