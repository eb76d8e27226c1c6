"""The page of a fleet."""

from pathlib import Path

from markupsafe import Markup

from cosim.report.markup import Section, joined, paragraph, table, write_sections
from hesr.extras.fleet import tables
from hesr.extras.fleet.result import Fleet


def write_page(fleet: Fleet, path: Path) -> None:
    """Write the page."""
    rows = sum(robot.rows for robot in fleet.robots)
    logs = sum(robot.logs for robot in fleet.robots)
    text = (
        f"{len(fleet.robots)} robots, {logs} logs, {rows} rows. fleet.parquet has a row for each "
        "robot, law and joint; robots/ has the rigid body, laws and parameter sets of each robot, "
        "types/ the FMUs."
    )
    write_sections(
        path,
        title=f"HESR fleet: {fleet.name}",
        heading=f"Fleet ‘{fleet.name}’",
        summary=paragraph(text),
        sections=[
            Section(
                key=f"table-{k}",
                title=one.caption,
                html=joined(table(one), paragraph(one.note, note=True) if one.note else Markup()),
            )
            for k, one in enumerate(tables.all_tables(fleet))
        ],
    )
