"""Commands of the single steps: identify, fit, evaluate, replay."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hesr.cli.console import answer, shown_progress
from hesr.cli.old_app import (
    Accept,
    Body,
    Json,
    Logs,
    Output,
    Robot,
    Trust,
    app,
    read_records,
    trusted,
)
from hesr_model.errors import ConfigError
from hesr_model.support.untrusted_text import parse_toml

if TYPE_CHECKING:
    from cosim.study.scores import Comparison, Records
    from hesr_model.friction.model import FrictionModel


def _laws(typed: str) -> list[str]:
    from hesr_model.friction.registry import registry

    return [name for name in registry() if name.startswith(typed)]


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
        typer.Option(
            metavar="NAME",
            help="stacked (least squares with friction columns) or paper (averaging).",
        ),
    ] = "stacked",
    friction: Annotated[
        Path | None,
        typer.Option(metavar="LAW.json", help="Refine: subtract this law's torque first."),
    ] = None,
    rigid_body: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Refine: the rigid body that the law was fitted with."),
    ] = None,
    payload: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Find the payload carried in the logs; FILE is the rigid body without it.",
        ),
    ] = None,
    physical: Annotated[
        bool,
        typer.Option("--physical", help="Only bodies that can exist; pays on short logs."),
    ] = False,
    accept: Accept = None,
) -> None:
    """Identify the rigid body from logs.

    Example: hesr identify excitation.csv --robot robot.toml -o rigid_body.json
    """
    from cosim.report.tables.laws import rigid_body as summary
    from cosim.study.results import log_findings
    from cosim.workflow.arguments import examined, logs_of
    from hesr_model.friction.model import FrictionModel
    from hesr_model.health.fit_checks import check_body
    from hesr_model.rigid_body.identification import RigidBody
    from hesr_model.rigid_body.identification import identify as identify_rigid_body
    from hesr_model.rigid_body.payload import identify_payload, loaded
    from hesr_model.rigid_body.refinement import identify_again
    from hesr_model.robots.robot import RobotDescription, RobotModel
    from hesr_model.support.provenance import provenance
    from hesr_model.support.typed_json import to_json

    if method not in ("stacked", "paper"):
        raise ConfigError(f"--method is '{method}'; allowed are 'stacked' and 'paper'.")
    if (friction is None) != (rigid_body is None):
        raise ConfigError("--friction and --rigid-body go together; only one of them was given.")
    if payload is not None and (physical or friction is not None or method != "stacked"):
        raise ConfigError(
            "--payload does not go with --physical, --friction or --method paper; give it alone."
        )
    if physical and friction is not None:
        raise ConfigError("--physical does not go with --friction; give one of them.")
    with shown_progress() as progress:
        description = RobotDescription.read(robot)
        model = RobotModel(description)
        counterparts = reversed_logs or []
        read = logs_of([*logs, *counterparts], description, partial(progress, "reading logs"))
        findings = examined(read, model, accept or ())
        forward, backward = read[: len(logs)], read[len(logs) :]
        progress("identifying", 0, 1)
        files = [robot, description.model, *logs, *counterparts]
        if payload is not None:
            without = RigidBody.read(payload)
            carried = identify_payload([*forward, *backward], model, without)
            found = loaded(without, carried, model)
            source = provenance(files=[*files, payload], payload=carried.to_dict())
        elif friction is not None and rigid_body is not None:
            law, body = FrictionModel.read(friction), RigidBody.read(rigid_body)
            found = identify_again(forward, model, body, law, reversed_logs=backward)
            source = provenance(files=[*files, friction, rigid_body])
        else:
            found = identify_rigid_body(
                forward,
                model,
                method="paper" if method == "paper" else "stacked",
                reversed_logs=backward,
                physical=physical,
            )
            source = provenance(files=files)
        impossible = list(check_body(found, model))
        findings += impossible
        source |= {"health": [to_json(finding) for finding in findings]}
        replace(found, provenance=source).write(output)
        log_findings(impossible)
    if payload is not None:
        centre = ", ".join(f"{c:.4f}" for c in carried.centre_of_mass)
        typer.echo(
            f"Payload of {carried.mass:.4g} +- {carried.standard_errors[0]:.2g} kg, centre of mass "
            f"{centre} m in the frame of {description.joints[-1]}; written to {output}."
        )
    else:
        sliding = [joint.prismatic for joint in model.tree]
        typer.echo(f"{summary(found, sliding)}\nwritten to {output}.")


@app.command()
def fit(
    logs: Logs,
    robot: Robot,
    rigid_body: Body,
    law: Annotated[
        str,
        typer.Option(metavar="NAME", help="Name of a law; see 'hesr laws'.", autocompletion=_laws),
    ],
    output: Output,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the fit.")] = 0,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Option of the law, as in TOML; repeatable."),
    ] = None,
    accept: Accept = None,
) -> None:
    """Fit a friction law to the joints of a robot.

    Its equations and its audit are printed.

    Example: hesr fit sweep.csv --robot robot.toml --rigid-body rigid_body.json --law parfam_h
    -o law.json --option 'search="paper"'
    """
    from cosim.study.results import log_findings
    from hesr_model.fitting.fit import fit_models
    from hesr_model.friction.registry import estimator
    from hesr_model.health.fit_checks import check_laws
    from hesr_model.support.provenance import newest, provenance
    from hesr_model.support.typed_json import to_json

    estimator(law)
    options = _options(option or [])
    with shown_progress() as progress:
        records, own, findings = read_records(logs, robot, rigid_body, progress, accept)
        files = [robot, own.description.model, rigid_body, *logs]
        health = [to_json(finding) for finding in findings]
        source = provenance(files=files, seed=seed, options=options, health=health)
        source |= {"created": newest(logs)}
        source |= {"owner": owner} if (owner := own.description.owner.known) else {}
        model = fit_models(
            [law],
            records,
            robot=own.description.name,
            seed=seed,
            options={law: options},
            provenance=source,
            progress=partial(progress, f"fitting {law}"),
        )[law]
    model.write(output)
    log_findings(check_laws({law: model}, records))
    _print_law(model)
    typer.echo(f"{law} for {', '.join(model.joints)}; written to {output}.")


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


def _options(pairs: list[str]) -> dict[str, Any]:
    """Return options written as KEY=VALUE, the value as in TOML."""
    options: dict[str, Any] = {}
    for pair in pairs:
        try:
            options |= parse_toml(pair)
        except ValueError as error:
            raise ConfigError(
                f"--option is '{pair}'; needed is KEY=VALUE with a value as in TOML, for instance "
                'ripple=false or search="paper".'
            ) from error
    return options


def _print_scores(
    name: str, scores: "Comparison", records: "Records", inputs: dict[str, str] | None = None
) -> None:
    from cosim.report.tables.scores import MEASURES, bands, errors
    from cosim.report.tables.terminal import show

    sliding = [of_joint[0].sliding for of_joint in records]
    show(*(errors(name, scores, measure, inputs, sliding) for measure in MEASURES))
    if scores.bands:
        show(bands(name, scores))


def _print_law(model: "FrictionModel") -> None:
    from hesr_model.fitting.uncertainty import MOST_COEFFICIENTS
    from hesr_model.friction.equation import coefficient_lines, equations

    for joint, law in zip(model.joints, model.laws, strict=True):
        if len(law.values) > MOST_COEFFICIENTS:
            typer.echo(f"{joint}: {len(law.values)} coefficients")
            continue
        typer.echo(f"{joint}:")
        for line in equations(law):
            typer.echo(f"  {line}")
        typer.echo(
            "  95 % intervals (within and between logs; none at bounds or of chosen structures):"
        )
        for line in coefficient_lines(law):
            typer.echo(f"    {line}")
    _print_audit(model.law, model)


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
