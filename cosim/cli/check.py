"""The command that checks FMUs before others see them: check."""

from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import Json, app
from cosim.cli.voice import answer, shown_progress, working


@app.command()
def check(
    fmus: Annotated[list[Path], typer.Argument(metavar="X.fmu", help="FMUs of any tool.")],
    vdmcheck: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder with VDMCheck2; default: .tools/vdmcheck2, where that is there.",
        ),
    ] = None,
    convention: Annotated[
        bool,
        typer.Option(
            "--convention", help="Also measure what each way of handing inputs over costs."
        ),
    ] = False,
    json_file: Json = None,
) -> None:
    """Check FMUs by every validator there is.

    The exit code is 1 if anything is wrong.

    Example: hesr check Friction.fmu --vdmcheck .tools/vdmcheck2
    """
    from fmu_src.check import check as check_fmu
    from fmu_src.check import opened

    for fmu in fmus:
        opened(fmu).close()  # what cannot be opened is told before the work on others
    if convention:
        from cosim.convention import judge

        for fmu in fmus:
            judge(fmu)  # nor is anything done for what cannot be measured
    reports = []
    with shown_progress() as progress:
        for k, fmu in enumerate(fmus):
            progress("checking", k, len(fmus))
            reports.append(check_fmu(fmu, vdmcheck=vdmcheck))
    for fmu, report in zip(fmus, reports, strict=True):
        for problem in report.problems:
            typer.echo(f"{fmu}: [{problem.check}] {problem.text}")
        for reason in report.skipped:
            typer.echo(f"{fmu}: not run: {reason}")
        typer.echo(f"{fmu}: {report.verdict}")
    found = {}
    if convention:
        from rich.console import Console

        from cosim.convention import measure
        from cosim.tables import convention as table

        for fmu in fmus:
            with working(f"measuring {fmu.name}"):
                found[fmu] = measure(fmu)
            Console().print(table(fmu.name, found[fmu]))
    if json_file is not None:
        data = [
            report.to_json() | ({"convention": found[fmu].to_json()} if fmu in found else {})
            for fmu, report in zip(fmus, reports, strict=True)
        ]
        answer(json_file, data)
    if any(report.problems for report in reports):
        raise typer.Exit(1)
