"""Findings of logs: merged over logs and joints, refused unless accepted."""

from collections.abc import Callable, Iterable, Sequence
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
    tried = "hesr inspect tries the changes on these logs. " * any(f.changes for f in findings)
    told = f"{tried}To continue anyway: {names}."
    if len(lines) == 1:
        return f"{lines[0]} {told}"
    return "\n  ".join([f"{len(lines)} errors in the data.", *lines, told])


def of_log(log: Log, findings: Iterable[Finding]) -> list[Finding]:
    """Return findings with the name of their log."""
    return [replace(finding, logs=(log.name,)) for finding in findings]


def merged(findings: Iterable[Finding]) -> list[Finding]:
    """Merge findings of several logs or joints; errors first."""
    by_log = _merged(findings, lambda f: (f.check, f.joints))
    return errors_first(_merged(by_log, lambda f: (f.check, f.severity, f.remedy, repr(f.changes))))


def _merged(findings: Iterable[Finding], key: Callable[[Finding], object]) -> list[Finding]:
    groups: dict[object, list[Finding]] = {}
    for finding in findings:
        groups.setdefault(key(finding), []).append(finding)
    return [
        replace(
            errors_first(group)[0],
            joints=tuple(dict.fromkeys(joint for f in group for joint in f.joints)),
            logs=tuple(dict.fromkeys(log for f in group for log in f.logs)),
        )
        for group in groups.values()
    ]


def require_sound(findings: Sequence[Finding], accepted: Sequence[str] = ()) -> list[Finding]:
    """Return all findings, or raise HealthError with errors not accepted."""
    if refused := [f for f in findings if f.severity == "error" and f.check not in accepted]:
        raise HealthError(_said(refused), refused)
    return list(findings)


def require_known(accepted: Sequence[str], known: Sequence[str]) -> None:
    """Raise ConfigError if `accepted` contains an unknown check."""
    for name in accepted:
        if name not in known:
            raise ConfigError(f"--accept is '{name}'; the checks are {', '.join(known)}.")
