"""The command that checks FMUs before others see them: check."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.app import Json, Trust, app, trusted
from hesr.cli.console import answer, shown_progress, working

if TYPE_CHECKING:
    from fmu_src.check.report import Report


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
    hostile: Annotated[
        bool,
        typer.Option(
            "--hostile",
            help="Also run them under a master at its worst: odd steps, steps taken back.",
        ),
    ] = False,
    references: Annotated[
        bool,
        typer.Option(
            "--references", help="Also run them against the reference results that they carry."
        ),
    ] = False,
    json_file: Json = None,
    trust: Trust = False,
) -> None:
    """Check FMUs by every validator there is.

    The exit code is 1 if anything is wrong. No code of an FMU is run but with --convention,
    --hostile and --references. An SSP is checked by its reference results alone.

    Example: hesr check Friction.fmu --vdmcheck .tools/vdmcheck2
    """
    from fmu_src.check import check as check_fmu
    from fmu_src.check import opened
    from fmu_src.check.report import Report
    from hesr_model.errors import ConfigError

    systems = [fmu for fmu in fmus if fmu.suffix.lower() == ".ssp"]
    if systems and (not references or convention or hostile):
        raise ConfigError(
            f"{systems[0]}: of an SSP the reference results are checked and nothing else; give "
            "--references, and neither --convention nor --hostile."
        )
    for fmu in fmus:
        if fmu not in systems:
            opened(fmu).close()  # what cannot be opened is told before the work on others
    if convention:
        from fmu_src.check.convention import judge

        for fmu in fmus:
            judge(fmu)  # nor is anything done for what cannot be measured
    trusted(fmus, trust=trust)
    reports = []
    with shown_progress() as progress:
        for k, fmu in enumerate(fmus):
            progress("checking", k, len(fmus))
            report = (
                Report(fmu, (), ())
                if fmu in systems
                else check_fmu(fmu, vdmcheck=vdmcheck, hostile=hostile)
            )
            reports.append(_with_references(report) if references else report)
    for fmu, report in zip(fmus, reports, strict=True):
        for problem in report.problems:
            typer.echo(f"{fmu}: [{problem.check}] {problem.found}")
        for reason in report.skipped:
            typer.echo(f"{fmu}: not run: {reason}")
        typer.echo(f"{fmu}: {report.verdict}")
    found = {}
    if convention:
        from cosim.report.tables.laws import convention as table
        from cosim.report.tables.terminal import show
        from fmu_src.check.convention import measure

        for fmu in fmus:
            with working(f"measuring {fmu.name}"):
                found[fmu] = measure(fmu)
            show(table(fmu.name, found[fmu]))
    if json_file is not None:
        from hesr_model.support.typed_json import to_json

        data = [
            report.to_json() | ({"convention": to_json(found[fmu])} if fmu in found else {})
            for fmu, report in zip(fmus, reports, strict=True)
        ]
        answer(json_file, data)
    if any(report.problems for report in reports):
        raise typer.Exit(1)


def _with_references(report: "Report") -> "Report":
    """Return a report with what came of the FMU's reference results."""
    from dataclasses import replace

    from cosim.systems.ssp_results import verify_ssp
    from fmu_src.check.report import problems_of
    from fmu_src.run.reference_results import verify

    system = report.path.suffix.lower() == ".ssp"
    found = (verify_ssp if system else verify)(report.path)
    return replace(
        report,
        problems=(*report.problems, *problems_of("references", found.problems)),
        skipped=(*report.skipped, *found.skipped),
    )
