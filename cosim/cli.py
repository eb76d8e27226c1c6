"""The command line: parses, calls, prints. Everything else is imported when a command runs."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from hesr_model.errors import HesrError

if TYPE_CHECKING:
    from cosim.scoring import Comparison, Records

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


def main() -> NoReturn:
    """Run the command line; an error that a user can mend is one sentence and exit code 2."""
    try:
        app()
    except HesrError as error:
        typer.echo(f"hesr: {error}", err=True)
        sys.exit(2)
    sys.exit(0)


@app.command()
def run(
    study: Annotated[
        Path | None, typer.Argument(metavar="[STUDY.toml]", help="Default: the digital twin.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Folder; default: results/NAME.")
    ] = None,
    platform: Platforms = None,
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
    with _progress() as progress:
        outcome = run_study(path, folder, platforms=platform or ["linux64"], progress=progress)
    console = Console()
    console.print(
        f"Rigid body: {len(outcome.rigid_body.base)} base parameters of "
        f"{len(outcome.rigid_body.names)}, from {', '.join(outcome.rigid_body.logs)}."
    )
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
def identify(
    logs: Logs,
    robot: Robot,
    output: Output,
    reversed_logs: Annotated[
        list[Path] | None,
        typer.Option("--reversed", metavar="LOG", help="Time-reversed counterpart; repeatable."),
    ] = None,
    method: Annotated[
        str,
        typer.Option(help="stacked (least squares with friction columns) or paper (averaging)."),
    ] = "stacked",
) -> None:
    """Identify the rigid body from logs.

    Example: hesr identify excitation.csv --robot robot.toml -o rigid_body.json
    """
    from hesr_model.artifacts import provenance, write_rigid_body
    from hesr_model.errors import ConfigError
    from hesr_model.rigid_body import identify as identify_rigid_body
    from hesr_model.robot import RobotDescription, RobotModel
    from hesr_model.robot_log import RobotLog

    if method not in ("stacked", "paper"):
        raise ConfigError(f"--method is '{method}'; allowed are 'stacked' and 'paper'.")
    description = RobotDescription.read(robot)
    counterparts = reversed_logs or []
    found = identify_rigid_body(
        [RobotLog.read(log, description) for log in logs],
        RobotModel(description),
        method=method,
        reversed_logs=[RobotLog.read(log, description) for log in counterparts],
    )
    files = [robot, description.model, *logs, *counterparts]
    write_rigid_body(output, found, provenance(files=files))
    errors = ", ".join(f"{e:.3g}" for e in found.rmse)
    typer.echo(
        f"{len(found.base)} base parameters of {len(found.names)}, condition "
        f"{found.condition:.3g}, residual RMSE {errors} N.m; written to {output}."
    )


@app.command()
def fit(
    logs: Logs,
    robot: Robot,
    rigid_body: Body,
    law: Annotated[str, typer.Option(help="Name of a law; see 'hesr laws'.")],
    output: Output,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the fit.")] = 0,
) -> None:
    """Fit a friction law to the joints of a robot.

    Example: hesr fit sweep.csv --robot robot.toml --rigid-body rigid_body.json --law parfam_h
    -o law.json
    """
    from hesr_model.artifacts import provenance, write_model
    from hesr_model.friction.estimator import estimator
    from hesr_model.friction.fit import fit_models

    estimator(law)
    records, name, model_file = _records(logs, robot, rigid_body)
    source = provenance(files=[robot, model_file, rigid_body, *logs], seed=seed)
    with _progress() as progress:
        models = fit_models(
            [law],
            records,
            robot=name,
            seed=seed,
            provenance=source,
            progress=partial(progress, f"fitting {law}"),
        )
    write_model(output, models[law])
    typer.echo(f"{law} for {', '.join(models[law].joints)}; written to {output}.")


@app.command()
def evaluate(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="LOG... LAW.json...", help="Logs, and friction models (.json)."),
    ],
    robot: Robot,
    rigid_body: Body,
    json_file: Json = None,
) -> None:
    """Score friction models on logs.

    Example: hesr evaluate test.csv --robot robot.toml --rigid-body rigid_body.json law.json
    """
    from cosim.scoring import compare, predict_model
    from hesr_model.artifacts import read_model
    from hesr_model.errors import ConfigError

    law_files = [file for file in files if file.suffix == ".json"]
    logs = [file for file in files if file.suffix != ".json"]
    if not law_files or not logs:
        missing = "friction model (.json)" if logs else "log (.csv or .parquet)"
        raise ConfigError(f"evaluate: no {missing} among the files; both kinds are needed.")
    models = [read_model(file) for file in law_files]
    names = [model.law for model in models]
    unique = len(set(names)) == len(names)
    records, _, _ = _records(logs, robot, rigid_body)
    predictions = {
        model.law if unique else file.stem: predict_model(model, records)
        for file, model in zip(law_files, models, strict=True)
    }
    _show(compare(records, predictions), "evaluation", json_file)


@app.command()
def replay(
    fmu: Annotated[Path, typer.Argument(metavar="Friction.fmu", help="A friction FMU.")],
    logs: Logs,
    robot: Robot,
    rigid_body: Body,
    json_file: Json = None,
) -> None:
    """Run a friction FMU over logs through FMPy and score it.

    Example: hesr replay law.fmu test.csv --robot robot.toml --rigid-body rigid_body.json
    """
    from cosim.scoring import compare, predict_fmu

    records, _, _ = _records(logs, robot, rigid_body)
    _show(compare(records, {fmu.stem: predict_fmu(fmu, records)}), "replay", json_file)


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


def _records(logs: list[Path], robot: Path, rigid_body: Path) -> "tuple[Records, str, Path]":
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


def _show(scores: "Comparison", name: str, json_file: Path | None) -> None:
    from rich.console import Console

    from cosim import tables

    if json_file is not None:
        from hesr_model.artifacts import write_json

        write_json(json_file, scores.to_json())
    for measure in ("rmse", "rmse_reversal"):
        Console().print(tables.comparison(name, scores, measure))


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show progress on standard error, where that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress, TaskID

    tasks: dict[str, TaskID] = {}
    with Progress(console=Console(stderr=True), transient=True) as shown:

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = shown.add_task(what, total=total)
            shown.update(tasks[what], completed=done)

        yield tell
