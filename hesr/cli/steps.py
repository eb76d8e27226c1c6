"""Commands of the single steps: identify, fit, evaluate, replay."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import (
    Accept,
    Body,
    Json,
    Logs,
    Robot,
    Trust,
    app,
    read_records,
    trusted,
)
from hesr_model.errors import ConfigError

if TYPE_CHECKING:
    from cosim.study.scores import Comparison, Records
    from hesr_model.friction.model import FrictionModel


@app.command()
def evaluate(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="LOG|LAW.json", help="Logs, and friction models (.json)."),
    ],
    robot: Robot,
    rigid_body: Body,
    accept: Accept = None,
    json_file: Json = None,
) -> None:
    """Score friction models on logs, and audit them.

    Example: hesr evaluate test.csv --robot robot.toml --rigid-body rigid_body.json law.json
    """
    from cosim.report.tables.scores import position_errors
    from cosim.report.tables.terminal import show
    from cosim.study.position_errors import simulate_laws
    from cosim.study.results import log_findings
    from cosim.study.scores import compare, input_classes, predict_models
    from hesr_model.friction.model import FrictionModel
    from hesr_model.health.fit_checks import check_owner
    from hesr_model.rigid_body.identification import RigidBody
    from hesr_model.support.typed_json import to_json

    law_files = [file for file in files if file.suffix == ".json"]
    logs = [file for file in files if file.suffix != ".json"]
    if not law_files or not logs:
        missing = "friction model (.json)" if logs else "log"
        raise ConfigError(f"evaluate: no {missing} among the files; both kinds are needed.")
    models = [FrictionModel.read(file) for file in law_files]
    # By the law where that tells them apart, else by the file's name, else by its path.
    namings = [[m.law for m in models], [f.stem for f in law_files], [str(f) for f in law_files]]
    names = next((n for n in namings if len(set(n)) == len(n)), namings[-1])
    named = dict(zip(names, models, strict=True))
    with shown_progress() as progress:
        records, own, _ = read_records(logs, robot, rigid_body, progress, accept)
        for model in models:
            log_findings(check_owner(model, own))
        inputs = input_classes(named)
        predicted = predict_models(named, records, partial(progress, "evaluating"))
        scores = compare(records, predicted, inputs, named)
        progress("simulating", 0, 1)
        simulated = simulate_laws(named, records, own, RigidBody.read(rigid_body))
    answer(json_file, to_json(scores) | {"simulation": simulated and to_json(simulated)})
    _print_scores("evaluation", scores, records, inputs)
    if simulated is not None:
        sliding = [of_joint[0].sliding for of_joint in records]
        show(position_errors("evaluation", simulated, sliding))
    for name, model in named.items():
        _print_audit(name, model, records)


@app.command()
def replay(
    fmu: Annotated[Path, typer.Argument(metavar="Friction.fmu", help="A friction FMU.")],
    logs: Logs,
    robot: Robot,
    rigid_body: Body,
    accept: Accept = None,
    json_file: Json = None,
    trust: Trust = False,
) -> None:
    """Run a friction FMU over logs through FMPy and score it.

    Example: hesr replay law.fmu test.csv --robot robot.toml --rigid-body rigid_body.json
    """
    from cosim.study.scores import compare, predict_fmu
    from hesr_model.support.typed_json import to_json

    trusted([fmu], trust=trust)
    with shown_progress() as progress:
        records, _, _ = read_records(logs, robot, rigid_body, progress, accept)
        progress(f"replaying {fmu.name}", 0, 1)
        scores = compare(records, {fmu.stem: predict_fmu(fmu, records)})
    answer(json_file, to_json(scores))
    _print_scores("replay", scores, records)


def _print_scores(
    name: str, scores: "Comparison", records: "Records", inputs: dict[str, str] | None = None
) -> None:
    from cosim.report.tables.scores import MEASURES, bands, errors
    from cosim.report.tables.terminal import show

    sliding = [of_joint[0].sliding for of_joint in records]
    show(*(errors(name, scores, measure, inputs, sliding) for measure in MEASURES))
    if scores.bands:
        show(bands(name, scores))


def _print_audit(name: str, model: "FrictionModel", records: "Records | None" = None) -> None:
    from cosim.report.tables import laws
    from cosim.report.tables.terminal import show
    from hesr_model.audit.audit import audit
    from hesr_model.friction.trained_range import outside
    from hesr_model.rigid_body.residual import all_at_friction

    if not model.trained:
        return
    pairs = list(zip(model.laws, model.trained, strict=True))
    audits = [audit(law, trained) for law, trained in pairs]
    show(laws.audit(name, audits, model.sliding))
    if records is not None:
        records = [[replace(r, coupling=model.coupling) for r in of_joint] for of_joint in records]
        found = [
            {k: v for k, v in outside(trained, r).items() if k in map(str, law.form.inputs)}
            for (law, trained), r in zip(pairs, all_at_friction(records), strict=True)
        ]
        if any(found):
            typer.echo(laws.leaving(model.joints, found, model.sliding))
