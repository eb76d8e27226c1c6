"""The command that checks FMUs before others see them: check."""

import json
from pathlib import Path
from typing import Annotated

import typer

from cosim.cli.app import app


@app.command()
def check(
    fmus: Annotated[list[Path], typer.Argument(metavar="X.fmu...", help="FMUs of any tool.")],
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
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write it all as JSON.")
    ] = None,
) -> None:
    """Check FMUs by every validator there is; exit code 1 if anything is wrong.

    Example: hesr check Friction.fmu --vdmcheck .tools/vdmcheck2
    """
    from fmu_src.check import check as check_fmu
    from fmu_src.check import opened
    from hesr_model.files import written_whole

    for fmu in fmus:
        opened(fmu).close()  # what cannot be opened is told before the work on others
    reports = []
    for fmu in fmus:
        report = check_fmu(fmu, vdmcheck=vdmcheck)
        reports.append(report)
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
            found[fmu] = measure(fmu)
            Console().print(table(fmu.name, found[fmu]))
    if json_file is not None:
        data = [
            report.to_json() | ({"convention": found[fmu].to_json()} if fmu in found else {})
            for fmu, report in zip(fmus, reports, strict=True)
        ]
        text = json.dumps(data, indent=2)
        with written_whole(json_file) as temporary:
            temporary.write_text(f"{text}\n", encoding="utf-8")
    if any(report.problems for report in reports):
        raise typer.Exit(1)
