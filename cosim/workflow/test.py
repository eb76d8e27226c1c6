"""Tests of friction laws: prediction on logs, passivity, physics checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cosim.workflow.answer import Answer, shorten_lines
from cosim.workflow.arguments import (
    find_body,
    list_logs,
    list_names,
    list_numbers,
    read_checked_logs,
    read_laws,
    remember_trust,
    require_choice,
    require_number,
    to_optional_output,
)
from cosim.workflow.fit import passivity
from hesr_model.errors import ArgumentError, ConfigError, HesrError
from hesr_model.support import plugins
from hesr_model.support.files import PathArg, written_whole
from hesr_model.support.progress import Stages, silent

if TYPE_CHECKING:
    from cosim.report.tables.table import ResultTable
    from cosim.servo.study import MotionErrors
    from cosim.study.position_errors import PositionErrors
    from cosim.study.replicates import Replicates
    from cosim.study.scores import Comparison
    from cosim.workflow.arguments import (
        BodyArg,
        CheckedLogs,
        Logs,
        LogSource,
        NamedLaws,
        Names,
        PerJoint,
        RobotArg,
    )
    from fmu_src.friction.predictions import Records
    from fmu_src.pages.datasheet import ModelAudit
    from hesr_model.audit.certificate import Certificate
    from hesr_model.audit.properties import Properties, Subject
    from hesr_model.findings import Finding
    from hesr_model.friction.model import FrictionModel
    from hesr_model.rigid_body.friction_record import FrictionRecord
    from hesr_model.rigid_body.identification import RigidBody

KINDS = ("prediction", "passivity")  # kinds of the core; others are plug-ins


@dataclass(frozen=True, kw_only=True, repr=False)
class LawReport(Answer):
    """Result of `hesr.test`.

    Attributes
    ----------
    laws : the tested laws.
    scores : errors of predicted torques [N.m]; None without a prediction.
    positions : errors of simulated positions [rad; m]; None without a simulation.
    replicates : parts of the errors that repeat; None if no motion of the logs occurs twice.
    records : friction of the logs [joint][part].
    motions : errors of motion from commands, by law and log; of logs without torque only.
    audits : passivity by law.
    properties : physics checks by law.
    others : results of kinds from plug-ins, by kind.
    findings : what the checks of logs and laws found.
    files : written files.
    """

    format = "hesr-law-report-1"
    laws: Sequence[Subject]
    scores: Comparison | None = None
    positions: PositionErrors | None = None
    replicates: Replicates | None = None
    records: Records = ()
    motions: Mapping[str, Sequence[MotionErrors]] = field(default_factory=dict)
    audits: Mapping[str, ModelAudit] = field(default_factory=dict)
    properties: Mapping[str, Properties] = field(default_factory=dict)
    others: Mapping[str, Answer] = field(default_factory=dict)
    findings: Sequence[Finding] = ()
    files: Sequence[Path] = ()

    def summary(self) -> str:
        """Return the best law, then passivity and failed checks of each law."""
        lines = []
        if self.scores:
            lines += _scores_lines(self.scores)
        for name, motions in self.motions.items():
            lines += [f"{name}: {errors.sentence}" for errors in motions]
        for law in self.laws:
            audit = self.audits.get(law.name)
            if audit:
                joints = law.model.joints if law.model else ()
                lines.append(f"{law.name}: passivity {passivity(joints, audit.certificates)}.")
            checks = self.properties.get(law.name)
            if checks:
                lines.append(f"{law.name}: {_failed_checks(checks)}")
        lines += [other.summary() for other in self.others.values()]
        return shorten_lines(lines, self.files)

    def tables(self) -> Sequence[ResultTable | str]:
        """Return scores, audits, certificates and physics checks."""
        tables = [*self._scores_tables(), *self._audit_tables(), *self._property_tables()]
        for other in self.others.values():
            tables += other.tables()
        return tables

    def _scores_tables(self) -> list[ResultTable | str]:
        from cosim.report.tables.replicates import build_tables
        from cosim.report.tables.scores import MEASURES, bands, errors, position_errors, separations
        from cosim.study.scores import input_classes

        if self.scores is None:
            return []
        sliding = [joint_records[0].sliding for joint_records in self.records]
        inputs = input_classes({law.name: law.model for law in self.laws if law.model})
        shown: list[ResultTable | str] = [
            errors("test", self.scores, measure, inputs, sliding) for measure in MEASURES
        ]
        shown += build_tables({"test": self.replicates}, "test", (), sliding)
        separation_table = separations("test", self.scores)
        if separation_table:
            shown.append(separation_table)
        if self.scores.bands:
            shown.append(bands("test", self.scores))
        if self.positions is not None:
            shown.append(position_errors("test", self.positions, self.scores, sliding))
        return shown

    def _audit_tables(self) -> list[ResultTable | str]:
        from cosim.report.tables.laws import audit
        from fmu_src.pages.datasheet import describe_certificate

        shown: list[ResultTable | str] = []
        for law in self.laws:
            model_audit = self.audits.get(law.name)
            if model_audit is None or law.model is None:
                continue
            shown.append(audit(law.name, model_audit.audits, law.model.sliding))
            certificates = zip(law.model.joints, model_audit.certificates, strict=True)
            shown += [
                f"{joint}: {describe_certificate(certificate)}"
                for joint, certificate in certificates
            ]
            if self.records:
                shown += _describe_left_ranges(law, self.records)
        return shown

    def _property_tables(self) -> list[ResultTable | str]:
        from cosim.report.tables import laws as tables

        if not self.properties:
            return []
        sliding: list[bool] = []
        for law in self.laws:
            if law.model:
                sliding += law.model.slides
        return [
            tables.properties(self.properties),
            tables.legend(sliding),
            tables.reasons(self.properties),
        ]

    def result(self) -> Any:
        """Return the results of all kinds as JSON data."""
        from hesr_model.support.typed_files import to_json

        data: dict[str, Any] = {}
        if self.motions:  # of logs without torque only
            data["motion"] = {
                name: list(map(to_json, log_errors)) for name, log_errors in self.motions.items()
            }
        data["prediction"] = self.scores and to_json(self.scores)
        data["replicates"] = self.replicates and to_json(self.replicates)
        data["simulation"] = self.positions and to_json(self.positions)
        data["passivity"] = {
            name: list(map(_certificate_data, audit.certificates))
            for name, audit in self.audits.items()
        }
        data["properties"] = {name: to_json(checks) for name, checks in self.properties.items()}
        for kind, other in self.others.items():
            data[kind] = other.result()
        return data


def _certificate_data(certificate: Certificate) -> dict[str, Any]:
    """Return what proves or refutes the passivity of a joint's law, as JSON data."""
    return {
        "verdict": certificate.label,
        "storage": certificate.storage,
        "rests_on": list(certificate.rests_on),
        "sequences": certificate.sequences,
    }


def test(
    laws: NamedLaws,
    *,
    on: Logs = (),
    kind: Names = (),
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    inertia: PerJoint | None = None,
    load: float = 0.0,
    output: PathArg | None = None,
    trust: bool = False,
    accept: Names = (),
    progress: Stages = silent,
) -> LawReport:
    r"""Test friction laws: prediction, passivity, physics checks.

    Models and FMUs of any tool get the same tests. A foreign FMU gets no proof
    of passivity, and only the physics checks that its connectors allow.

    Parameters
    ----------
    laws : law, path, or sequence or mapping of these
        Friction models (.json), friction FMUs (.fmu) of any tool, MJCFs (.xml)
        whose joints have friction or a dcmotor with bristles, or uf850-table1.
    on : log or sequence of logs, optional
        Logs for the prediction. Of more than 10^6 rows those that cover speed,
        load and rest are used.
    kind : str or sequence of str, optional
        Tests: prediction, passivity, properties (thirteen experiments: memory,
        stick-slip, dissipation, ..); by default prediction and passivity with
        `on`, else passivity.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of `identify`; required for the prediction.
    inertia : float or sequence of float, kg.m2, optional
        Properties: inertia of the joints, one value or one per joint; 3, 3, 0.6
        for the uf850.
    load : float, N.m
        Properties: default load torque of the experiments.
    output : path, optional
        JSON file of the properties.
    trust : bool
        Run these FMUs without a sandbox, now and later: faster, but with all
        your rights.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.
    progress : callable, optional
        Called with stage, steps done and steps in total.

    Returns
    -------
    LawReport
        Scores, certificates of passivity and physics checks by law.

    Raises
    ------
    HesrError
        If a law, a log or the robot cannot be used.

    Examples
    --------
    On the command line::

        $ hesr test law.json Friction.fmu --on test.csv --robot robot.toml \
          --rigid-body rigid_body.json
        $ hesr test uf850-table1 --kind properties

    >>> import hesr
    >>> hesr.test("uf850-table1").passed  # the paper's law generates energy
    False
    """
    sources = list_logs("on", on)
    kinds = list_names("kind", kind)
    accepted = list_names("accept", accept)
    inertias = None
    if inertia is not None:
        inertias = list_numbers("inertia", inertia)
    output_path = to_optional_output("output", output)
    if not kinds:
        kinds = _choose_kinds(has_logs=bool(sources))
    for name in kinds:
        require_choice("kind", name, (*KINDS, *plugins.names("hesr.tests")))
    if output_path is not None and "properties" not in kinds:
        raise ArgumentError("'output' is for 'kind' properties, whose results it keeps.")
    require_number("load", load)
    if not isfinite(load):
        raise ArgumentError(f"'load' is {load}; expected a number.")
    subjects = read_laws(laws)
    remember_trust((subject.fmu for subject in subjects if subject.fmu), trust=trust)
    report = LawReport(laws=subjects)
    if "prediction" in kinds:
        report = _add_scores(report, sources, robot, rigid_body, accepted, progress)
    if "passivity" in kinds:
        report = _add_certificates(report, alone=kinds == ["passivity"])
    if "properties" in kinds:
        report = _add_properties(report, inertias, load, output_path, progress)
    return replace(report, others=_run_plugin_tests(kinds, subjects, sources))


def _choose_kinds(*, has_logs: bool) -> list[str]:
    """Return the tests of a call that names none; only logs allow a prediction."""
    if has_logs:
        return ["prediction", "passivity"]
    return ["passivity"]


def _run_plugin_tests(
    kinds: Sequence[str], subjects: Sequence[Subject], sources: Sequence[LogSource]
) -> dict[str, Answer]:
    plugin_tests = plugins.load("hesr.tests")
    return {
        name: plugin_tests[name].load()(subjects, sources)
        for name in kinds
        if name not in (*KINDS, "properties")
    }


test.__test__ = False  # type: ignore[attr-defined]  # keeps pytest off


def _add_scores(
    report: LawReport,
    sources: Sequence[LogSource],
    robot: RobotArg | None,
    rigid_body: BodyArg | None,
    accepted: Sequence[str],
    progress: Stages,
) -> LawReport:
    """Add the scores of the laws on logs: FMUs are replayed, models computed."""
    if not sources:
        raise ArgumentError("'kind' prediction needs 'on', a log.")
    models = {law.name: law.model for law in report.laws if law.model and not law.fmu}
    has_servos = all(model.servos for model in models.values()) and len(models) == len(report.laws)
    if rigid_body is None and not has_servos:
        raise ArgumentError("'kind' prediction needs 'rigid_body', the result of 'hesr identify'.")
    checked = read_checked_logs(
        sources, robot, accepted, progress, in_pieces=True, from_commands=has_servos
    )
    if checked.lacks_torque:
        return _add_motion_errors(report, checked, models)
    if rigid_body is None:
        raise ArgumentError("'kind' prediction needs 'rigid_body', the result of 'hesr identify'.")
    body = find_body(rigid_body, checked.logs, checked.robot)
    return _add_torque_errors(report, checked, body, models, progress)


def _add_torque_errors(
    report: LawReport,
    checked: CheckedLogs,
    body: RigidBody,
    models: Mapping[str, FrictionModel],
    progress: Stages,
) -> LawReport:
    """Add the errors of predicted torques, and of positions that models simulate with them."""
    from cosim.study.position_errors import simulate_tests
    from cosim.study.replicates import split_by_replicates
    from cosim.study.scores import (
        compare,
        input_classes,
        make_causal,
        predict_models,
        transpose_records,
    )
    from fmu_src.friction.predictions import predict_fmu
    from hesr_model.findings import log_findings
    from hesr_model.health.examine import check_owner

    records = transpose_records(checked.compute_records(body))
    causal_records = make_causal(records)
    findings = list(checked.findings)
    for model in models.values():
        findings += log_findings(check_owner(model, checked.robot))
    torques = predict_models(models, causal_records, partial(progress, "predicting"))
    zero_phase = predict_models(models, records)
    for law in report.laws:
        if law.fmu:
            progress(f"replaying {law.fmu.name}", 0, 1)
            torques[law.name] = predict_fmu(law.fmu, causal_records)
            zero_phase[law.name] = predict_fmu(law.fmu, records)
    comparison = compare(records, torques, input_classes(models), models, zero_phase)
    positions = None
    if models:
        progress("simulating", 0, 1)
        positions = simulate_tests(models, {"": records}, checked.robot, body).get("")
    return replace(
        report,
        scores=comparison,
        positions=positions,
        replicates=split_by_replicates(records, torques),
        records=records,
        findings=findings,
    )


def _add_motion_errors(
    report: LawReport, checked: CheckedLogs, models: Mapping[str, FrictionModel]
) -> LawReport:
    """Add the errors of the motion that laws with their servos make of the commands of logs."""
    from cosim.servo.study import compute_motion_errors

    motions = {
        name: compute_motion_errors(model, checked.robot, checked.logs, [True] * len(checked.logs))
        for name, model in models.items()
    }
    return replace(report, motions=motions, findings=checked.findings)


def _add_certificates(report: LawReport, *, alone: bool) -> LawReport:
    """Add proofs of passivity; laws without equations are refused if `alone`."""
    from fmu_src.friction.reference import reference_motion
    from fmu_src.pages.datasheet import ModelAudit, ranges
    from hesr_model.findings import Finding, sort_by_severity

    audits = {}
    passivity_findings = []
    for law in report.laws:
        if law.model is None:
            if alone:
                raise ConfigError(f"{law.fmu}: it contains no friction law to audit.")
            continue
        try:
            reference_ranges = ranges(law.model, reference_motion(law.model))
            audit = ModelAudit.from_model(law.model, reference_ranges)
        except HesrError:
            if alone:
                raise
            continue
        audits[law.name] = audit
        refuted_joints = [
            joint
            for joint, certificate in zip(law.model.joints, audit.certificates, strict=True)
            if certificate.verdict == "refuted"
        ]
        if refuted_joints:
            passivity_findings.append(
                Finding(
                    check="passivity",
                    where=law.name,
                    joints=tuple(refuted_joints),
                    found="the law generates energy in a cycle, so it is not passive",
                    remedy="use a law that is proven passive; the tables show the cycle",
                )
            )
    findings = sort_by_severity([*report.findings, *passivity_findings])
    return replace(report, audits=audits, findings=findings)


def _add_properties(
    report: LawReport,
    inertia: Sequence[float] | None,
    load: float,
    output: Path | None,
    progress: Stages,
) -> LawReport:
    """Add the physics checks, each law in a process of its own."""
    from hesr_model.audit.properties import write_properties

    subjects = list(report.laws)
    if inertia is not None:
        subjects = [replace(law, inertia=tuple(inertia)) for law in subjects]
    with ExitStack() as cleanup:
        temporary = None
        if output:
            # Check that the file can be written before the run.
            temporary = cleanup.enter_context(written_whole(output))
        battery = plugins.find("hesr.tests", "properties")
        results = battery(subjects, load=load, progress=partial(progress, "testing the laws"))
        names = [law.name for law in report.laws]
        properties = dict(zip(names, results, strict=True))
        if temporary:
            write_properties(temporary, properties)
    return replace(report, properties=properties, files=(output,) if output else ())


def _scores_lines(comparison: Comparison) -> list[str]:
    """Return the best law, its error, and the limits of the logs."""
    from cosim.study.verdict import describe_limits, find_separations

    best = min(comparison.laws, key=comparison.size)
    unexplained_shares = comparison.unexplained_shares(comparison.laws[best].rmse)
    pairs = zip(comparison.joints, unexplained_shares, strict=True)
    shares = ", ".join(f"{joint} {100 * share:.0f} %" for joint, share in pairs)
    joints = list(find_separations(comparison, [best] * len(comparison.joints)))
    return [f"Best: {best}. Unexplained friction: {shares}.", *describe_limits("The test", joints)]


def _failed_checks(properties: Properties) -> str:
    """Return the failed physics checks of a law with their joints."""
    failed = []
    for title, numbers in properties.failed.items():
        names = ", ".join(f"J{number}" for number in numbers)
        failed.append(f"{title} ({names})")
    if failed:
        return f"fails {'; '.join(failed)}."
    return "passes all physics checks that apply."


def _describe_left_ranges(law: Subject, records: Records) -> list[str]:
    """Return which inputs leave the trained range of a law in the logs."""
    from cosim.report.tables.laws import describe_excesses
    from hesr_model.friction.trained_range import find_excess
    from hesr_model.rigid_body.residual import transform_all_records

    model = law.model
    joints = tuple(joint_records[0].joint for joint_records in records)
    if model is None or not model.trained or model.joints != joints:
        return []

    def add_coupling(record: FrictionRecord) -> FrictionRecord:
        return replace(record, coupling=model.coupling)

    coupled_records = [list(map(add_coupling, joint_records)) for joint_records in records]
    thermal_models = model.thermal or (None,) * len(joints)
    shares = []
    for friction_law, trained_range, thermal, joint_records in zip(
        model.laws,
        model.trained,
        thermal_models,
        transform_all_records(coupled_records),
        strict=True,
    ):
        inputs = (*map(str, friction_law.form.inputs), "temperature")
        share_by_input = find_excess(trained_range, joint_records, thermal)
        shares.append({name: excess for name, excess in share_by_input.items() if name in inputs})
    if not any(shares):
        return []
    return [describe_excesses(model.joints, shares, model.sliding)]
