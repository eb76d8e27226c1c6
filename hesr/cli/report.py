"""Command of the report."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import shown_progress
from hesr.cli.old_app import Result, app


@app.command()
def report(
    result: Result,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="Page to write; default: RESULT/report.html.",
        ),
    ] = None,
) -> None:
    """Write the report of a run anew.

    It is one page that opens from a file, without a network.

    Example: hesr report results/uf850 -o uf850.html
    """
    from cosim.report.page import write_report

    with shown_progress() as progress:
        page = write_report(result, output, progress=progress)
    typer.echo(f"written to {page}.")


@app.command()
def results(
    folders: Annotated[
        list[Path], typer.Argument(metavar="RESULT...", help="Folders that 'hesr run' has written.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="FILE", help="Page of Markdown to write.")
    ] = Path("results.md"),
) -> None:
    """Write the tables of runs as a page of Markdown.

    It is for a repository: every figure comes from the files of the runs.

    Example: hesr results results/uf850 results/ur10e -o docs/results.md
    """
    from cosim.report.digest import write_digest

    typer.echo(f"written to {write_digest(folders, output)}.")
