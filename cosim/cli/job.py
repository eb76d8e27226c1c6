"""Commands of the whole job: run, export, laws."""

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import Platforms, app, shown_progress


@app.command()
def run(
    study: Annotated[
        Path | None, typer.Argument(metavar="[STUDY.toml]", help="Default: the digital twin.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder; default: results/NAME.")
    ] = None,
    platform: Platforms = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Stribeck, LuGre and ParFam-H only.")
    ] = False,
) -> None:
    """Do the main job: identify, fit all laws, build FMUs and score them on unseen motions.

    Example: hesr run tests/real/ur10e_study.toml -o results/ur10e
    """
    from rich.console import Console

    from cosim import tables
    from cosim.run import run_study
    from cosim.scoring import inputs_of
    from cosim.study import Study
    from hesr_model.files import models_folder

    path = study or models_folder() / "studies" / "default.toml"
    folder = output or Path("results") / Study.read(path).name
    with shown_progress() as progress:
        outcome = run_study(
            path, folder, platforms=platform or ["linux64"], quick=quick, progress=progress
        )
    console = Console()
    console.print(tables.rigid_body(outcome.rigid_body))
    inputs = {law: inputs_of(model) for law, model in outcome.models.items()}
    for name, comparison in outcome.comparisons.items():
        for measure in ("rmse", "rmse_moving", "rmse_reversal"):
            console.print(tables.comparison(name, comparison, measure, inputs))
        if comparison.ratios:
            console.print(tables.ratios(name, comparison, inputs))
    console.print("The figures are those of the FMUs, run through FMPy over the test logs:")
    for fmu in outcome.fmus.values():
        console.print(f"  {fmu}", soft_wrap=True, highlight=False)
    console.print(f"Everything is in {folder}.", soft_wrap=True, highlight=False)


@app.command()
def export(
    law: Annotated[
        str,
        typer.Argument(metavar="LAW.json", help="Friction model, or uf850-table1 (the paper's)."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="FMU to write.")],
    platform: Platforms = None,
) -> None:
    """Write a friction model as an FMU.

    Example: hesr export law.json -o Friction.fmu --platform linux64 --platform win64
    """
    from fmu_src import export_fmu, model_file
    from hesr_model.artifacts import read_model

    export_fmu(read_model(model_file(law)), output, platforms=platform or ["linux64"])
    typer.echo(f"written to {output}.")


@app.command()
def laws() -> None:
    """List the laws that can be fitted."""
    from rich.console import Console

    from cosim import tables

    Console().print(tables.laws())
