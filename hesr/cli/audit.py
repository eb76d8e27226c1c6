"""The command that asks whether laws are passive: audit."""

from pathlib import Path
from typing import Annotated

import typer

from hesr.cli.given_law import given_law
from hesr.cli.old_app import app
from hesr_model.errors import ConfigError


@app.command()
def audit(
    laws: Annotated[
        list[str],
        typer.Argument(
            metavar="LAW",
            help="Friction models (.json), friction FMUs (.fmu) that carry one, or uf850-table1.",
        ),
    ],
) -> None:
    """Prove that laws are passive, or refute it by a cycle.

    Joint by joint: proven, with the storage function and the signs it rests on; refuted, by a cycle
    that gives energy; or open, with the condition that does not hold. Then the figures of the
    audit: what a law does on cycles, at rest and outside of its training.

    Example: hesr audit uf850-table1 laws/lugre.json
    """
    from cosim.report.tables import laws as tables
    from cosim.report.tables.terminal import show
    from fmu_src.friction.reference import reference_motion
    from fmu_src.pages import datasheet

    models = []
    for law in laws:
        model, _ = given_law(law)
        if model is None:
            raise ConfigError(f"{law}: it carries no friction law that could be audited.")
        models.append((law, model))
    for law, model in models:
        seen = datasheet.ranges(model, reference_motion(model))
        name = model.law if Path(law).suffix else law
        show(tables.audit(name, datasheet.audits(model, seen), model.sliding))
        for joint, said in zip(model.joints, datasheet.certificates(model, seen), strict=True):
            typer.echo(f"{joint}: {datasheet.certified(said)}")
