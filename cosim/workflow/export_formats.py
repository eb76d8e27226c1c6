"""Export formats of all packages by kind of source; their options in help and types."""

from __future__ import annotations

import os
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from cosim.workflow.arguments import require_choice
from fmu_src.exporter import Exporter, ExportOption
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.support import plugins
from hesr_model.support.text import join_with_and, join_with_or

if TYPE_CHECKING:
    from cosim.workflow.arguments import LawArg

_RESERVED = ("source", "output", "format", "platform", "platforms", "progress")
_RESERVED_ON_COMMAND_LINE = ("json", "json_file", "fail_on", "quiet", "verbose", "help")
_WIDTH = 92  # of a text within a class


@dataclass(frozen=True, kw_only=True)
class ExportSource:
    """Kind of things that can be exported.

    Attributes
    ----------
    group : group of plug-ins with its formats.
    noun : name of one source, in messages.
    owner : whose an option or a format is, in messages.
    default : its default format.
    suffixes : suffixes of files that identify the kind, if there are any.
    product : what it becomes.
    refusals : sentence for formats that users expect, but that do not exist.
    """

    group: str
    noun: str
    owner: str
    default: str
    suffixes: tuple[str, ...] = ()
    product: str = ""
    refusals: Mapping[str, str] = field(default_factory=dict)


LAW = ExportSource(
    group="hesr.exports", noun="a friction law", owner="friction laws", default="fmu"
)
ARM = ExportSource(
    group="hesr.exports.arm",
    noun="a robot",
    owner="an MJCF (.xml)",
    default="fmu",
    suffixes=(".xml", ".urdf"),
    product="an FMU",
)
SYSTEM = ExportSource(
    group="hesr.exports.system",
    noun="a system",
    owner="a system",
    default="ssp",
    suffixes=(".toml", ".ssp"),
    product="an SSP",
    refusals={
        "fmu": "HESR writes systems as SSP (.ssp), not as one FMU: such a container has a coupling "
        "of its own. docs/exports.md names tools that build one from the SSP."
    },
)
RESULTS = ExportSource(
    group="hesr.exports.results",
    noun="results or a study",
    owner="a closed loop",
    default="loop",
    product="a closed loop",
)
KINDS = (LAW, ARM, SYSTEM, RESULTS)


def find_kind(source: LawArg, format_name: str | None) -> ExportSource:
    """Return the kind of a source: results by the format, others by the suffix."""
    if format_name in plugins.names(RESULTS.group):
        return RESULTS
    if isinstance(source, str | os.PathLike):
        for kind in KINDS:
            if Path(source).suffix.lower() in kind.suffixes:
                return kind
    return LAW


def load_exporter(plugin: plugins.Plugin) -> Exporter:
    """Import an export format; raises ConfigError if it cannot serve as one."""
    exporter = plugin.load()
    if not isinstance(exporter, Exporter):
        raise ConfigError(
            f"{plugin.label} is not an Exporter; its package needs the interface of "
            "docs/add-an-export-format.md."
        )
    for option in exporter.options:
        if not option.name.isidentifier() or option.name in (
            *_RESERVED,
            *_RESERVED_ON_COMMAND_LINE,
        ):
            raise ConfigError(f"{plugin.label}: an option cannot have the name '{option.name}'.")
    return exporter


def load_exporters(kind: ExportSource) -> dict[str, Exporter]:
    """Import all formats of a kind of sources."""
    return {name: load_exporter(plugin) for name, plugin in plugins.load(kind.group).items()}


@dataclass(frozen=True, kw_only=True)
class ExportFormat:
    """Format of an export, by the kind of its source; whether it is HESR's own."""

    kind: ExportSource
    name: str
    exporter: Exporter
    is_own: bool

    def require_options(
        self, options: Mapping[str, object], platform: Sequence[str] | None
    ) -> None:
        """Raise ArgumentError unless the options that are set are those of the format."""
        for name in options:
            if name not in self.exporter.option_names:
                self._refuse_option(name)
        if platform is not None and self.exporter.platforms == "none":
            self._refuse_platform()
        # A missing partner is named first: of two options the message then names both.
        for option in self.exporter.options:
            if option.name in options and option.requires not in ("", *options):
                self._refuse_alone(option)
        for option in self.exporter.options:
            if option.name in options:
                _require_choice_of(option, options[option.name])
            elif option.required_as:
                raise ArgumentError(
                    f"'format' {self.name} needs '{option.name}', {option.required_as}."
                )

    def choose_platforms(self, platform: Sequence[str] | None) -> tuple[str, ...]:
        """Return the platforms to build for: those of the user, by default those of the format."""
        if self.exporter.platforms == "none":
            return ()
        if platform is not None:
            return tuple(platform)
        from fmu_src.export.toolchain import DEFAULT_PLATFORMS, HOST

        if self.exporter.platforms == "host":
            return HOST
        return DEFAULT_PLATFORMS

    def _refuse_option(self, option_name: str) -> NoReturn:
        """Refuse an option of other formats, which would have no effect."""
        for kind in (self.kind, *KINDS):
            formats = [
                name
                for name, exporter in load_exporters(kind).items()
                if option_name in exporter.option_names
            ]
            if formats and kind is self.kind:
                self._refuse_for_formats(option_name, formats)
            if formats:
                contrast = ""
                if self.kind is not LAW:
                    contrast = f", not for {self.kind.noun}"
                raise ArgumentError(f"'{option_name}' is for {kind.owner}{contrast}.")
        raise ArgumentError(f"'{option_name}' is not an option of any format.")

    def _refuse_alone(self, option: ExportOption) -> NoReturn:
        pair = (option.name, option.requires)
        names = [f"'{other.name}'" for other in self.exporter.options if other.name in pair]
        raise ArgumentError(f"{' and '.join(names)} must be given together.")

    def _refuse_platform(self) -> NoReturn:
        if self.exporter.platform_refusal:
            raise ArgumentError(self.exporter.platform_refusal)
        formats = [
            name
            for name, exporter in load_exporters(self.kind).items()
            if exporter.platforms != "none"
        ]
        self._refuse_for_formats("platform", formats)

    def _refuse_for_formats(self, option_name: str, formats: Sequence[str]) -> NoReturn:
        raise ArgumentError(
            f"'{option_name}' needs 'format' {join_with_or(formats)}, but the format is "
            f"'{self.name}'."
        )


def _require_choice_of(option: ExportOption, value: object) -> None:
    if option.choices:
        require_choice(option.name, value, option.choices)


def choose_format(source: LawArg, format_name: str | None, output: Path) -> ExportFormat:
    """Return the format of an export; raises ConfigError if the source has no such format."""
    kind = find_kind(source, format_name)
    for name in (format_name or "", output.suffix.lower().removeprefix(".")):
        if name in kind.refusals:
            raise ArgumentError(kind.refusals[name])
    name = format_name or kind.default
    formats = plugins.load(kind.group)
    if name not in formats:
        _refuse_format(kind, name, list(formats))
    exporter = load_exporter(formats[name])
    return ExportFormat(kind=kind, name=name, exporter=exporter, is_own=formats[name].is_built_in)


def _refuse_format(kind: ExportSource, name: str, formats: Sequence[str]) -> NoReturn:
    if not formats:
        plugins.find(kind.group, name)  # says that none is installed
    if kind is LAW:
        raise ArgumentError(f"'format' is {name}; allowed are {', '.join(formats)}.")
    contrast = ""
    if name in plugins.names(LAW.group):
        contrast = f", which is for {LAW.owner}"
    raise ArgumentError(
        f"'format' is {name}{contrast}; {kind.noun} becomes {kind.product} ({', '.join(formats)})."
    )


def find_title(suffix: str) -> str:
    """Return the title of the first format of files with a suffix."""
    for kind in KINDS:
        for exporter in load_exporters(kind).values():
            if suffix in exporter.suffixes:
                return exporter.title[0].upper() + exporter.title[1:]
    return "File for other tools"


@dataclass(frozen=True, kw_only=True)
class HelpSection:
    """Section of the help: formats with their titles, or options of some formats."""

    title: str
    formats: tuple[tuple[str, str], ...] = ()
    options: tuple[ExportOption, ...] = ()


def help_sections() -> list[HelpSection]:
    """Return the formats of all packages, and their options by the formats that have them."""
    formats: list[HelpSection] = []
    options: list[HelpSection] = []
    annotations: dict[str, tuple[str, str]] = {}  # with the first format, by option
    for kind in KINDS:
        exporters = load_exporters(kind)
        for name, exporter in exporters.items():
            _require_equal_types(name, exporter, annotations)
        if exporters:
            formats.append(_format_section(kind, exporters))
        options += _option_sections(kind, exporters)
    return formats + options


def _require_equal_types(
    format_name: str, exporter: Exporter, annotations: dict[str, tuple[str, str]]
) -> None:
    """Refuse one option with two types; the command line could not distinguish them."""
    for option in exporter.options:
        annotation = option.annotation
        other_format, expected = annotations.setdefault(option.name, (format_name, annotation))
        if annotation != expected:
            raise ConfigError(
                f"export format '{format_name}': option '{option.name}' has the type {annotation}, "
                f"but {expected} in the format '{other_format}'; it needs another name."
            )


def _format_section(kind: ExportSource, exporters: Mapping[str, Exporter]) -> HelpSection:
    rows = []
    for name, exporter in exporters.items():
        remarks = list(exporter.suffixes)
        if name == kind.default and kind is not RESULTS:
            remarks.append("default")
        rows.append((name, _add_remarks(exporter.title, remarks)))
    title = _add_remarks(f"Formats of {kind.noun}", kind.suffixes)
    return HelpSection(title=title, formats=tuple(rows))


def _add_remarks(title: str, remarks: Sequence[str]) -> str:
    """Return a title with its remarks, if any, in brackets."""
    if not remarks:
        return title
    return f"{title} ({', '.join(remarks)})"


def _option_sections(
    kind: ExportSource, exporters: Mapping[str, Exporter]
) -> Iterator[HelpSection]:
    """Yield sections of the options that the same formats have with the same meaning."""
    formats_of_option: dict[ExportOption, list[str]] = {}
    for name, exporter in exporters.items():
        for option in exporter.options:
            formats_of_option.setdefault(option, []).append(name)
    groups: dict[tuple[str, ...], list[ExportOption]] = {}
    for option, formats in formats_of_option.items():
        groups.setdefault(tuple(formats), []).append(option)
    for names, options in groups.items():
        title = f"Options of {join_with_and(names)}"
        if kind is not LAW:
            title += f" of {kind.noun}"
        yield HelpSection(title=title, options=tuple(options))


_HEADER = '''\
"""Options of all export formats for type checkers; `hesr.export_types` writes this file."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Literal, TypedDict

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LogArg, PerJoint, RobotArg
    from hesr_model.support.files import PathArg


class ExportOptions(TypedDict, total=False):
    """Options of the formats of `export`."""
'''


def export_options_code() -> str:
    """Return a module with the type `ExportOptions`: the options of all formats."""
    annotations: dict[str, str] = {}
    texts: dict[str, list[str]] = {}
    for section in help_sections():
        formats = section.title.removeprefix("Options of ")
        for option in section.options:
            annotations[option.name] = option.annotation
            texts.setdefault(option.name, []).append(f"{formats}: {option.description}")
    lines = [_HEADER]
    for name, annotation in annotations.items():
        text = " ".join(texts[name]).replace("\\", "\\\\").replace('"', "'")
        wrapped = textwrap.wrap(f'"""{text}"""', _WIDTH)
        lines += [f"    {name}: {annotation}", *(f"    {line}" for line in wrapped)]
    return "\n".join(lines) + "\n"
