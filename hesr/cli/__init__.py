"""Command line: parses, calls, prints. Everything else is imported when a command runs."""

import sys
from typing import NoReturn

from hesr.cli.app import app
from hesr.cli.console import (
    accept_any_text,
    interrupt_on_signals,
    open_closed_streams,
    provide_home,
    report_errors,
)
from hesr_model.support.lazy import collect_seldom
from hesr_model.support.process import keep_current_folder_out

__all__ = ["app", "main"]


def main() -> NoReturn:
    """Run the command line; a user error is one sentence and exit code 2."""
    open_closed_streams()
    collect_seldom()
    keep_current_folder_out()
    accept_any_text()
    provide_home()
    with interrupt_on_signals(), report_errors():
        app()
    sys.exit(0)
