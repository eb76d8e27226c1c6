"""Commands of the whole job: run, laws."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import Json, Platforms, app
from cosim.cli.voice import Interrupted, answer, answer_file, shown_progress


@app.command()
def run(
    study: Annotated[
        Path | None, typer.Argument(metavar="STUDY.toml", help="Default: the digital twin.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FOLDER", help="Folder; default: results/NAME."),
    ] = None,
    platform: Platforms = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Stribeck, LuGre and ParFam-H only.")
    ] = False,
    json_file: Json = None,
) -> None:
    """Do the whole job: identify, fit, build FMUs and score them.

    The scores are those of the FMUs on motions that the laws have not seen. A run that was
    interrupted in its closed loop goes on there when it is started again.

    Example: hesr run tests/real/ur10e_study.toml -o results/ur10e
    """
    from rich.console import Console

    from cosim import tables
    from cosim.run import run_study, unfinished
    from cosim.scoring import inputs_of
    from cosim.study import Study
    from hesr_model.artifacts import write_json
    from hesr_model.files import models_folder

    path = study or models_folder() / "studies" / "default.toml"
    folder = output or Path("results") / Study.read(path).name
    with answer_file(json_file) as wanted:
        with shown_progress() as progress, _going_on(unfinished(folder)):
            outcome = run_study(
                path, folder, platforms=platform or ["linux64"], quick=quick, progress=progress
            )
        if wanted:
            write_json(wanted, {"folder": str(folder)} | outcome.to_json())
    console = Console()
    sliding = next(iter(outcome.models.values())).sliding
    console.print(tables.rigid_body(outcome.rigid_body, sliding))
    inputs = {law: inputs_of(model) for law, model in outcome.models.items()}
    for name, comparison in outcome.comparisons.items():
        for measure in ("rmse", "rmse_moving", "rmse_reversal"):
            console.print(tables.comparison(name, comparison, measure, inputs, sliding))
        if comparison.ratios:
            console.print(tables.ratios(name, comparison, inputs))
    if outcome.loop:
        from cosim import loop_tables

        for table in loop_tables.outcome(outcome.loop):
            console.print(table)
    if outcome.properties:
        from cosim import property_tables

        console.print(property_tables.properties(outcome.properties))
        console.print(property_tables.legend(sliding))
    console.print("The figures are those of the FMUs, run through FMPy over the test logs:")
    for fmu in outcome.fmus.values():
        console.print(f"  {fmu}", soft_wrap=True, highlight=False)
    report = folder / "report.html"
    console.print(f"Everything is in {folder}; look at {report}.", soft_wrap=True, highlight=False)


@contextmanager
def _going_on(kept: Path) -> Iterator[None]:
    """Say on an interrupt what the next run goes on from."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        rows = len(list(kept.glob("*.json")))
        if not rows:
            raise
        raise Interrupted(
            f"{rows} finished rows of the closed loop are kept in {kept}: the same command goes on "
            "from there",
            interrupt,
        ) from interrupt


@app.command()
def laws(json_file: Json = None) -> None:
    """List the laws that can be fitted.

    Example: hesr laws --json laws.json
    """
    from rich.console import Console

    from cosim import tables
    from hesr_model.friction.laws import registry

    Console().print(tables.laws())
    answer(
        json_file,
        {name: {"title": law.title, "equation": law.equation} for name, law in registry().items()},
    )
