"""The command that asks whether laws behave as friction does: properties."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.console import answer_file, shown_progress
from hesr.cli.given_law import given_law
from hesr.cli.numbers import numbers
from hesr.cli.old_app import Json, Trust, app, trusted
from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from cosim.properties.battery import Subject


@app.command()
def properties(
    laws: Annotated[
        list[str],
        typer.Argument(
            metavar="LAW",
            help="Friction models (.json), friction FMUs (.fmu) of any tool, or uf850-table1.",
        ),
    ],
    inertia: Annotated[
        str | None,
        typer.Option(
            metavar="J[,J...]",
            help="Inertia of the joints in kg.m2, one or one for each; default for the uf850: "
            "3,3,0.6.",
        ),
    ] = None,
    load: Annotated[
        float,
        typer.Option(
            metavar="TAU",
            help="Load torque of the joints in N.m, where an experiment has none of its own.",
        ),
    ] = 0.0,
    why: Annotated[bool, typer.Option("--why", help="Also say why, joint by joint.")] = False,
    json_file: Json = None,
    trust: Trust = False,
) -> None:
    """Put friction laws to the test: memory, stick-slip, work done.

    Every law runs through the same thirteen experiments, as an FMU: moved by velocities, and as a
    JointDrive under torques. A foreign FMU runs through those that need its connectors only.

    Example: hesr properties uf850-table1 laws/lugre.json Friction.fmu --why
    """
    from math import isfinite

    from cosim.properties.battery import run_battery
    from cosim.report.tables import properties as tables
    from cosim.report.tables.terminal import show
    from hesr_model.audit.properties import write_properties

    if not isfinite(load):
        raise ConfigError(f"--load is {load}; needed is a number.")
    subjects = _subjects(laws, numbers("--inertia", inertia))
    trusted((s.fmu for s in subjects if s.fmu), trust=trust)
    with answer_file(json_file) as wanted, shown_progress() as progress:
        found = run_battery(subjects, load=load, progress=partial(progress, "testing the laws"))
        named = {s.name: of_law for s, of_law in zip(subjects, found, strict=True)}
        if wanted is not None:
            write_properties(wanted, named)
    sliding = [slides for s in subjects if s.model for slides in s.model.slides]
    show(tables.properties(named), tables.legend(sliding))
    if why:
        show(tables.reasons(named))


def _subjects(laws: list[str], inertia: tuple[float, ...] | None) -> "list[Subject]":
    """Read models and FMUs; named by their law, else by their file, else by its path."""
    from cosim.properties.battery import Subject
    from cosim.workflow.arguments import telling_apart
    from fmu_src import BUILT_IN

    given = [given_law(law) for law in laws]
    stems = [Path(law).stem for law in laws]
    by_law = [
        model.law if model and law not in BUILT_IN else stem
        for law, stem, (model, _) in zip(laws, stems, given, strict=True)
    ]
    names = telling_apart([by_law, stems, laws], "given")
    return [
        Subject(name=name, model=model, fmu=fmu, inertia=inertia)
        for name, (model, fmu) in zip(names, given, strict=True)
    ]
