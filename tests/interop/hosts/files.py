"""What the Python hosts share: the case they are given and the files that they leave.

The hosts run in an interpreter that has an engine and need not have HESR.
"""

import csv
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def case() -> Any:
    """Return the case, a JSON file that the command line names."""
    return json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))


def leave(
    names: Sequence[str], rows: Iterable[Sequence[float]], seconds: float | None = None
) -> None:
    """Write result.csv, all digits kept, and how long the steps took."""
    with Path("result.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["time", *names])
        table.writerows([repr(float(value)) for value in row] for row in rows)
    if seconds is not None:
        Path("seconds").write_text(repr(seconds), encoding="utf-8")
