"""The command that compares the engines on a machine: interop."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import Json, Trust, app, trusted

if TYPE_CHECKING:
    from cosim.interop.case import Case


@app.command()
def interop(
    what: Annotated[
        Path | None,
        typer.Argument(
            metavar="FMU|SSP|SYSTEM.toml", help="Default: the friction of the paper's Table I."
        ),
    ] = None,
    tools: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Folder with engines; default: .tools/interop."),
    ] = None,
    json_file: Json = None,
    trust: Trust = False,
) -> None:
    """Run FMUs in every engine there is, and compare.

    Each engine is compared with our own run of the same FMUs, in the engine's way of coupling. The
    exit code is 1 if one gives something else. Engines run FMUs without limits but on time.

    Example: hesr interop Friction.fmu --json matrix.json
    """
    from cosim.interop.case import Alone
    from cosim.interop.engine import DEFAULT_TOOLS, Tools
    from cosim.interop.matrix import compare
    from cosim.interop.table import notes, table
    from cosim.report.tables.terminal import show

    with (
        TemporaryDirectory(prefix="hesr-") as folder,
        _opened(what, Path(folder)) as case,
        shown_progress() as progress,
    ):
        fmus = [case.fmu] if isinstance(case, Alone) else [c.fmu for c in case.spec.components]
        trusted(fmus, trust=trust)
        chosen = Tools(folder=tools or DEFAULT_TOOLS)
        matrix = compare([case], chosen, progress=partial(progress, case.name))
    show(table(matrix))
    for note in notes(matrix):
        typer.echo(note)
    answer(json_file, matrix.to_json())
    if matrix.failing:
        raise typer.Exit(1)


@contextmanager
def _opened(what: Path | None, folder: Path) -> "Iterator[Case]":
    from cosim.interop.drive import driven
    from cosim.interop.systems import opened_case
    from fmu_src import export_fmu, model_file
    from hesr_model.friction.model import FrictionModel

    if what is None:
        friction = FrictionModel.read(model_file("uf850-table1"))
        yield driven(export_fmu(friction, folder / "Friction.fmu"))
    elif what.suffix.lower() in (".toml", ".ssp"):
        with opened_case(what, folder) as case:
            yield case
    else:
        yield driven(what)
