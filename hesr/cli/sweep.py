"""The command that runs a system many times: sweep."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Json, Workers, app, require_table


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
    if run is not None:
        _replay(study, run, output)
        return
    from cosim.report.tables.terminal import show
    from hesr.extras.sweep import tables
    from hesr.extras.sweep.run import PAGE, run_sweep
    from hesr.extras.sweep.study import SweepStudy

    folder = output or Path("results") / SweepStudy.read(study).name
    with shown_progress() as progress:
        found = run_sweep(study, folder, workers=workers, cluster=cluster, progress=progress)
    values = found.table
    answer(
        json_file,
        {
            "folder": str(folder),
            "runs": len(values.failures),
            "reused": found.reused,
            "failed": sum(map(bool, values.failures)),
            "worst": {o.name: found.worst(k) for k, o in enumerate(found.plan.study.outputs)},
            "sensitivities": {
                one.output: {"first": one.first.tolist(), "total": one.total.tolist()}
                for one in found.sensitivities
            },
        },
    )
    show(tables.outputs(found), *tables.sensitivities(found))
    if found.reused:
        show(f"{found.reused} of {len(values.failures)} runs were there already.")
    for k, one in enumerate(found.plan.study.outputs):
        run = found.worst(k)[0]
        typer.echo(f"Worst by {one.name}: hesr sweep {study} --replay {run} -o run.csv")
    typer.echo(f"Everything is in {folder}; look at {folder / PAGE}.")


def _replay(study: Path, run: int, output: Path | None) -> None:
    from hesr.extras.sweep.run import replay

    file = output or Path(f"run{run}.csv")
    require_table(file)
    plan, result = replay(study, run)
    if len(result.t):
        result.write(file)
    for name, value in zip(plan.study.names, plan.values[run], strict=True):
        typer.echo(f"{name} = {value:.9g}")
    result.require_success()
    for one, value in zip(plan.study.outputs, plan.task.measured(result), strict=True):
        typer.echo(f"{one.name}: {value:.9g}")
    typer.echo(f"{len(result.t)} samples of {len(result.signals)} signals, written to {file}.")
