"""Report of the checks of one FMU."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hesr_model.findings import Finding
from hesr_model.support.typed_json import to_json

MOST_PROBLEMS = 1000
"""Largest number of findings per check."""


@dataclass(frozen=True)
class Report:
    """Findings of all checks in one FMU, and reasons for validators that were not run."""

    path: Path
    problems: tuple[Finding, ...]
    skipped: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One-line summary."""
        count = len(self.problems)
        return f"{count} problem{'s' if count > 1 else ''} found." if count else "no problem found."

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {
            "fmu": str(self.path),
            "problems": [to_json(finding) for finding in self.problems],
            "skipped": list(self.skipped),
        }


def problems_of(check: str, texts: Iterable[str]) -> list[Finding]:
    """Return the findings of one check, without repetitions and at most `MOST_PROBLEMS`."""
    kept: dict[str, None] = {}
    more = 0
    for text in texts:
        if len(kept) < MOST_PROBLEMS:
            kept[text] = None
        elif text not in kept:
            more += 1
    problems = [Finding(check=check, found=text) for text in kept]
    if more:
        problems.append(Finding(check=check, found=f"{more} more findings are not listed."))
    return problems
