"""The provenance of results: input files with their hashes, seed and versions."""

import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from hesr_model.support.files import sha256

_VERSIONED = ("hesr", "numpy", "scipy", "sympy", "pin")


def provenance(*, files: Sequence[Path], seed: int | None = None, **more: Any) -> dict[str, Any]:
    """Return the provenance of a result as JSON data."""
    return {
        "files": [{"name": file.name, "sha256": sha256(file)} for file in files],
        "seed": seed,
        "versions": {"python": platform.python_version(), **{p: version(p) for p in _VERSIONED}},
        **more,
    }


def newest(files: Sequence[Path]) -> str:
    """Return the modification time of the newest file, ISO 8601 in UTC."""
    seconds = max(int(file.stat().st_mtime) for file in files)
    return datetime.fromtimestamp(seconds, tz=UTC).isoformat()
