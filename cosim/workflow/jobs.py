"""Jobs of plug-ins: TOML files, recognised by a key of their own, that a verb runs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

    from cosim.workflow.answer import Answer


class PluginJob(Protocol):
    """Kind of TOML file that a plug-in runs: its verb and its distinguishing key."""

    verb: str
    key: str

    def read(self, path: Path) -> Any:
        """Read and validate a file."""

    def run(self, path: Path, **options: Any) -> Answer:
        """Run a file with the options of the verb."""


def find_job(path: Path, verb: str) -> PluginJob | None:
    """Return the job of a TOML file, None for other files; refuse a file of another command."""
    from hesr_model.support.plugins import load
    from hesr_model.support.untrusted_text import parse_toml, read_text

    if path.suffix.lower() != ".toml":
        return None
    try:
        keys = parse_toml(read_text(path))
    except (OSError, ValueError):  # reported by the reader of the verb's own files
        return None
    for name, plugin in load("hesr.jobs").items():
        job: PluginJob = plugin.load()
        if job.key not in keys:
            continue
        if job.verb != verb:
            raise ConfigError(
                f"{path}: this file is a {name}; run it with 'hesr {job.verb} {path}'."
            )
        return job
    return None
