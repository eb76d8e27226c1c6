"""Verbs that are not derived yet."""

from hesr.cli import (  # noqa: F401  # each registers its commands
    arena,
    audit,
    constants,
    excite,
    export,
    inspect,
    job,
    new,
    package,
    properties,
    report,
    simulate,
    steps,
    sweep,
    view,
)
from hesr.cli.old_app import app  # goes with the last old verb

__all__ = ["app"]
