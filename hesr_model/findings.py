"""Findings of checks of logs, laws and FMUs."""

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import AliasChoices, BeforeValidator, Field

Severity = Literal["error", "warning", "advice"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "advice")  # the worst first
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A finding of a check, whose name `--accept` takes.

    Attributes
    ----------
    check : name of the check.
    severity : "error", "warning" or "advice".
    where : file, unless `logs` name it.
    joints, logs : names of those that it concerns.
    found : what was observed.
    remedy : what to do; may be empty.
    changes : values by key of the robot file that mend it; not in JSON.
    """

    check: str
    severity: Annotated[
        Severity, BeforeValidator(lambda s: "error" if s == "refusal" else s)  # in version 1
    ] = "error"
    where: str = ""
    joints: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()
    found: str
    remedy: Annotated[str, Field(validation_alias=AliasChoices("remedy", "cause"))] = ""
    changes: Annotated[Mapping[str, Any], Field(exclude=True)] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """Place, observation and remedy in one sentence."""
        places = []
        if self.where:
            places.append(self.where)
        if len(self.logs) == 1:
            places.append(f"log {self.logs[0]}")
        elif self.logs:
            places.append(f"log {self.logs[0]} and {len(self.logs) - 1} more")
        if self.joints:
            noun = "joint" if len(self.joints) == 1 else "joints"
            places.append(f"{noun} {', '.join(map(repr, self.joints))}")
        observation = self.found
        if self.remedy:
            observation = f"{self.found}: {self.remedy}."
        if not places:
            return observation
        return f"{', '.join(places)}: {observation}"


caution = partial(Finding, severity="warning")


def sort_by_severity(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings ordered by severity."""
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def log_findings(findings: Iterable[Finding]) -> list[Finding]:
    """Log findings as warnings and return them."""
    logged_findings = list(findings)
    for finding in logged_findings:
        _log.warning("warning: %s [%s]", finding.sentence, finding.check)
    return logged_findings


def select_by_severity(findings: Iterable[Finding], severity: str) -> list[Finding]:
    """Return findings at or above a severity; none for ``"never"``."""
    if severity not in SEVERITIES:
        return []
    severities = SEVERITIES[: SEVERITIES.index(severity) + 1]
    return [finding for finding in findings if finding.severity in severities]


def build_joint_finding(
    check: str,
    joint: str,
    observation: str,
    remedy: str,
    severity: Severity = "error",
    **finding_fields: Any,
) -> Finding:
    """Return a finding on a joint, or without joints if it is empty."""
    joints = (joint,) if joint else ()
    return Finding(
        check=check,
        severity=severity,
        joints=joints,
        found=observation,
        remedy=remedy,
        **finding_fields,
    )
