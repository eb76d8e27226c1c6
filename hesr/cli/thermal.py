"""The command that finds what temperature does to friction: thermal."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.console import answer, working
from hesr.cli.old_app import Accept, Body, Json, Logs, Output, Robot, app


@app.command()
def thermal(
    logs: Logs,
    law: Annotated[
        Path, typer.Option("--law", metavar="LAW.json", help="Friction model that is fitted.")
    ],
    robot: Robot,
    rigid_body: Body,
    output: Output,
    accept: Accept = None,
    json_file: Json = None,
) -> None:
    """Find what temperature does to friction.

    From logs that hold temperatures; or from long ones that begin cold, by the heat of friction.
    FMUs of the model that is written have both, adaptive ones too.

    Example: hesr thermal cold.csv warm.csv --law law.json --robot robot.toml
    --rigid-body rigid_body.json -o warm_law.json
    """
    from cosim.workflow import commands
    from hesr_model.support.typed_json import to_json

    with working("fitting temperature"):
        model, found = commands.thermal(logs, law, rigid_body, robot, accept=accept or ())
        model.write(output)
    answer(json_file, [to_json(one) for one in found])
    for one in found:
        own = one.thermal
        per = "K" if own.measured else "W of friction"
        typer.echo(
            f"{one.joint}: Coulomb friction falls by {100 * own.coulomb:.2g} ± "
            f"{200 * one.coulomb_error:.1g} % per {per}, viscous by {100 * own.viscous:.2g} ± "
            f"{200 * one.viscous_error:.1g} %; time constant {own.time_constant:.3g} s; error "
            f"{one.rmse_fixed:.3g} -> {one.rmse:.3g}"
        )
    typer.echo(f"written: {output}")
