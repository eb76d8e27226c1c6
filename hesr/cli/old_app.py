"""The application, and what its commands share: their options, their help, reading of logs."""

import inspect
import re
from collections.abc import Callable, Iterable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from hesr.cli.console import command_output
from hesr_model.errors import ConfigError
from hesr_model.support.progress import Stages

if TYPE_CHECKING:
    from cosim.study.scores import Records
    from hesr_model.findings import Finding
    from hesr_model.robots.robot import RobotModel


__all__ = ["Accept", "Body", "Folder", "Json", "Logs", "Output", "Platforms", "Result", "Robot",
           "System", "Table", "Trust", "Workers", "app", "read_records", "require_table",
           "trusted"]  # fmt: skip

_EPILOG = """\b
Exit codes:
  0    all is well
  1    a check found something wrong, or engines differ
  2    the command or one of its files is wrong; one sentence says what
  130  interrupted by Ctrl-C (143: ended by another program); no file is
       half-written, and a run says what it can go on from

\b
Every command takes --quiet and --verbose. --json FILE writes results for
programs; --json - writes them to standard output, and nothing else there.
"""

_ORDER = (
    *("new", "inspect", "constants", "run", "report", "results", "view"),
    *("excite", "identify", "fit", "evaluate", "properties", "audit", "arena", "laws"),
    *("export", "check", "replay", "thermal", "monitor", "simulate", "sweep"),
    "package",
)
"""Of the commands in the help, as they are needed; others follow."""

_WIDTH = 75  # of an example in a help text, which is indented by 2 and may end with a backslash


class _Commands(TyperGroup):
    """All commands, listed as they are needed."""

    def list_commands(self, ctx: Any) -> list[str]:
        places = {name: place for place, name in enumerate(_ORDER)}
        return sorted(super().list_commands(ctx), key=lambda name: places.get(name, len(places)))


class _App(typer.Typer):
    """An application whose commands all take --quiet and --verbose and show their examples."""

    def command(self, *args: Any, **options: Any) -> Callable[[Any], Any]:
        """Register a command, whose docstring ends with "Example: ..." or "Examples: ...; ..."."""
        register = super().command

        def decorate(function: Callable[..., None]) -> Callable[..., None]:
            told, heading, examples = (inspect.getdoc(function) or "").partition("\nExample")
            shown = {"help": told.strip(), "epilog": _lines(heading.strip() + examples)}
            register(*args, **shown | options)(_with_output_options(function))
            return function

        return decorate


def _lines(examples: str) -> str:
    """Return examples one below the other, as they can be copied into a shell."""
    heading, _, commands = " ".join(examples.split()).partition(": ")
    lines = ["\b", f"{heading}:"]
    for command in commands.split("; "):
        line = " "
        for part in re.split(" (?=-)", command):  # an option stays with its value
            if len(line) + len(part) > _WIDTH:
                lines.append(f"{line} \\")
                line = "   "
            line += f" {part}"
        lines.append(line)
    return "\n".join(lines)


def _with_output_options(function: Callable[..., None]) -> Callable[..., None]:
    """Add the options that every command takes."""
    more = {
        "quiet": Annotated[bool, typer.Option("--quiet", help="Print errors only.")],
        "verbose": Annotated[
            bool, typer.Option("--verbose", help="Log to standard error what is being done.")
        ],
    }

    @wraps(function)
    def run(*, quiet: bool, verbose: bool, **arguments: Any) -> None:
        with command_output(quiet=quiet, verbose=verbose, json_file=arguments.get("json_file")):
            function(**arguments)

    own = inspect.signature(function).parameters.values()
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=option)
        for name, option in more.items()
    ]
    run.__dict__["__signature__"] = inspect.Signature([*own, *added])
    run.__annotations__ = {**function.__annotations__, **more}
    return run


app = _App(
    name="hesr",
    cls=_Commands,
    epilog=_EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"hesr {version('hesr')}")
        raise typer.Exit


@app.callback(help="From a robot's log to a friction model as an FMU, with proof that it works.")
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Options of no command; each is acted upon where it is read."""


def _platforms(typed: str) -> list[str]:
    from fmu_src.export.toolchain import TARGETS

    return [name for name in (*TARGETS, "all") if name.startswith(typed)]


Logs = Annotated[
    list[Path], typer.Argument(metavar="LOG", help="CSV, Parquet or MATLAB files, or ROS bags.")
]
Robot = Annotated[Path, typer.Option("--robot", metavar="ROBOT.toml", help="Robot file.")]
Body = Annotated[
    Path, typer.Option("--rigid-body", metavar="FILE", help="Result of 'hesr identify'.")
]
System = Annotated[
    Path, typer.Argument(metavar="SYSTEM.toml", help="FMUs, connections, steps; or an SSP.")
]
Result = Annotated[
    Path, typer.Argument(metavar="RESULT", help="Folder that 'hesr run' has written.")
]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")]
Table = Annotated[
    Path, typer.Option("-o", "--output", metavar="FILE", help="CSV or Parquet file to write.")
]
Folder = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FOLDER", help="Folder; default: results/NAME."),
]
Workers = Annotated[
    int | None,
    typer.Option("--workers", metavar="N", min=1, help="Processes; default: one a core."),
]
Accept = Annotated[
    list[str] | None,
    typer.Option(
        "--accept", metavar="CHECK", help="Go on although this check refuses; repeatable."
    ),
]
Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", help="Also write the results as JSON; - is standard output."
    ),
]
Trust = Annotated[
    bool,
    typer.Option(
        "--trust",
        help="Run these FMUs as our own, now and later: faster, but they can do what you can. "
        "Others run in a process with limits.",
    ),
]
Platforms = Annotated[
    list[str] | None,
    typer.Option(
        "--platform",
        metavar="PLATFORM",
        help="linux64, win64, darwin64, aarch64-linux or all; may be repeated.",
        autocompletion=_platforms,
    ),
]


def trusted(fmus: Iterable[Path], *, trust: bool) -> None:
    """Remember FMUs as our own, where their user trusts them."""
    if trust:
        from fmu_src.run.fmu import remember

        for fmu in fmus:
            if fmu.is_file():  # what is not there, others say better
                remember(fmu)


def require_table(path: Path) -> None:
    """Refuse to write results into a file of another kind."""
    if path.suffix.lower() not in (".csv", ".parquet", ".pq"):
        raise ConfigError(f"{path}: results are written as .csv or .parquet.")


def read_records(
    logs: list[Path],
    robot: Path,
    rigid_body: Path,
    progress: "Stages",
    accepted: list[str] | None = None,
) -> "tuple[Records, RobotModel, list[Finding]]":
    """Return the friction records [joint][log], the robot's model, and what is odd in the logs."""
    from cosim.study.scores import by_joint
    from cosim.workflow.arguments import checked_logs
    from hesr_model.rigid_body.identification import RigidBody

    read = checked_logs(logs, robot, accepted or (), progress)
    return by_joint(read.records(RigidBody.read(rigid_body))), read.robot, read.findings
