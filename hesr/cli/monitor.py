"""The command that follows friction over days of logs: monitor."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, working
from hesr.cli.old_app import Accept, Body, Json, Logs, Robot, app


@app.command()
def monitor(
    logs: Logs,
    law: Annotated[
        Path, typer.Option("--law", metavar="LAW.json", help="Friction model, of other logs.")
    ],
    robot: Robot,
    rigid_body: Body,
    page: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="PAGE.html", help="Page to write.")
    ] = None,
    accept: Accept = None,
    json_file: Json = None,
) -> None:
    """Follow friction over days of logs: bands, alarms, trends.

    Example: hesr monitor monday.csv tuesday.csv --law law.json --robot robot.toml
    --rigid-body rigid_body.json -o page.html
    """
    from cosim.workflow import commands
    from hesr_model.support.typed_json import to_json

    with working("following friction"):
        watched = commands.monitor(logs, law, rigid_body, robot, accept=accept or ())
        if page:
            from hesr.extras.adaptive.page import write_monitor

            write_monitor(page, watched)
    data = {
        "states": [to_json(s) for s in watched.states],
        "alarms": [to_json(a) | {"points_to": a.points_to} for a in watched.alarms],
    }
    answer(json_file, data)
    for alarm in watched.alarms:
        way = "more" if alarm.sign > 0 else "less"
        typer.echo(
            f"{alarm.log}, {alarm.joint}, {alarm.time:.1f} s: {way} than known ({alarm.kind}); "
            f"points to {alarm.points_to}."
        )
    for s in watched.states[-len(watched.model.joints) :]:
        typer.echo(
            f"{s.joint}: level {s.level:.3f} ± {2 * s.level_sd:.3f}, viscous factor "
            f"{s.viscosity:.3f} ± {2 * s.viscosity_sd:.3f}, offset {s.offset:.3g} ± "
            f"{2 * s.offset_sd:.2g}"
        )
    if page:
        typer.echo(f"written: {page}")
