"""The command that looks at many robots: fleet."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Folder, Json, Workers, app


@app.command()
def fleet(
    file: Annotated[
        Path, typer.Argument(metavar="FLEET.toml", help="Types of robots, and their logs.")
    ],
    output: Folder = None,
    workers: Workers = None,
    json_file: Json = None,
) -> None:
    """Find which of many robots deviate from their type.

    Rigid body and friction laws of each robot, from any number of logs. A fleet that was
    interrupted goes on when it is started again; so does one that has new logs. The exit code is 1
    if logs of some robots could not be used.

    Example: hesr fleet fleet.toml -o results/fleet
    """
    from cosim.report.tables.terminal import show
    from hesr.extras.fleet import tables
    from hesr.extras.fleet.run import PAGE, run_fleet
    from hesr.extras.fleet.study import FleetStudy
    from hesr_model.support.typed_json import to_json

    folder = output or Path("results") / FleetStudy.read(file).name
    with shown_progress() as progress:
        found = run_fleet(file, folder, workers=workers, progress=progress)
    broken = list(found.broken)
    answer(
        json_file,
        {
            "folder": str(folder),
            "robots": len(found.robots),
            "reused": found.reused,
            "deviants": [to_json(one) for one in found.deviants],
            "changes": [to_json(one) for one in found.changes],
            "not_used": {r.robot: [*filter(None, [r.failure]), *r.refused] for r in broken},
        },
    )
    show(*tables.all_tables(found))
    if found.reused:
        show(f"{found.reused} of {len(found.robots)} robots were there already.")
    typer.echo(f"Everything is in {folder}; look at {folder / PAGE}.")
    raise typer.Exit(1 if broken else 0)
