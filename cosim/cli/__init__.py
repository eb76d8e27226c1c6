"""The command line: parses, calls, prints. Everything else is imported when a command runs."""

import sys
from typing import NoReturn

import typer

from cosim.cli import (
    check,
    excite,
    export,
    interop,
    job,
    new,
    package,
    properties,
    report,
    simulate,
    steps,
    view,
)
from cosim.cli.app import app
from cosim.cli.voice import ended_by_signals
from hesr_model.errors import HesrError

__all__ = [
    "app",
    "check",
    "excite",
    "export",
    "interop",
    "job",
    "main",
    "new",
    "package",
    "properties",
    "report",
    "simulate",
    "steps",
    "view",
]


def main() -> NoReturn:
    """Run the command line; an error that a user can mend is one sentence and exit code 2."""
    with ended_by_signals():
        try:
            app()
        except HesrError as error:
            typer.echo(f"hesr: {error}", err=True)
            sys.exit(2)
    sys.exit(0)
