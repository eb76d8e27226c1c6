"""Shared parts of the Python hosts: reading the case and writing the results.

The hosts run in an interpreter that has an engine but not necessarily HESR.
"""

import csv
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def case() -> Any:
    """Return the case from the JSON file named on the command line."""
    return json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))


def leave(
    names: Sequence[str], rows: Iterable[Sequence[float]], seconds: float | None = None
) -> None:
    """Write result.csv with all digits, and the duration of the steps."""
    with Path("result.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time", *names])
        table.writerows([repr(float(value)) for value in row] for row in rows)
    if seconds is not None:
        Path("seconds").write_text(repr(seconds), encoding="utf-8")
