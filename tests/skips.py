"""Skips that are allowed in CI; each other one fails there, since a tool must not be missing."""

import re
from typing import NamedTuple


class AllowedSkip(NamedTuple):
    """A skip by its reason, a regular expression, and why CI may lack what it needs."""

    reason: str
    why: str


ALLOWED = (
    AllowedSkip(
        "next to the repository", "measured logs and robots of others are not ours to give"
    ),
    AllowedSkip("^needs hesr\\[mutation\\]", "`make mutate` installs it"),
    AllowedSkip("^JAX is not installed", "only the environment of all tests has it"),
    AllowedSkip(
        "^MODELICAPATH names no folder", "no registry has the library; see docs/exports.md"
    ),
    AllowedSkip("^rumoca holds its end points", "a limit of the compiler"),
    AllowedSkip("`make soak` runs it$", "it takes minutes"),
    AllowedSkip("^fmi-sim is not there", "`make interop` builds it"),
    AllowedSkip(
        "^(example-robot-data|pybullet_data|dm_control|gymnasium_robotics) is not", "robots"
    ),
    AllowedSkip("^root may write anywhere$", "CI runs as root"),
    AllowedSkip("^only root can give a", "or does not"),
    AllowedSkip("^this processor has no vectors", "processors differ"),
)


def is_allowed(reason: str) -> bool:
    """Return whether CI may skip a test for this reason."""
    return any(re.search(skip.reason, reason) for skip in ALLOWED)


def refusal_of(longrepr: object) -> str | None:
    """Return why a skip, as pytest reports it, fails in CI; None if it is allowed."""
    # A triple of file, line and reason.
    reason = str(longrepr[2]) if isinstance(longrepr, tuple) else str(longrepr)
    reason = reason.removeprefix("Skipped: ")
    if is_allowed(reason):
        return None
    return f"skipped in CI: {reason}; install what is missing, or list it in tests/skips.py"
