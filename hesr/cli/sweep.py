"""The command that runs a system many times: sweep."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Json, Workers, app, require_table
from hesr_model.support import plugins


@app.command()
def sweep(
    study: Annotated[
        Path, typer.Argument(metavar="STUDY.toml", help="What is varied and measured.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="PATH",
            help="Folder, or the file of --replay; default: results/NAME.",
        ),
    ] = None,
    workers: Workers = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster",
            metavar="ADDRESS",
            help="Scheduler of dask.distributed.",
        ),
    ] = None,
    run: Annotated[
        int | None,
        typer.Option("--replay", metavar="RUN", min=0, help="Do one run again; write its signals."),
    ] = None,
    json_file: Json = None,
) -> None:
    """Run a system of FMUs many times, each with other values.

    A sweep that was interrupted goes on when it is started again.

    Example: hesr sweep payload.toml -o results/payload
    """
    from cosim.report.tables.terminal import show

    if run is not None:
        require_table(output or Path("run.csv"))
    job = plugins.find("hesr.jobs", "sweep")
    with shown_progress() as progress:
        found = job.run(
            study, output=output, only=run, workers=workers, cluster=cluster, progress=progress
        )
    answer(json_file, found.to_json())
    show(*found.tables())
    typer.echo(found.summary())
