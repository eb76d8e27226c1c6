"""Application: its verbs, derived on first use, and the output of their results."""

import inspect
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hesr.cli import console
from hesr.cli.derive import Function, command
from hesr_model.errors import ArgumentError, ConfigError
from hesr_model.support import plugins

if TYPE_CHECKING:
    from cosim.workflow.answer import Answer
    from cosim.workflow.export_formats import HelpSection

_VERBS = (
    *("new", "inspect", "excite", "identify", "fit", "test"),
    *("export", "check", "simulate", "run", "report"),
)

_EPILOG = """\b
Exit codes:
  0    success
  1    a finding is an error, or at least as severe as --fail-on
  2    the command or one of its files is invalid; one sentence says why
  130  interrupted by Ctrl-C (143: ended by another program); no file is
       half-written, and a run says what it can go on from

\b
Every command takes --quiet and --verbose. --json FILE writes results for
programs; --json - writes them to standard output, and nothing else there.
"""


class _Verbs(click.Group):
    """Verbs in the order of work."""

    def list_commands(self, _: click.Context) -> list[str]:
        return [*_VERBS, *plugins.names("hesr.commands")]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in console.MOVED:
            console.refuse(console.MOVED[cmd_name])
        if cmd_name not in _VERBS and cmd_name not in self.list_commands(ctx):
            return None
        function = workflow(cmd_name)
        return command(cmd_name, function, _invoke, help_sections(function))


def workflow(verb: str) -> Function:
    """Return the workflow function of a verb."""
    if verb in _VERBS:
        found: Function = getattr(import_module(f"cosim.workflow.{verb}"), verb)
        return found
    plugin: Function = plugins.load("hesr.commands")[verb].load()
    return plugin


def help_sections(function: Function) -> "Sequence[HelpSection]":
    """Return further sections of the help, with options, if the module of a function has them."""
    sections: Sequence[HelpSection] = _module(function).get("help_sections", tuple)()
    return sections


def _invoke(function: Function, given: dict[str, Any]) -> None:
    console.require_environment()
    json_file = given.pop("json_file", None)
    fail_on, quiet, verbose = (given.pop(name) for name in ("fail_on", "quiet", "verbose"))
    file = None if json_file is None else Path(json_file)
    with console.command_output(quiet=quiet, verbose=verbose, json_file=file) as output:
        with console.answer_file(file, output) as wanted:
            listing = given.pop("listing", False) and _module(function)["listing"]
            answer = listing() if listing else _answer(function, given, hidden=quiet or verbose)
            if wanted:
                from hesr_model.support.typed_files import write_json

                write_json(wanted, answer.to_json())
        summary = answer.summary()
        if summary:
            click.echo(summary)
        if verbose or answer.shows_tables:
            from cosim.report.tables.terminal import show

            show(*answer.tables())
    if not answer.findings:
        sys.exit(0)
    from hesr_model.findings import reaching  # slow to import

    sys.exit(1 if reaching(answer.findings, fail_on) else 0)


def _module(function: Function) -> dict[str, Any]:
    return vars(sys.modules[function.__module__])


def _answer(function: Function, given: dict[str, Any], *, hidden: bool) -> "Answer":
    from cosim.workflow.answer import Answer

    with console.shown_progress(hidden=hidden) as progress:
        taken = inspect.signature(function).parameters
        more = {"progress": progress} if "progress" in taken else {}
        try:
            result = function(**given, **more)
        except ArgumentError as error:
            parameters = click.get_current_context().command.params
            options = {one.name: one.opts[-1] for one in parameters if one.name}
            raise ConfigError(error.on_command_line(options)) from error
    if isinstance(result, Answer):
        return result
    describe: Callable[..., Answer] = _module(function)["answer"]
    return describe(result, given.get("output"))


app = _Verbs(
    name="hesr",
    help="From a robot's log to a friction model as an FMU, with proof that it works.",
    epilog=_EPILOG,
    no_args_is_help=True,
    context_settings={"max_content_width": 80},
)
click.version_option(package_name="hesr", message="hesr %(version)s", help="Show the version.")(app)
