"""Fit of friction laws, and the list of laws."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from cosim.workflow.answer import Answer, Written, read_health, written_files
from cosim.workflow.arguments import (
    list_laws,
    list_logs,
    list_names,
    paths_among,
    read_checked_logs,
    read_model,
    require_mapping,
    to_optional_output,
)
from hesr_model.errors import ArgumentError, HesrError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, newest, provenance
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.workflow.arguments import (
        BodyArg,
        CheckedLogs,
        FittedLawArg,
        LawArg,
        Laws,
        LawSource,
        Logs,
        Names,
        RobotArg,
    )
    from hesr_model.audit.certificate import Certificate
    from hesr_model.findings import Finding
    from hesr_model.fitting.estimator import Estimator
    from hesr_model.friction.model import FrictionModel
    from hesr_model.rigid_body.friction_record import FrictionRecord
    from hesr_model.rigid_body.identification import RigidBody


def laws() -> Mapping[str, type[Estimator]]:
    """Return the laws that can be fitted, by name.

    Returns
    -------
    mapping of str to type
        Estimators, in the order of tables.

    Examples
    --------
    >>> import hesr
    >>> hesr.laws()["lugre"].title
    'LuGre'
    """
    from hesr_model.fitting.estimator import registry

    return registry()


def fit(
    logs: Logs,
    *,
    law: FittedLawArg | None = None,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    seed: int = 0,
    options: Mapping[str, Any] | None = None,
    add: Names = (),
    prior: Laws = (),
    output: PathArg | None = None,
    accept: Names = (),
    progress: Stages = silent,
) -> FrictionModel:
    r"""Fit a friction law to the joints of a robot.

    Parameters
    ----------
    logs : log or sequence of logs
        CSV, Parquet or MATLAB files, or ROS bags; in Python also `Log` objects.
        Of long logs at most 10^6 rows are used, in whole stretches that cover
        speed, load and rest.
    law : str, path, law or class
        Name of a law ('hesr fit --list' lists them) or, in Python, its class;
        or choose: the proposed law of each joint that predicts left-out rows
        best; with `add` also a fitted law (.json).
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of `identify`; by default identified from the logs.
    seed : int
        Random seed; the same logs and seed give the same law.
    options : mapping, optional
        Options of the law, with values as in TOML.
    add : str or sequence of str, optional
        Refinements of the fitted law, such as temperature.
    prior : law or sequence of laws, optional
        Instead of law: fitted laws (.json) of this robot to adapt to the logs,
        from other days and of one structure.
    output : path, optional
        JSON file to write.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    FrictionModel
        Law of each joint with coefficients [SI units], their covariance and
        provenance.

    Raises
    ------
    HesrError
        If a log, the robot or the law do not allow the fit.

    Examples
    --------
    On the command line::

        $ hesr fit sweep.csv --robot robot.toml --rigid-body rigid_body.json \
          --law parfam_h -o law.json --option 'search="paper"'
        $ hesr fit cold.csv warm.csv --robot robot.toml --law law.json \
          --add temperature -o warm.json
        $ hesr fit seconds.csv --robot robot.toml --rigid-body rigid_body.json \
          --prior law.json -o adapted.json

    >>> import hesr
    >>> log_path = "my_arm/logs/sample_training.csv"
    >>> log = hesr.Log.read(log_path, "my_arm/robot.toml")
    >>> body = "rigid_body.json"
    >>> hesr.fit(log, law="lugre", rigid_body=body, output="law.json")
    FrictionModel('lugre' of 'my_arm', 3 joints)
    """
    from hesr_model.fitting.estimator import to_law_name
    from hesr_model.inference.choice import CHOOSE

    sources = list_logs("logs", logs)
    additions = list_names("add", add)
    priors = list_laws("prior", prior)
    accepted = list_names("accept", accept)
    output_path = to_optional_output("output", output)
    require_mapping("options", options)
    _require_refinements(additions)
    known_law = to_law_name(law) if isinstance(law, type) else law
    fitted_model = _read_fitted_law(known_law, additions, options, priors)
    checked = read_checked_logs(
        sources, robot, accepted, progress, in_pieces=True, from_commands=True
    )
    if checked.lacks_torque:
        model = _fit_from_commands(checked, known_law, rigid_body, options, additions, progress)
        if output_path is not None:
            model.write(output_path)
        return model
    body = checked.find_body(rigid_body)
    records = checked.compute_records(body, seed)
    torque_fit = _TorqueFit(
        checked=checked,
        rigid_body=rigid_body,
        body=body,
        records=records,
        seed=seed,
        progress=progress,
    )
    if fitted_model is not None:
        model = fitted_model
    elif known_law == CHOOSE:
        model = torque_fit.choose_laws()
    else:
        model = torque_fit.fit_law(str(known_law), options or {})
    if priors:
        model = torque_fit.adapt(model, priors)
    model = replace(model, rigid_body=body)
    refinements = plugins.load("hesr.refinements")
    for name in additions:
        progress(f"fitting {name}", 0, 1)
        model, sentences = refinements[name].load()(model, records)
        model = replace(model, provenance={**model.provenance, name: sentences})
    if output_path is not None:
        model.write(output_path)
    if fitted_model is None:
        _log_new_findings(model, checked)
    return model


def _require_refinements(names: Iterable[str]) -> None:
    """Raise ArgumentError unless plug-ins offer the refinements."""
    refinements = plugins.load("hesr.refinements")
    for name in names:
        if name not in refinements:
            raise ArgumentError(f"'add' is '{name}'; there are {', '.join(refinements)}.")


@dataclass(frozen=True, kw_only=True)
class _TorqueFit:
    """Fit of laws to logs with torque.

    Attributes
    ----------
    checked : logs and robot.
    rigid_body : rigid body of the caller; None if it is identified from the logs.
    body : the rigid body.
    records : friction [part][joint].
    """

    checked: CheckedLogs
    rigid_body: BodyArg | None
    body: RigidBody
    records: Sequence[Sequence[FrictionRecord]]
    seed: int
    progress: Stages

    def choose_laws(self) -> FrictionModel:
        """Fit the proposed law of each joint that predicts left-out rows best."""
        from cosim.study.law_choice import fit_chosen_laws

        model, _ = fit_chosen_laws(
            self.checked.collect_motions(self.seed),
            self.checked.robot,
            self.body,
            identifies_body=self.rigid_body is None,
            seed=self.seed,
            provenance=self._provenance({}),
            progress=self.progress,
        )
        return self._check(model.law, model)

    def fit_law(self, law_name: str, options: Mapping[str, Any]) -> FrictionModel:
        """Fit one law to all joints."""
        from hesr_model.fitting.fit import fit_models

        models = fit_models(
            [law_name],
            self._joint_records(),
            robot=self.checked.robot.description.name,
            seed=self.seed,
            options={law_name: dict(options)},
            provenance=self._provenance(options),
            progress=partial(self.progress, f"fitting {law_name}"),
        )
        return self._check(law_name, models[law_name])

    def adapt(self, model: FrictionModel, priors: Sequence[LawSource]) -> FrictionModel:
        """Adapt the model of `priors`, from other days, to the logs."""
        from hesr_model.findings import log_findings
        from hesr_model.fitting.days import adapt
        from hesr_model.health.examine import check_owner

        log_findings(check_owner(model, self.checked.robot))
        self.progress("adapting", 0, 1)
        adapted_model, sentences = adapt(model, self._joint_records())
        source = self._provenance({})
        source["prior"] = [str(path) for path in paths_among(*priors)]
        source["adaptation"] = sentences
        return replace(adapted_model, provenance=source)

    def _check(self, law_name: str, model: FrictionModel) -> FrictionModel:
        """Return a fitted model with what its checks find in its provenance."""
        from hesr_model.health.examine import check_laws

        return _add_health(model, check_laws({law_name: model}, self._joint_records()))

    def _joint_records(self) -> list[list[FrictionRecord]]:
        from cosim.study.scores import transpose_records

        return transpose_records(self.records)

    def _provenance(self, options: Mapping[str, Any]) -> dict[str, Any]:
        return _provenance(self.checked, self.rigid_body, self.seed, options)


def _fit_from_commands(
    checked: CheckedLogs,
    law: LawArg | None,
    rigid_body: BodyArg | None,
    options: Mapping[str, Any] | None,
    additions: Sequence[str],
    progress: Stages,
) -> FrictionModel:
    """Fit a law and the servos to logs without torque; refuse what needs torques."""
    from cosim.servo.choice import choose_from_commands
    from cosim.servo.model import fit_from_commands
    from hesr_model.friction.model import FrictionModel
    from hesr_model.inference.choice import CHOOSE

    if isinstance(law, FrictionModel) or law is None or options or additions:
        raise ArgumentError(
            "the logs have no torque; give the name of a 'law' alone, without 'options', 'add' or "
            "'prior'."
        )
    origin = _provenance(checked, rigid_body, 0, {})
    if law == CHOOSE:
        return choose_from_commands(
            checked.logs,
            checked.robot,
            provenance=origin,
            progress=partial(progress, "judging laws by motion from commands"),
        )
    return fit_from_commands(
        checked.logs,
        checked.robot,
        str(law),
        provenance=origin,
        progress=partial(progress, f"fitting {law} and servos to commands"),
    )


def _add_health(model: FrictionModel, findings: Iterable[Finding]) -> FrictionModel:
    """Return a model with findings about it in the health of its provenance."""
    from hesr_model.support.typed_files import to_json

    entries = [to_json(finding) for finding in findings]
    if not entries:
        return model
    health = [*model.provenance["health"], *entries]
    return replace(model, provenance={**model.provenance, "health": health})


def _log_new_findings(model: FrictionModel, checked: CheckedLogs) -> None:
    """Log the findings of a model that were not logged with its logs."""
    from hesr_model.findings import log_findings

    logged = {finding.sentence for finding in checked.findings}
    findings = read_health(model.provenance)
    log_findings(finding for finding in findings if finding.sentence not in logged)


def _read_fitted_law(
    law: LawArg | None,
    add: Sequence[str],
    options: Mapping[str, Any] | None,
    prior: Sequence[LawSource],
) -> FrictionModel | None:
    """Return a law that is fitted already, None for the name of a law."""
    from hesr_model.fitting.days import build_prior
    from hesr_model.fitting.estimator import estimator
    from hesr_model.friction.model import FrictionModel
    from hesr_model.inference.choice import CHOOSE

    if (law is None) != bool(prior) or (prior and options):
        raise ArgumentError("give either 'law' or 'prior', fitted laws without 'options'.")
    if law is None:
        return build_prior([read_model(source) for source in prior])
    if law == CHOOSE:
        if options:
            raise ArgumentError(f"'law' is '{CHOOSE}'; it has no 'options'.")
        return None
    if not isinstance(law, FrictionModel) and not str(law).lower().endswith(".json"):
        estimator(str(law))  # refuse an unknown law before the logs are read
        return None
    if not add or options:
        raise ArgumentError(f"'law' is fitted already ({law}); give 'add', and no 'options'.")
    return read_model(law)


def _provenance(
    checked: CheckedLogs, rigid_body: BodyArg | None, seed: int, options: Mapping[str, Any]
) -> dict[str, Any]:
    from hesr_model.support.typed_files import to_json

    logs = list(dict.fromkeys(log.path for log in checked.logs if log.path))
    files = list(checked.files)
    before_logs = len(files) - len(logs)
    files[before_logs:before_logs] = paths_among(rigid_body)
    health = [to_json(finding) for finding in checked.findings]
    source = provenance(files=files, seed=seed, options=dict(options), health=health)
    if logs:
        source["created"] = newest(logs)
    description = checked.robot.description
    source |= description.constants
    owner = description.owner.known
    if owner:
        source["owner"] = owner
    return source


def answer(model: FrictionModel, output: PathArg | None) -> Answer:
    """Return the answer of a fitted law: equations, errors and passivity of each joint."""
    from fmu_src.pages import datasheet
    from hesr_model.inference.choice import CHOOSE
    from hesr_model.robots.description import statements

    joints = ", ".join(model.joints)
    lines = [f"{model.law} for {joints}.", *statements(model.provenance), *_equations(model)]
    if model.trained:
        certificates = datasheet.certificates(model, model.trained)
        lines.append(f"Passivity: {passivity(model.joints, certificates)}.")
    for name in (CHOOSE, "adaptation", "from_commands", *plugins.names("hesr.refinements")):
        lines += model.provenance.get(name, ())
    return Written(
        format="hesr-friction-model-1",
        lines=lines,
        shown=[*_coefficients(model), *audit_tables(model.law, model)],
        data=model.to_json(),
        findings=read_health(model.provenance),
        files=written_files(output),
    )


def _equations(model: FrictionModel) -> list[str]:
    """Return the equation and training error of each joint."""
    from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
    from hesr_model.friction.law import equations
    from hesr_model.units import unit_of_joint

    lines = []
    for j, (joint, law) in enumerate(zip(model.joints, model.laws, strict=True)):
        text = f"{len(law.values)} coefficients"
        if len(law.values) <= MAX_COEFFICIENTS:
            text = "; ".join(equations(law))
        if model.training_rmse:
            unit = unit_of_joint("N.m", is_prismatic=model.slides[j])
            text += f"  (RMSE {model.training_rmse[j]:.3g} {unit})"
        lines.append(f"{joint}: {text}")
    return lines


def _coefficients(model: FrictionModel) -> list[str]:
    """Return the coefficients of each joint with their 95 % intervals."""
    from hesr_model.fitting.uncertainty import MAX_COEFFICIENTS
    from hesr_model.friction.law import coefficient_lines, find_held

    paragraphs = []
    for joint, law in zip(model.joints, model.laws, strict=True):
        if len(law.values) > MAX_COEFFICIENTS:
            continue
        if find_held(law):
            condition = "conditional on those held at a bound"
        else:
            condition = "none of chosen structures"
        head = f"95 % intervals (within and between logs; of a single log: that day; {condition}):"
        lines = [f"  {line}" for line in coefficient_lines(law)]
        paragraphs.append("\n".join([f"{joint}: {head}", *lines]))
    return paragraphs


def audit_tables(name: str, model: FrictionModel) -> list[ResultTable | str]:
    """Return the audit of a fitted model; nothing for a model without trained ranges."""
    from cosim.report.tables.laws import audit
    from fmu_src.pages import datasheet

    if not model.trained:
        return []
    try:
        return [audit(name, datasheet.audits(model, model.trained), model.sliding)]
    except HesrError as error:
        return [f"{name}: {error}"]


def passivity(joints: Sequence[str], certificates: Sequence[Certificate]) -> str:
    """Return the joints of a law by verdict: proven passive, refuted or tested."""
    by_verdict = defaultdict(list)
    for joint, certificate in zip(joints, certificates, strict=True):
        by_verdict[certificate.label].append(joint)
    return "; ".join(f"{verdict} on {', '.join(names)}" for verdict, names in by_verdict.items())


def listing() -> Answer:
    """Return the answer of `--list`: name, title and equation of each law."""
    from cosim.report.tables.laws import laws as table

    return Written(
        lines=[],
        shown=[table()],
        shows_tables=True,
        data={
            name: {"title": law.title, "equation": law.as_text()} for name, law in laws().items()
        },
    )
