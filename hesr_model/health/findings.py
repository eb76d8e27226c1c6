"""What a check found, in words: where, what, the likeliest cause and how to mend it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

from pydantic import Field

from hesr_model.errors import ConfigError, LogError

Severity = Literal["refusal", "warning"]


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Something wrong or odd.

    Attributes
    ----------
    check : its name, by which a user accepts what it found.
    severity : ``"refusal"`` for what cannot be right, ``"warning"`` for what is odd.
    joints : names of the joints; empty where it is of none.
    logs : names of the logs in which it shows; empty where it is of no log.
    found, cause : what was found; the likeliest cause and the mend.
    changes : what to set in the robot file: values by key, as ``log.units.q``; no part of its JSON.
    """

    check: str
    severity: Severity
    joints: tuple[str, ...] = ()
    logs: tuple[str, ...] = ()
    found: str
    cause: str
    changes: Annotated[Mapping[str, Any], Field(exclude=True)] = field(default_factory=dict)

    @property
    def sentence(self) -> str:
        """All of it in one sentence."""
        more = f" and {len(self.logs) - 1} more" if len(self.logs) > 1 else ""
        where = [f"log {self.logs[0]}{more}"] if self.logs else []
        if self.joints:
            plural = "s" if len(self.joints) > 1 else ""
            where.append(f"joint{plural} {', '.join(map(repr, self.joints))}")
        return f"{', '.join(where)}{': ' if where else ''}{self.found}: {self.cause}."


class HealthError(LogError):
    """Data that cannot be right; all that was found, a line each."""

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


def merged(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings that several logs or joints share once, with all of them; refusals first."""
    by_log: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for finding in findings:
        first = by_log.setdefault((finding.check, finding.joints), finding)
        worst = min(first, finding, key=lambda f: f.severity != "refusal")
        logs = tuple(dict.fromkeys((*first.logs, *finding.logs)))
        by_log[finding.check, finding.joints] = replace(worst, logs=logs)
    by_joint: dict[tuple[str, str, str], Finding] = {}
    for finding in by_log.values():
        key = (finding.check, finding.severity, finding.cause)
        first = by_joint.setdefault(key, finding)
        by_joint[key] = replace(
            first,
            joints=tuple(dict.fromkeys((*first.joints, *finding.joints))),
            logs=tuple(dict.fromkeys((*first.logs, *finding.logs))),
        )
    return sorted(by_joint.values(), key=lambda f: f.severity != "refusal")


def require_sound(findings: Sequence[Finding], accepted: Sequence[str] = ()) -> list[Finding]:
    """Refuse what cannot be right and was not accepted; return what is to be told nevertheless.

    Raises
    ------
    HealthError
        Naming all of it at once.
    """
    refused = [f for f in findings if f.severity == "refusal" and f.check not in accepted]
    if refused:
        raise HealthError(_said(refused), refused)
    return list(findings)


def require_known(accepted: Sequence[str], known: Sequence[str]) -> None:
    """Check that what is accepted are names of checks.

    Raises
    ------
    ConfigError
        Naming one that is none, and those that there are.
    """
    for name in accepted:
        if name not in known:
            raise ConfigError(f"--accept is '{name}'; the checks are {', '.join(known)}.")
