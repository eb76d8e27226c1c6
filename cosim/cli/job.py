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
    if outcome.loop:
        from cosim import loop_tables

        for table in loop_tables.outcome(outcome.loop):
            console.print(table)
    console.print("The figures are those of the FMUs, run through FMPy over the test logs:")
    for fmu in outcome.fmus.values():
        console.print(f"  {fmu}", soft_wrap=True, highlight=False)
    console.print(f"Everything is in {folder}.", soft_wrap=True, highlight=False)


@app.command()
def export(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL",
            help="Friction model (JSON), uf850-table1 (the paper's), or an MJCF (XML).",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="FMU to write.")],
    platform: Platforms = None,
    signals: Annotated[
        Path | None,
        typer.Option(
            metavar="TABLE.toml",
            help="Of an MJCF: its inputs and outputs; default: every control and every sensor.",
        ),
    ] = None,
) -> None:
    """Write a friction model, or a robot that MuJoCo simulates, as an FMU.

    Examples: hesr export law.json -o Friction.fmu --platform linux64 --platform win64;
    hesr export robot.xml -o Arm.fmu --signals arm.toml
    """
    platforms = platform or ["linux64"]
    if Path(model).suffix.lower() == ".xml":
        from fmu_src.arm.native import export_mjcf

        export_mjcf(Path(model), output, table=signals, platforms=platforms)
    else:
        from fmu_src import export_fmu, model_file
        from hesr_model.artifacts import read_model
        from hesr_model.errors import ConfigError

        if signals is not None:
            raise ConfigError(f"--signals is for an MJCF, a file in .xml; '{model}' is none.")
        export_fmu(read_model(model_file(model)), output, platforms=platforms)
    typer.echo(f"written to {output}.")


@app.command()
def laws() -> None:
    """List the laws that can be fitted."""
    from rich.console import Console

    from cosim import tables

    Console().print(tables.laws())
