"""Findings of logs: merged over logs and joints, refused unless accepted."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from hesr_model.errors import ConfigError, LogError
from hesr_model.findings import Finding, errors_first
from hesr_model.logs.robot_log import Log


class HealthError(LogError):
    """Impossible data, a line per finding."""

    def __init__(self, said: str, findings: Sequence[Finding]) -> None:
        super().__init__(said)
        self.findings = tuple(findings)


def _said(findings: Sequence[Finding]) -> str:
    lines = [f"{f.sentence} [{f.check}]" for f in findings]
    names = " ".join(f"--accept {name}" for name in dict.fromkeys(f.check for f in findings))
    told = f"To go on nevertheless: {names}."
    if len(lines) == 1:
        return f"{lines[0]} {told}"
    return "\n  ".join([f"{len(lines)} things in the data cannot be right.", *lines, told])


def of_log(log: Log, findings: Iterable[Finding]) -> list[Finding]:
    """Return findings with the name of the log that they are about."""
    return [replace(finding, logs=(log.name,)) for finding in findings]


def merged(findings: Iterable[Finding]) -> list[Finding]:
    """Merge findings that several logs or joints share; errors first."""
    by_log: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for finding in findings:
        first = by_log.setdefault((finding.check, finding.joints), finding)
        worst = min(first, finding, key=lambda f: f.severity != "error")
        logs = tuple(dict.fromkeys((*first.logs, *finding.logs)))
        by_log[finding.check, finding.joints] = replace(worst, logs=logs)
    by_joint: dict[tuple[str, str, str], Finding] = {}
    for finding in by_log.values():
        key = (finding.check, finding.severity, finding.remedy)
        first = by_joint.setdefault(key, finding)
        by_joint[key] = replace(
            first,
            joints=tuple(dict.fromkeys((*first.joints, *finding.joints))),
            logs=tuple(dict.fromkeys((*first.logs, *finding.logs))),
        )
    return errors_first(by_joint.values())


def require_sound(findings: Sequence[Finding], accepted: Sequence[str] = ()) -> list[Finding]:
    """Return all findings, or raise HealthError with errors that are not accepted."""
    refused = [f for f in findings if f.severity == "error" and f.check not in accepted]
    if refused:
        raise HealthError(_said(refused), refused)
    return list(findings)


def require_known(accepted: Sequence[str], known: Sequence[str]) -> None:
    """Raise ConfigError if `accepted` contains an unknown check."""
    for name in accepted:
        if name not in known:
            raise ConfigError(f"--accept is '{name}'; the checks are {', '.join(known)}.")
