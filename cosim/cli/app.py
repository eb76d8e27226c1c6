"""The application and what its commands share: options, reading of logs, progress, tables."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from cosim.scoring import Records

app = typer.Typer(
    name="hesr",
    help="From a robot's log to a friction model as an FMU, with proof that it works.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Logs = Annotated[list[Path], typer.Argument(metavar="LOG...", help="CSV or Parquet files.")]
Robot = Annotated[Path, typer.Option("--robot", metavar="ROBOT.toml", help="Robot file.")]
Body = Annotated[
    Path, typer.Option("--rigid-body", metavar="FILE", help="Result of 'hesr identify'.")
]
Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]
Json = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Also write the scores as JSON.")
]
Platforms = Annotated[
    list[str] | None,
    typer.Option(
        "--platform", help="linux64, win64, darwin64, aarch64-linux or all; may be repeated."
    ),
]


def read_records(logs: list[Path], robot: Path, rigid_body: Path) -> "tuple[Records, str, Path]":
    """Return the friction records [joint][log], the robot's name and its model file."""
    from cosim.scoring import by_joint
    from hesr_model.artifacts import read_rigid_body
    from hesr_model.residual import friction_records
    from hesr_model.robot import RobotDescription, RobotModel
    from hesr_model.robot_log import RobotLog

    description = RobotDescription.read(robot)
    model = RobotModel(description)
    body = read_rigid_body(rigid_body)
    read = [RobotLog.read(log, description) for log in logs]
    records = by_joint([friction_records(log, model, body) for log in read])
    return records, description.name, description.model


@contextmanager
def shown_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show progress on standard error, where that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    tasks: dict[str, TaskID] = {}
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as shown:

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = shown.add_task(what, total=total)
            shown.update(tasks[what], completed=done)

        yield tell
