"""Application: its verbs, derived on first use, and the output of their results."""

import inspect
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from hesr.cli import console
from hesr.cli.derive import VERBS, Function, command
from hesr_model.errors import HesrError
from hesr_model.support import plugins
from hesr_model.support.progress import Interrupted, drafts_passed_to

if TYPE_CHECKING:
    from cosim.workflow.answer import Answer
    from cosim.workflow.export_formats import HelpSection

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

\b
To start, with the URDF or MJCF of your robot:
  hesr new my_arm --robot my_arm.urdf
  hesr run my_arm/study.toml
  hesr check results/my_arm/fmus/lugre.fmu
"""


class _Verbs(click.Group):
    """Verbs in the order of work."""

    def list_commands(self, _: click.Context) -> list[str]:
        return [*VERBS, *plugins.names("hesr.commands")]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in console.MOVED_VERBS:
            console.refuse(console.MOVED_VERBS[cmd_name])
        if cmd_name not in VERBS and cmd_name not in self.list_commands(ctx):
            return None
        function = find_workflow(cmd_name)
        return command(cmd_name, function, _invoke, help_sections(function))


def find_workflow(verb: str) -> Function:
    """Return the workflow function of a verb."""
    if verb in VERBS:
        function: Function = getattr(import_module(f"cosim.workflow.{verb}"), verb)
        return function
    workflow: Function = plugins.load("hesr.commands")[verb].load()
    return workflow


def help_sections(function: Function) -> "Sequence[HelpSection]":
    """Return further sections of the help, with options, if the module of a function has them."""
    sections: Sequence[HelpSection] = _module(function).get("help_sections", tuple)()
    return sections


@dataclass(frozen=True, kw_only=True)
class _CommonOptions:
    """Options that every command has."""

    json_file: Path | None
    fail_on: str
    quiet: bool
    verbose: bool
    listing: bool

    @classmethod
    def take_from(cls, arguments: dict[str, Any]) -> "_CommonOptions":
        """Return the common options of a command line, and remove them from its arguments."""
        json_file = arguments.pop("json_file", None)
        if json_file is not None:
            json_file = Path(json_file)
        return cls(
            json_file=json_file,
            fail_on=arguments.pop("fail_on"),
            quiet=arguments.pop("quiet"),
            verbose=arguments.pop("verbose"),
            listing=arguments.pop("listing", False),
        )


def _invoke(function: Function, arguments: dict[str, Any]) -> None:
    """Call the function of a verb, print and write its answer, and exit."""
    console.require_environment()
    common = _CommonOptions.take_from(arguments)
    with console.direct_output(
        quiet=common.quiet, verbose=common.verbose, json_file=common.json_file
    ) as output:
        with console.provide_answer_file(common.json_file, output) as json_file:
            interrupt = None
            try:
                if common.listing:
                    answer = _list_choices(function)
                else:
                    with drafts_passed_to(partial(_write_draft, common.json_file)):
                        answer = _call(function, arguments, hidden=common.quiet or common.verbose)
            except Interrupted as error:
                if error.answer is None:
                    raise
                interrupt = error
                answer = cast("Answer", error.answer)
            _write_answer(json_file, answer)
        _print(answer, verbose=common.verbose)
        if common.quiet:
            _print_errors(answer)
        if interrupt is not None:
            raise interrupt
    sys.exit(_exit_code(answer, common.fail_on))


def _write_answer(json_file: Path | None, answer: "Answer") -> None:
    if json_file:
        from hesr_model.support.typed_files import write_json  # slow to import

        write_json(json_file, answer.to_json())


def _write_draft(json_file: Path | None, draft: object) -> None:
    """Write the answer so far; standard output takes one answer only."""
    if json_file != console.STANDARD_OUTPUT:
        _write_answer(json_file, cast("Answer", draft))


def _print(answer: "Answer", *, verbose: bool) -> None:
    summary = answer.full_summary() if verbose else answer.summary()
    if summary:
        click.echo(summary)
    if verbose or answer.shows_tables:
        from cosim.report.tables.terminal import show

        show(*answer.tables())


def _print_errors(answer: "Answer") -> None:
    for finding in answer.findings:
        if finding.severity == "error":
            click.echo(f"hesr: {finding.sentence} [{finding.check}]", err=True)


def _exit_code(answer: "Answer", fail_on: str) -> int:
    if not answer.findings:
        return 0
    from hesr_model.findings import select_by_severity  # slow to import

    if select_by_severity(answer.findings, fail_on):
        return 1
    return 0


def _module(function: Function) -> dict[str, Any]:
    return vars(sys.modules[function.__module__])


def _list_choices(function: Function) -> "Answer":
    """Return the answer to --list."""
    answer: Answer = _module(function)["listing"]()
    return answer


def _call(function: Function, arguments: dict[str, Any], *, hidden: bool) -> "Answer":
    """Return the answer of a verb; an error names options instead of parameters."""
    from cosim.workflow.answer import Answer

    with console.show_progress(is_hidden=hidden) as progress:
        if "progress" in inspect.signature(function).parameters:
            arguments["progress"] = progress
        try:
            result = function(**arguments)
        except HesrError as error:
            sentence = error.format_for_command_line(_list_options())
            if sentence == str(error):
                raise
            raise HesrError(sentence, code=error.code, where=error.where, key=error.key) from error
    if isinstance(result, Answer):
        return result
    answer: Answer = _module(function)["answer"](result, arguments.get("output"))
    return answer


def _list_options() -> dict[str, str]:
    """Return the options of the command, by the name of their parameter."""
    parameters = click.get_current_context().command.params
    return {parameter.name: parameter.opts[-1] for parameter in parameters if parameter.name}


app = _Verbs(
    name="hesr",
    help="From a robot's log to a friction model as an FMU, with proof that it works.",
    epilog=_EPILOG,
    no_args_is_help=True,
    context_settings={"max_content_width": 80},
)
click.version_option(package_name="hesr", message="hesr %(version)s", help="Show the version.")(app)
