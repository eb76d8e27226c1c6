"""The command that looks at logs before anything is learned from them: inspect."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.console import answer, working
from hesr.cli.old_app import Json, Logs, app

if TYPE_CHECKING:
    from hesr_model.health.proposal import Proposal


@app.command()
def inspect(
    logs: Logs,
    robot: Annotated[
        Path | None,
        typer.Option(
            "--robot", metavar="ROBOT", help="Robot file (.toml), or the robot's URDF or MJCF."
        ),
    ] = None,
    page: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="PAGE.html", help="Page to write, or picture (.svg)."
        ),
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", metavar="ROBOT.toml", help="Robot file to write as proposed."),
    ] = None,
    study: Annotated[
        Path | None,
        typer.Option(
            "--study", metavar="STUDY.toml", help="Study of these logs to write, for 'hesr run'."
        ),
    ] = None,
    json_file: Json = None,
) -> None:
    """Say what is wrong or odd in logs.

    A page shows them; a robot file that reads them is proposed, with a reason for each line, and a
    study that 'hesr run' runs.

    Example: hesr inspect log.csv --robot my_arm.urdf --write robot.toml --study study.toml
    """
    from hesr_model.errors import ConfigError
    from hesr_model.health.proposal import inspected, robot_file
    from hesr_model.support.files import written_whole
    from hesr_model.support.typed_json import to_json

    if write and not robot:
        raise ConfigError("--write needs --robot: a robot file names the robot's model.")
    if study and not write:
        raise ConfigError(
            "--study needs --write: a study names the robot file that reads its logs."
        )
    with working("looking at the logs"):
        proposal = inspected(logs, robot)
        if page:
            from cosim.report.inspection import write_inspection

            write_inspection(page, proposal)
        if write:
            with written_whole(write) as temporary:
                temporary.write_text(robot_file(proposal, write), encoding="utf-8")
            if study:
                from cosim.study.proposal import study_file

                with written_whole(study) as temporary:
                    temporary.write_text(study_file(proposal, write, study), encoding="utf-8")
    answer(
        json_file,
        {
            "given": [to_json(finding) for finding in proposal.first],
            "proposed": [to_json(finding) for finding in proposal.examination.findings],
            "reasons": dict(proposal.reasons),
        },
    )
    _print(proposal)
    for path in filter(None, (page, write, study)):
        typer.echo(f"written: {path}")
    if study:
        typer.echo(f"Next: hesr run {study}")


def _print(proposal: "Proposal") -> None:
    from rich.console import Console

    from cosim.report.tables.table import ResultTable, TableRow, row_of
    from cosim.report.tables.terminal import show
    from hesr_model.health.proposal import HEAD, summary_rows

    for log in proposal.logs:
        count = len(log.gaps)
        gaps = f", {count} gap{'s' * (count > 1)}" if count else ""
        dropped = f", {log.dropped} rows left out" if log.dropped else ""
        Console().print(
            f"{log.name}: {len(log.t)} rows, {log.t[-1] - log.t[0]:.1f} s, {log.rate:.4g} Hz, "
            f"jitter {100 * log.jitter:.0f} %{gaps}{dropped}",
            highlight=False,
        )
    by_log: dict[str, list[TableRow]] = {}
    for name, joint, *cells in summary_rows(proposal):
        by_log.setdefault(name, []).append(row_of(joint, *cells))
    show(*(ResultTable(caption=name, head=HEAD[1:], rows=rows) for name, rows in by_log.items()))
    told = {
        "As given": proposal.first,
        "With the proposed robot file": proposal.examination.findings if proposal.reasons else (),
    }
    for heading, findings in told.items():
        if findings:
            show(f"{heading}:")
        for finding in findings:
            mark = "WRONG" if finding.severity == "error" else "odd"
            typer.echo(f"  {mark}: {finding.sentence}")
    if not proposal.first:
        show("Nothing wrong or odd was found.")
    for key, reason in proposal.reasons.items():
        typer.echo(f"  proposed: {key}: {reason}")
