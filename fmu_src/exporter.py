"""Export formats: an exporter states its options, prepares them and writes a file.

Every format of `hesr export`, of HESR and of other packages, is an `Exporter`. An entry point of
the group `hesr.exports` gives its name, see docs/add-an-export-format.md.
"""

from __future__ import annotations

import json
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from hesr_model.support.progress import Progress, Stages

OptionType = Literal["bool", "int", "float", "str", "path", "log", "robot", "rigid_body"]
Platforms = Literal["none", "common", "host"]

_ARGUMENTS = {"path": "PathArg", "log": "LogArg", "robot": "RobotArg", "rigid_body": "BodyArg"}
"""Names in `cosim.workflow.arguments` of types that users may also state by a path."""


_REPEATABLE = ("float", "str", "path", "log")


@dataclass(frozen=True, kw_only=True)
class ExportOption:
    """Option of an export format, in Python and on the command line.

    Attributes
    ----------
    name : keyword in Python; on the command line with hyphens.
    type : type of the value. Paths become `Path`; robots and rigid bodies are
        read. Logs are objects or paths.
    help : sentence for the help.
    unit : unit of the value.
    choices : allowed values.
    per_joint : whether there is one number per joint; a single one serves all.
    repeatable : whether several values of type float, str, path or log may be
        given.
    required_as : description in the refusal of a request without it; empty for
        an optional one.
    requires : another option without which it must not be given.
    cached : whether model and value alone determine the output, and no other
        file is written, so that a copy from the cache serves as well.
    """

    name: str
    type: OptionType
    help: str
    unit: str = ""
    choices: tuple[int | str, ...] = ()
    per_joint: bool = False
    repeatable: bool = False
    required_as: str = ""
    requires: str = ""
    cached: bool = True

    def __post_init__(self) -> None:
        if self.repeatable and self.type not in _REPEATABLE:
            raise ValueError(
                f"option '{self.name}' of the type {self.type} cannot be repeatable; only "
                f"{', '.join(_REPEATABLE)} can"
            )

    @property
    def annotation(self) -> str:
        """Return the type of the keyword as Python code."""
        if self.per_joint:
            return "PerJoint"
        if self.choices:
            return f"Literal[{', '.join(map(json.dumps, self.choices))}]"
        annotation = _ARGUMENTS.get(self.type, self.type)
        return f"{annotation} | Iterable[{annotation}]" if self.repeatable else annotation

    @property
    def description(self) -> str:
        """Return the help with the unit."""
        return f"{self.help}  [{self.unit}]" if self.unit else self.help


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """Arguments of an export.

    Attributes
    ----------
    source : friction model; the path of an arm, a system, results or a study.
    output : file to write.
    options : options that are set, with numbers per joint, robots and rigid bodies in memory.
    platforms : platforms to build for, if the format has any.
    progress : called with stage, steps done and steps in total.
    """

    source: Any
    output: Path
    options: Mapping[str, Any]
    platforms: tuple[str, ...]
    progress: Stages

    @property
    def building(self) -> Progress:
        """Return the progress of the stage that writes the output."""
        return partial(self.progress, f"building {self.output.name}")


def _keep_options(request: ExportRequest) -> Mapping[str, Any]:
    return request.options


@dataclass(frozen=True, kw_only=True)
class Exporter:
    """Export format.

    Attributes
    ----------
    title : what it writes, for the help.
    suffixes : of the output, for the help; `write` refuses others.
    write : called as write(source, output, **options) after all options are
        accepted; may return remarks for the user. With `platforms` it also
        takes `platforms` and `progress`.
    options : its options.
    prepare : returns the keywords of `write` for a request, by default its
        options. For a file in the cache, an object among them has the JSON data
        that determine it as its `key`.
    platforms : none, or what it builds by default: the common platforms or only
        the host's.
    platform_refusal : why it takes no platforms, if not for the other formats'
        sake.
    """

    title: str
    suffixes: tuple[str, ...]
    write: Callable[..., Iterable[str] | None]
    options: tuple[ExportOption, ...] = ()
    prepare: Callable[[ExportRequest], Mapping[str, Any]] = _keep_options
    platforms: Platforms = "none"
    platform_refusal: str = ""

    @property
    def option_names(self) -> set[str]:
        """Return the names of its options."""
        return {option.name for option in self.options}


def defer_writer(function: str) -> Callable[..., None]:
    """Return a writer that imports `function` ("module:name") when it is called.

    The help imports the exporters of all formats, but not what they need to write. What the
    function returns is dropped: it is not a remark for the user.
    """

    def write(source: Any, output: Path, **options: Any) -> None:
        pkgutil.resolve_name(function)(source, output, **options)

    return write


FMI = ExportOption(
    name="fmi", type="int", choices=(2, 3), help="Version of FMI; 3 has arrays, dq for dq[i]."
)
NO_DOCUMENTATION = ExportOption(
    name="no_documentation",
    type="bool",
    help="No page, picture and reference results, for pipelines; takes half the time.",
)
ROBOT = ExportOption(
    name="robot", type="robot", help="The robot of the law.", required_as="the robot of the law"
)
RIGID_BODY = ExportOption(
    name="rigid_body",
    type="rigid_body",
    help="Result of 'hesr identify' for 'robot'; by default the parameters of the model file.",
    requires="robot",
)
