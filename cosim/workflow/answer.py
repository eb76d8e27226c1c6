"""One interface of results: summary, findings, tables, figures and JSON; also of plug-ins."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hesr_model.errors import ConfigError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg
from hesr_model.support.text import parse_toml, read_text

if TYPE_CHECKING:
    from cosim.report.markup import ResultFigure
    from cosim.report.tables.table import ResultTable
    from hesr_model.findings import Finding


@dataclass(frozen=True)
class PluginJob:
    """Kind of TOML file that a plug-in runs with options: its verb and its distinguishing key."""

    verb: str
    key: str
    run: Callable[..., Answer]  # takes the path and the options of the verb


def find_job(path: Path, verb: str) -> PluginJob | None:
    """Return the job of a TOML file, None for other files; refuse a file of another command."""
    if path.suffix.lower() != ".toml":
        return None
    try:
        keys = parse_toml(read_text(path))
    except (OSError, ValueError):  # reported by the reader of the verb's own files
        return None
    for name, plugin in plugins.load("hesr.jobs").items():
        job: PluginJob = plugin.load()
        if job.key not in keys:
            continue
        if job.verb != verb:
            raise ConfigError(
                f"{path}: this file is a {name}; run it with 'hesr {job.verb} {path}'."
            )
        return job
    return None


MAX_LINES = 25  # largest number of lines of a summary
_POINTER = "--verbose"  # in lines that point to what a summary hides


class Answer(ABC):
    """Result of a command: `format` names its JSON format, `findings` has errors first."""

    format: str = "hesr-answer-1"
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()
    shows_tables: bool = False  # also without --verbose

    @abstractmethod
    def summary(self) -> str:
        """Return the verdict, then paths, in at most 25 lines."""

    def full_summary(self) -> str:
        """Return the summary above all tables, which hide nothing that it could point to."""
        lines = self.summary().splitlines()
        return "\n".join(line for line in lines if _POINTER not in line)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return the full tables, with sentences between them."""
        return ()

    def heading(self) -> str:
        """Return the heading of its page."""
        return "Result"

    def introduction(self) -> str:
        """Return the first paragraph of its page: extent and origin of the result."""
        return ""

    def figures(self) -> Sequence[ResultFigure]:
        """Return the figures of its page."""
        return ()

    def result(self) -> Any:
        """Return the result as data for JSON."""
        return None

    @property
    def passed(self) -> bool:
        """Whether no finding is an error."""
        return not any(finding.severity == "error" for finding in self.findings)

    def to_json(self) -> dict[str, Any]:
        """Return the envelope that `--json` writes."""
        from hesr_model.support.typed_files import to_json

        return {
            "format": self.format,
            "passed": self.passed,
            "findings": [to_json(finding) for finding in self.findings],
            "result": self.result(),
            "files": [str(file) for file in self.files],
        }

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.summary().partition(chr(10))[0]!r})"

    def _repr_html_(self) -> str:
        from html import escape

        from cosim.report.markup import table

        parts = [f"<pre>{escape(self.summary())}</pre>"]
        for table_or_text in self.tables():
            if isinstance(table_or_text, str):
                parts.append(f"<p>{escape(table_or_text)}</p>")
            else:
                parts.append(str(table(table_or_text)))
        return "\n".join(parts)


@dataclass(frozen=True, kw_only=True, repr=False)
class Written(Answer):
    """Files that a command wrote, with the lines, tables and JSON data that describe them.

    `title`, `origin` and `drawn` are heading, introduction and figures of a page.
    """

    format: str = "hesr-answer-1"
    lines: Sequence[str]
    shown: Sequence[ResultTable | str] = ()
    data: Any = None
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()
    shows_tables: bool = False
    title: str = ""
    origin: str = ""
    drawn: Sequence[ResultFigure] = ()

    def summary(self) -> str:
        """Return the lines, then the files."""
        return shorten_lines(self.lines, self.files)

    def full_summary(self) -> str:
        """Return all lines, then the files."""
        return "\n".join([*self.lines, *_name_files(self.files)])

    def tables(self) -> Sequence[ResultTable | str]:
        """Return the tables."""
        return self.shown

    def heading(self) -> str:
        """Return the title."""
        return self.title

    def introduction(self) -> str:
        """Return the origin."""
        return self.origin

    def figures(self) -> Sequence[ResultFigure]:
        """Return the figures."""
        return self.drawn

    def result(self) -> Any:
        """Return the result as JSON data."""
        return self.data


def shorten_lines(lines: Iterable[str], files: Sequence[Path] = ()) -> str:
    """Return lines and written files as text of at most `MAX_LINES` lines."""
    single_lines: list[str] = []
    for line in lines:
        single_lines += line.split("\n")
    written = _name_files(files)
    limit = MAX_LINES - len(written)
    if len(single_lines) > limit:
        hidden_count = len(single_lines) - limit + 1
        single_lines = single_lines[: limit - 1]
        single_lines.append(f"{hidden_count} more lines: {_POINTER} shows them.")
    return "\n".join([*single_lines, *written])


def _name_files(files: Sequence[Path]) -> list[str]:
    if not files:
        return []
    return [f"Written: {', '.join(map(str, files))}"]


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """Return one line per finding: severity, sentence and name of the check."""
    return [f"{finding.severity}: {finding.sentence} [{finding.check}]" for finding in findings]


def read_health(provenance: Mapping[str, Any]) -> list[Finding]:
    """Return the findings that the provenance of a result holds."""
    from hesr_model.findings import Finding, sort_by_severity
    from hesr_model.support.typed_files import from_json

    entries = provenance.get("health", ())
    return sort_by_severity(
        from_json(Finding, entry, Path("provenance"), "a finding") for entry in entries
    )


def written_files(output: PathArg | None) -> list[Path]:
    """Return the file that was written, if any, as a list."""
    if output is None:
        return []
    return [Path(output)]
