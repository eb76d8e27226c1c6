"""What the checks of a run found, saved beside its results so that the report says it again."""

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hesr_model.findings import Finding
from hesr_model.support.typed_json import from_json, read_json, to_json, write_json

HEALTH, HEALTH_FORMAT = "health.json", "hesr-health-1"


@dataclass(frozen=True, kw_only=True)
class _File:
    findings: tuple[Finding, ...]


_log = logging.getLogger(__name__)


def told(findings: Iterable[Finding]) -> list[Finding]:
    """Log findings as the warnings that they are, and return them."""
    listed = list(findings)
    for finding in listed:
        _log.warning("warning: %s [%s]", finding.sentence, finding.check)
    return listed


def write_findings(folder: Path, findings: Sequence[Finding]) -> None:
    """Write findings into a folder of results."""
    found = to_json(_File(findings=tuple(findings)))
    write_json(folder / HEALTH, {"format": HEALTH_FORMAT, **found})


def read_findings(folder: Path) -> list[Finding]:
    """Read them back; results of earlier versions have none.

    Raises
    ------
    ArtifactError
        If the file is damaged.
    """
    path = folder / HEALTH
    if not path.is_file():
        return []
    data = read_json(path, HEALTH_FORMAT)
    return list(from_json(_File, data, path, "what checks found").findings)
