"""The command that runs a system many times: sweep."""

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import Json, app
from cosim.cli.console import answer, shown_progress


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
    workers: Annotated[
        int | None,
        typer.Option("--workers", metavar="N", min=1, help="Processes; default: one a core."),
    ] = None,
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
    from rich.console import Console

    from cosim.sweep.run import PAGE, run_sweep
    from cosim.sweep.study import SweepStudy
    from cosim.tables import swept as tables
    from cosim.tables.terminal import Drawn

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
    console = Console()
    console.print(Drawn(tables.outputs(found)))
    for table in tables.sensitivities(found):
        console.print(Drawn(table))
    if found.reused:
        console.print(f"{found.reused} of {len(values.failures)} runs were there already.")
    for k, one in enumerate(found.plan.study.outputs):
        console.print(
            f"Worst by {one.name}: hesr sweep {study} --replay {found.worst(k)[0]} -o run.csv",
            soft_wrap=True,
            highlight=False,
        )
    console.print(
        f"Everything is in {folder}; look at {folder / PAGE}.", soft_wrap=True, highlight=False
    )


def _replay(study: Path, run: int, output: Path | None) -> None:
    from cosim.sweep.run import replay
    from hesr_model.errors import ConfigError

    file = output or Path(f"run{run}.csv")
    if file.suffix.lower() not in (".csv", ".parquet", ".pq"):
        raise ConfigError(f"{file}: results are written as .csv or .parquet.")
    plan, result = replay(study, run)
    if len(result.t):
        result.write(file)
    for name, value in zip(plan.study.names, plan.values[run], strict=True):
        typer.echo(f"{name} = {value:.9g}")
    result.require_success()
    for one, value in zip(plan.study.outputs, plan.task.measured(result), strict=True):
        typer.echo(f"{one.name}: {value:.9g}")
    typer.echo(f"{len(result.t)} samples of {len(result.signals)} signals, written to {file}.")
