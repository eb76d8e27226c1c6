"""The command that asks whether laws are passive: audit."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cosim.cli.app import app
from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from hesr_model.friction.model import FrictionModel


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
    from rich.console import Console

    from cosim.tables import laws as tables
    from cosim.tables.terminal import Drawn
    from fmu_src.documentation import datasheet
    from fmu_src.friction.reference import reference_motion

    models = [(law, _model(law)) for law in laws]
    for law, model in models:
        seen = datasheet.ranges(model, reference_motion(model))
        name = model.law if Path(law).suffix else law
        Console().print(Drawn(tables.audit(name, datasheet.audits(model, seen), model.sliding)))
        for joint, said in zip(model.joints, datasheet.certificates(model, seen), strict=True):
            typer.echo(f"{joint}: {datasheet.certified(said)}")


def _model(law: str) -> "FrictionModel":
    from fmu_src import BUILT_IN, model_file
    from fmu_src.friction.embedded_model import embedded_model
    from hesr_model.artifacts import read_model

    suffix = Path(law).suffix.lower()
    if suffix == ".fmu":
        model = embedded_model(Path(law))
        if model is None:
            raise ConfigError(f"{law}: it carries no friction law that could be audited.")
        return model
    if law not in BUILT_IN and suffix != ".json":
        raise ConfigError(
            f"'{law}' is neither a friction model (.json), nor an FMU (.fmu), nor one of "
            f"{', '.join(BUILT_IN)}."
        )
    return read_model(model_file(law))
