"""Run of a study, from logs to a verdict."""

import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from cosim.loop.traces import Following, LoopOutcome, complete_loops
from cosim.study.forecast import Forecast
from cosim.study.law_choice import add_left_out_errors, choose_from_models
from cosim.study.position_errors import SIMULATION, simulate_tests
from cosim.study.replicates import Replicates, write_replicates
from cosim.study.results import TRUTHS, ScoredRun, record_files, save_run, write_findings
from cosim.study.scores import Errors, LogRecords, select_records
from cosim.study.shipped_studies import DEFAULT, find_shipped_studies
from cosim.study.steps import Job, checkpoint_folder, map_models
from cosim.study.study import Study
from cosim.study.verdict import Verdict, judge_run, write_verdict
from fmu_src.export.toolchain import DEFAULT_PLATFORMS, HOST, get_ready, targets
from fmu_src.friction.friction_fmu import export_bare, export_fmu
from fmu_src.pages.datasheet import ModelAudit
from hesr_model.audit.properties import Properties, combine_results
from hesr_model.equations.rows import vectors
from hesr_model.errors import SimulationError
from hesr_model.findings import Finding, log_findings
from hesr_model.fitting.estimator import select_laws
from hesr_model.forward.output_error import RefinementResult
from hesr_model.friction.model import MIXED, FrictionModel, mix_models
from hesr_model.health.examine import check_body, check_laws, check_logs
from hesr_model.inference.choice import LawChoice
from hesr_model.inference.folds import MIN_FOLDS
from hesr_model.logs.robot_log import Log
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support import parallel
from hesr_model.support.cache import USED, count_hits
from hesr_model.support.files import newest, provenance
from hesr_model.support.progress import Stages, silent
from hesr_model.support.result_folder import folder_written_whole
from hesr_model.support.typed_files import to_json, write_json

_WORK = ("cosim.study.scores", "hesr_model.fitting.fit")  # preloaded by the workers


@dataclass(frozen=True, kw_only=True)
class Outcome(ScoredRun):
    """Results of a run: those up to the scores, with final laws and FMUs, and the verdict."""

    properties: Mapping[str, Properties]  # empty for a quick run
    verdict: Verdict
    following: Following = field(default_factory=Following)
    loop: LoopOutcome | None = None
    truths: Mapping[str, Errors] = field(default_factory=dict)  # by alternative plant
    truth: str = ""  # alternative plant
    replicates: Mapping[str, Replicates | None] = field(default_factory=dict)  # by test set
    platforms: Sequence[str] = HOST  # of the FMUs, except for MuJoCo's arm
    cached: Mapping[str, tuple[int, int]] = field(default_factory=dict)  # hits, requests


def run_study(
    path: Path,
    output: Path,
    *,
    platforms: Sequence[str] = HOST,
    quick: bool = False,
    accepted: Sequence[str] = (),
    progress: Stages = silent,
) -> Outcome:
    """Run a study and write all results into a folder, or nothing on an error.

    The FMUs also have the binary of this machine, which scores them. An interrupted run continues
    from checkpoints next to the folder. For `quick` and `accepted` see `hesr.run`.
    """
    study = Study.read(path)
    if quick:
        study = _shorten_study(study)
    targets(platforms)  # refuse unknown names, and none at all
    platform_folders = tuple(target.folder for target in targets((*HOST, *platforms)))
    used_before = USED.copy()
    checkpoints = checkpoint_folder(output)
    job = Job(
        study=study,
        path=path,
        progress=progress,
        checkpoints=checkpoints,
        platforms=platform_folders,
    )
    with parallel.one_pool(*_WORK, first=(vectors, get_ready)):
        with folder_written_whole(output) as folder:
            run = score_study(job, folder, accepted=accepted)
            models = run.models
            replicates = write_replicates(folder, study, run.records, models, run.predictions)
            _write_position_errors(run, folder)
            truths = job.score_truths(
                [law_name for law_name in models if law_name not in study.variants]
            )
            if truths:
                write_json(folder / TRUTHS, truths)
            loop = job.closed_loop(run, folder, quick=quick)
            complete_loops(folder)
            properties = {} if quick else job.properties(run, folder)
            # Last: the FMUs document the physics checks.
            audits = map_models(
                models,
                partial(_document_fmu, run.fmus, properties, platforms=platform_folders),
                partial(job.progress, "documenting FMUs"),
            )
            run_verdict = _judge(run, properties, quick=quick)
            write_verdict(folder, run_verdict)
            mixed_models = write_mixed_model(
                run_verdict, models, folder, audits, properties, platforms=platform_folders
            )
            final_models = {**models, **mixed_models}
            following = job.following(run, final_models, run_verdict.law, folder)
            save_run(folder, run, command=_command(path, platforms, quick=quick), quick=quick)
            _report(folder, audits, job.progress, brief=quick)
            record_files(folder)
        shutil.rmtree(checkpoints, ignore_errors=True)
    # The folder had another name until it was complete.
    fmus = {law_name: output / "fmus" / f"{law_name}.fmu" for law_name in final_models}
    return Outcome(
        **vars(replace(run, models=final_models, fmus=fmus)),
        properties=properties,
        verdict=run_verdict,
        loop=loop,
        following=following,
        truths=truths,
        replicates=replicates,
        truth=study.truth,
        platforms=platform_folders,
        cached=count_hits(used_before),
    )


def _write_position_errors(run: ScoredRun, folder: Path) -> None:
    """Score the laws as simulators and write their position errors."""
    # Laws were fitted to left-out rows as well: only tests show them as simulators.
    test_records = {
        test: select_records(names, run.records) for test, names in run.study.logs.test.items()
    }
    position_errors = simulate_tests(run.models, test_records, run.robot, run.rigid_body)
    write_json(
        folder / SIMULATION,
        {test: to_json(test_errors) for test, test_errors in position_errors.items()},
    )


def _judge(run: ScoredRun, properties: Mapping[str, Properties], *, quick: bool) -> Verdict:
    """Return the verdict of a run, from its first test."""
    logs = run.study.logs
    tested_names = next(iter(logs.judged.values()))
    return judge_run(
        run.comparisons,
        run.models,
        run.choice,
        select_records(logs.training, run.records),
        select_records(tested_names, run.records),
        properties,
        gear_ratio=run.robot.description.gear_ratio is not None,
        expected=Forecast.from_logs(run.files[name] for name in logs.training),
        refined=run.refined if run.study.refinement else None,
        may_refine=not quick,
    )


def _shorten_study(study: Study) -> Study:
    """Return a study with few laws and, in closed loop, one motion."""
    laws = select_laws("quick")
    shorter: dict[str, Any] = {
        "laws": laws,
        "variants": {},
        "refinement": None,
        "folds": min(study.folds, MIN_FOLDS),
    }
    if study.twin:
        shorter["twin"] = study.twin.model_copy(update={"truths": ()})
    if study.tracking:
        sources = tuple(law_name for law_name in study.tracking.sources if law_name in laws)
        shorter["tracking"] = study.tracking.model_copy(
            update={"seeds": study.tracking.seeds[:1], "sources": sources}
        )
    return study.model_copy(update=shorter)


def _report(
    folder: Path, audits: Mapping[str, ModelAudit | None], progress: Stages, *, brief: bool
) -> None:
    from cosim.report.page import REPORT, compose_report  # slow to import
    from cosim.report.results import Results

    known_audits = {law_name: audit for law_name, audit in audits.items() if audit}
    results = replace(Results.read(folder), audited=known_audits)
    compose_report(results, folder, folder / REPORT, folder, brief=brief, progress=progress)


def score_study(job: Job, folder: Path, *, accepted: Sequence[str] = ()) -> ScoredRun:
    """Identify, fit, write the FMUs into an existing folder and score them; see `run_study`."""
    study = job.study
    robot = Robot(job.robot)
    files = job.log_files(folder)
    logs = {name: job.read(name, file) for name, file in files.items()}
    findings = log_findings(check_logs(list(logs.values()), robot, accepted))

    body, refined_models = job.rigid_body(logs, robot)
    findings += log_findings(check_body(body, robot, list(logs.values())))
    source = _provenance(job, files)
    replace(body, provenance=source).write(folder / "rigid_body.json")

    extended_records = _records_with_history(job, files, logs, robot, body)
    records = _records_of_logs(logs, extended_records)
    models, left_out = job.fit_all(records, source)
    for law_name, model in refined_models.items():
        if law_name in models:
            models[law_name] = replace(model, provenance=source)
    refined: dict[str, RefinementResult] = {}
    if study.refinement is not None and not study.refinement.law:  # all laws are refined
        refined = job.refine(logs, robot, body, models)
        for law_name, refinement in refined.items():
            models[law_name] = refinement.model

    left_out_errors = job.judge_laws(logs, robot, body, list(models))
    models = {
        law_name: add_left_out_errors(model, left_out_errors) for law_name, model in models.items()
    }
    if not study.logs.test:  # a law that failed without a part of the logs has no error to show
        models = {name: model for name, model in models.items() if name in left_out_errors.laws}
        refined = {name: refinement for name, refinement in refined.items() if name in models}
    choice = choose_from_models(models, left_out_errors)
    findings += _check_models(study, models, records, choice)
    write_findings(folder, findings)
    fmus = _write_laws(job, models, folder)
    comparisons, predictions = job.compare(
        models, records, files, folder / "fmus", extended_records, left_out_errors
    )
    write_json(
        folder / "evaluation.json",
        {test: to_json(comparison) for test, comparison in comparisons.items()},
    )
    return ScoredRun(
        study=study,
        robot=robot,
        rigid_body=body,
        files=files,
        logs=logs,
        records=records,
        models=models,
        left_out={**left_out, **left_out_errors.failed},
        left_out_errors=left_out_errors,
        choice=choice,
        source=source,
        fmus=fmus,
        comparisons=comparisons,
        predictions=predictions,
        refined=refined,
    )


def _check_models(
    study: Study, models: Mapping[str, FrictionModel], records: LogRecords, choice: LawChoice
) -> list[Finding]:
    """Check the fitted laws and log what is found."""
    # Variants are references: only those that are recommended need advice.
    checked_models = {
        name: model
        for name, model in models.items()
        if name in choice.laws or name not in study.variants
    }
    training_records = select_records(study.logs.training, records)
    return log_findings(check_laws(checked_models, training_records))


def _provenance(job: Job, files: Mapping[str, Path]) -> dict[str, Any]:
    """Return the provenance of the body and the laws of a study."""
    study = job.study
    trained_files = [files[name] for name in job.trained_on]
    source = provenance(
        files=[study.robot, job.robot.model, *trained_files],
        seed=study.seed,
        **job.robot.constants,
    )
    owner = study.owner.known or job.robot.owner.known
    if owner:
        source["owner"] = owner
    if study.twin is None:  # the twin's logs are new in each run
        source["created"] = newest(trained_files)
    return source


def _records_with_history(
    job: Job, files: Mapping[str, Path], logs: Mapping[str, Log], robot: Robot, body: RigidBody
) -> LogRecords:
    """Return the records of each part of the logs; a tested part includes all rows before it."""
    extended_records = {}
    for name, log in logs.items():
        parts: Sequence[Log] = log.parts()
        if name in job.tested_on:
            history_log = job.read_with_history(name, files[name])
            if history_log is not None:
                parts = _extend_parts(log, history_log)
        extended_records[name] = [friction_records(part, robot, body) for part in parts]
    return extended_records


def _extend_parts(log: Log, history_log: Log) -> list[Log]:
    """Return the parts of a log, each with the rows of `history_log` before it."""
    part_by_end = {part.t[-1]: part for part in history_log.parts()}
    return [part_by_end.get(part.t[-1], part) for part in log.parts()]


def _records_of_logs(logs: Mapping[str, Log], extended_records: LogRecords) -> LogRecords:
    """Return the records of the logs themselves, which are the last rows of `extended_records`."""
    records: dict[str, list[list[FrictionRecord]]] = {}
    for name, log in logs.items():
        records[name] = []
        for part, part_records in zip(log.parts(), extended_records[name], strict=True):
            last_rows = slice(-len(part.t), None)
            records[name].append([record.rows(last_rows) for record in part_records])
    return records


def _write_laws(job: Job, models: Mapping[str, FrictionModel], folder: Path) -> dict[str, Path]:
    """Write laws and FMUs without documentation; return the FMUs."""
    for law_name, model in models.items():
        model.write(folder / "laws" / f"{law_name}.json")
    fmus = {law_name: folder / "fmus" / f"{law_name}.fmu" for law_name in models}
    map_models(
        models,
        lambda law, model: export_bare(model, fmus[law]),
        partial(job.progress, "building FMUs"),
    )
    return fmus


def _document_fmu(
    fmus: Mapping[str, Path],
    properties: Mapping[str, Properties],
    law_name: str,
    model: FrictionModel,
    **export_options: Any,
) -> ModelAudit | None:
    audit = None
    with suppress(SimulationError):
        audit = ModelAudit.from_model(model, model.trained)
    export_fmu(
        model, fmus[law_name], properties=properties.get(law_name), audit=audit, **export_options
    )
    return audit


def write_mixed_model(
    run_verdict: Verdict,
    models: Mapping[str, FrictionModel],
    folder: Path,
    audits: Mapping[str, ModelAudit | None],
    properties: Mapping[str, Properties],
    **export_options: Any,
) -> dict[str, FrictionModel]:
    """Write and return the model with the recommended laws, if joints differ."""
    if run_verdict.law != MIXED:
        return {}
    model = mix_models([models[law_name] for law_name in run_verdict.laws])
    model.write(folder / "laws" / f"{MIXED}.json")
    audit = None
    law_audits = [audits.get(law_name) for law_name in run_verdict.laws]
    known_audits = [law_audit for law_audit in law_audits if law_audit]
    if len(known_audits) == len(law_audits):
        joints = list(enumerate(known_audits))
        audit = ModelAudit(
            certificates=tuple(law_audit.certificates[j] for j, law_audit in joints),
            audits=tuple(law_audit.audits[j] for j, law_audit in joints),
        )
    checks = combine_results(MIXED, properties, run_verdict.laws)
    export_fmu(model, folder / run_verdict.fmu, properties=checks, audit=audit, **export_options)
    return {MIXED: model}


def _command(study: Path, platforms: Sequence[str], *, quick: bool) -> str:
    words = ["hesr run"]
    shipped_names = {path.resolve(): name for name, path in find_shipped_studies().items()}
    name = shipped_names.get(study.resolve(), "")
    if name != DEFAULT:
        path = study.name if study.is_absolute() else study.as_posix()
        words.append(name or path)
    if set(platforms) != set(DEFAULT_PLATFORMS):
        words += [f"--platform {platform}" for platform in platforms]
    if quick:
        words.append("--quick")
    return " ".join(words)
