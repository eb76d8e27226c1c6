"""Command line: parses, calls, prints. Everything else is imported when a command runs."""

import sys
from typing import NoReturn

from hesr.cli.app import app
from hesr.cli.console import ended_by_signals, errors_said, home_where_needed, plain_where_needed
from hesr_model.support.lazy import collect_seldom

__all__ = ["app", "main"]


def main() -> NoReturn:
    """Run the command line; a user error is one sentence and exit code 2."""
    collect_seldom()
    plain_where_needed()
    home_where_needed()
    with ended_by_signals(), errors_said():
        app()
    sys.exit(0)
