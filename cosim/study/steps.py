"""Steps of a study, from its logs to its closed loop."""

import logging
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from inspect import signature
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from cosim.loop.traces import FOLLOWING, Following, LoopOutcome
from cosim.study.results import ScoredRun, read_findings, write_findings
from cosim.study.scores import (
    ORACLE,
    Comparison,
    Errors,
    LogRecords,
    Predictions,
    compare,
    input_classes,
    make_causal,
    select_records,
    select_window,
    table_rows,
)
from cosim.study.study import Part, RefinementStudy, Study, TimeBand
from fmu_src.export.toolchain import HOST
from fmu_src.friction.predictions import Records, predict_fmu
from hesr_model.errors import ConfigError, FitError, HesrError, LogError
from hesr_model.findings import log_findings
from hesr_model.fitting.days import Nuisance, add_fitted_nuisances
from hesr_model.fitting.estimator import Estimator, estimator, registry, select_laws
from hesr_model.fitting.fit import fit_models
from hesr_model.fitting.left_out import judge_laws
from hesr_model.forward.output_error import RefinementResult, refine
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.inference.folds import Fold, split_into_folds, thin
from hesr_model.inference.left_out import LeftOutErrors
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import Motion, smooth_logs
from hesr_model.logs.tables import read_table
from hesr_model.rigid_body.choice import identify_from_logs, identify_without
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.refinement import identify_again
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel, plugins
from hesr_model.support.arrays import Array
from hesr_model.support.ledger import find_close_names, format_suggestion
from hesr_model.support.progress import Progress, Stages, report_progress
from hesr_model.support.typed_files import to_json, write_json

if TYPE_CHECKING:
    from hesr_model.audit.properties import Properties

Returned = TypeVar("Returned")
_REFINING = "refining the rigid body"  # stage of the progress

_log = logging.getLogger(__name__)


def map_models(
    models: Mapping[str, FrictionModel],
    do: Callable[[str, FrictionModel], Returned],
    progress: Progress,
) -> dict[str, Returned]:
    """Return the results of a function of each law and model, called in processes."""
    jobs = [partial(do, law_name, model) for law_name, model in models.items()]
    costs = [model.size for model in models.values()]
    with parallel.results_of(jobs, None, costs, list(models)) as results:
        return {law_name: next(results) for law_name in report_progress(list(models), progress)}


class _ReplayCase(NamedTuple):
    """Replay of the FMU of a law over a test set, for a row of the scores."""

    test: str
    row: str
    law: str
    is_causal: bool  # velocity of a user, with its lag; else that of the fit
    measured_start: bool  # initial state estimated from measured torque


def checkpoint_folder(output: Path) -> Path:
    """Return the folder of a run's checkpoints."""
    return output.parent / f".{output.name}-unfinished"


@dataclass(frozen=True, kw_only=True)
class Job:
    """Steps of a study, which is checked against the registry of laws."""

    study: Study
    path: Path
    progress: Stages
    checkpoints: Path | None = None  # of an interrupted run
    platforms: Sequence[str] = HOST  # of the FMUs, except for MuJoCo's arm

    def __post_init__(self) -> None:
        study = self.study
        for law_name in study.laws:
            self._require_law("laws", law_name)
        for law_name, options in study.options.items():
            self._require_law(f"options.{law_name}", law_name, options)
        for name, variant in study.variants.items():
            if name in (*registry(), MIXED):
                raise self._error(
                    f"key 'variants.{name}' has the name of a law; rename it.",
                    code="study.variant_name",
                    key=f"variants.{name}",
                )
            self._require_law(f"variants.{name}.law", variant.law)
            self._require_law(f"variants.{name}.options", variant.law, variant.options)
        if study.refinement and study.refinement.law:
            self._require_law("refinement.law", study.refinement.law)
        if study.tracking:
            self._require_sources(study.tracking.sources)

    def _require_sources(self, sources: Sequence[str]) -> None:
        """Require that the study fits the laws that its closed loop uses."""
        for law_name in sources:
            if law_name not in self.laws:
                law_list = ", ".join(self.laws)
                raise self._error(
                    f"key 'tracking.sources': law '{law_name}' is not in the study; it has "
                    f"{law_list}.",
                    code="study.tracking_source",
                    key="tracking.sources",
                )

    def _error(self, text: str, *, code: str, key: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}", code=code, where=self.path, key=key)

    def _require_law(
        self, key: str, law_name: str, options: Mapping[str, Any] | None = None
    ) -> None:
        if law_name not in registry():
            raise self._error(
                f"key '{key}': law '{law_name}' is unknown; known are {', '.join(registry())}.",
                code="study.law",
                key=key,
            )
        options = options or {}
        allowed = signature(estimator(law_name)).parameters
        unknown = [name for name in options if name not in allowed]
        if unknown:
            hint = format_suggestion(find_close_names(unknown[0], allowed))
            hint = hint or f"allowed here: {', '.join(allowed) or 'none'}."
            raise self._error(
                f"unknown key '{key}.{unknown[0]}'; {hint}",
                code="key.unknown",
                key=f"{key}.{unknown[0]}",
            )
        try:
            estimator(law_name)(**options)
        except (HesrError, TypeError) as error:
            raise self._error(
                f"table '{key}': {str(error).rstrip('.')}.", code="study.options", key=key
            ) from error

    @cached_property
    def robot(self) -> RobotDescription:
        """Robot file of the study."""
        return RobotDescription.read(self.study.robot)

    @cached_property
    def laws(self) -> tuple[str, ...]:
        """Baselines, laws and variants; by default all everyday laws that the robot allows."""
        laws: Iterable[str] = self.study.laws
        if not laws:
            laws = [name for name, law in registry().items() if law.everyday and self._meets(law)]
        return tuple(dict.fromkeys((*select_laws("baseline"), *laws, *self.study.variants)))

    def _meets(self, law: type[Estimator]) -> bool:
        """Return whether the robot file states all that a law needs."""
        return all(getattr(self.robot, need) is not None for need in law.needs)

    @property
    def trained_on(self) -> list[str]:
        """Logs used for identification or training."""
        logs = self.study.logs
        return list(dict.fromkeys((*logs.identification, *logs.reversed, *logs.training)))

    @property
    def tested_on(self) -> list[str]:
        """Logs of the test sets."""
        return list(dict.fromkeys(chain.from_iterable(self.study.logs.test.values())))

    def log_files(self, folder: Path) -> dict[str, Path]:
        """Return the file of every log; those of the twin are simulated."""
        study = self.study
        names = list(dict.fromkeys((*self.trained_on, *self.tested_on)))
        if study.twin is None:
            return {name: self.path.parent / self._file_name(name) for name in names}
        # Load MuJoCo for a twin only.
        from cosim.loop.excite import excite, export_twin, twin_plant
        from cosim.loop.motions import Motions

        self.progress("running the arm", 0, 1)
        motions = study.twin.motions
        plant, signals = twin_plant(study.twin, self.path, folder)
        fmu = export_twin(plant, folder / "fmus", signals)
        files = excite(Motions.read(motions), plant, folder / "logs", fmu=fmu)
        self.progress("running the arm", 1, 1)
        for name in names:
            if name not in files:
                raise self._error(
                    f"key 'logs': '{name}' is not a motion of {motions}; its motions give "
                    f"{', '.join(files)}.",
                    code="study.motion",
                    key="logs",
                )
        return {name: files[name] for name in names}

    def _file_name(self, name: str) -> str:
        if name in self.study.logs.parts:
            return self.study.logs.parts[name].log
        return name

    def read(self, name: str, file: Path) -> Log:
        """Read a log of the study, or a named part of a log."""
        log = Log.read(file, self.robot)
        if name in self.study.logs.parts:
            return _select_part(log, name, self.study.logs.parts[name])
        return log

    def read_with_history(self, name: str, file: Path) -> Log | None:
        """Read a part of a log and all rows before it, for its start; None for a whole log."""
        part = self.study.logs.parts.get(name)
        if part is None or part.start == 0.0:
            return None
        log = Log.read(file, self.robot)
        return _select_part(log, name, part.model_copy(update={"start": 0.0}))

    def properties(self, run: ScoredRun, folder: Path) -> "dict[str, Properties]":
        """Run the physics checks, if present, on all laws and write the results."""
        from hesr_model.audit.properties import Subject, write_properties

        battery = plugins.load("hesr.tests").get("properties")
        if battery is None:
            return {}
        property_list = battery.load()(
            [Subject(name=name, model=model) for name, model in run.models.items()],
            body=(run.robot, run.rigid_body),
            progress=partial(self.progress, "testing the laws"),
            checkpoints=self.checkpoints and self.checkpoints / "properties",
        )
        properties_by_law = dict(zip(run.models, property_list, strict=True))
        write_properties(folder / "properties.json", properties_by_law)
        return properties_by_law

    def closed_loop(self, run: ScoredRun, folder: Path, *, quick: bool) -> LoopOutcome | None:
        """Run the closed loop of the study; None if it has none."""
        if self.study.tracking is None or self.study.twin is None:
            return None
        from cosim.loop.excite import twin_plant
        from cosim.loop.run import run_loop

        plant, signals = twin_plant(self.study.twin, self.path, folder)
        assert signals is not None  # `Study` requires them with `tracking`
        outcome = run_loop(
            run,
            self.study.tracking,
            plant,
            signals,
            folder,
            self.checkpoints,
            self.progress,
            quick=quick,
            platforms=self.platforms,
        )
        write_json(folder / "closed_loop.json", to_json(outcome))
        if outcome.findings:
            write_findings(folder, [*read_findings(folder), *log_findings(outcome.findings)])
        return outcome

    def following(
        self, run: ScoredRun, models: Mapping[str, FrictionModel], law_name: str, folder: Path
    ) -> Following:
        """Predict and write the following error with feed-forward, if offered; `law_name` last."""
        predict = plugins.load("hesr.studies").get("following")
        if predict is None:
            return Following()
        names = [*chain.from_iterable(self.study.logs.test.values()), *run.logs]
        logs = [run.logs[name] for name in names]
        models_by_law = {name: models[name] for name in select_laws("quick") if name in models}
        models_by_law[law_name] = models_by_law.pop(law_name, models[law_name])
        following_errors: Following = predict.load()(
            logs, run.robot, run.rigid_body, models_by_law, models[law_name]
        )
        write_json(folder / FOLLOWING, to_json(following_errors))
        return following_errors

    def score_truths(self, laws: Sequence[str]) -> dict[str, Errors]:
        """Score laws on the alternative plants of the twin, if there are any, and a plug-in."""
        score_under_truths = plugins.load("hesr.studies").get("truths")
        if score_under_truths is None or self.study.twin is None or not self.study.twin.truths:
            return {}
        progress = partial(self.progress, "trying alternative plants")
        truth_errors: dict[str, Errors] = score_under_truths.load()(
            self.study, self.path, laws, progress=progress
        )
        return truth_errors

    def rigid_body(
        self, logs: Mapping[str, Log], robot: Robot
    ) -> tuple[RigidBody, dict[str, FrictionModel]]:
        """Identify the rigid body, refine it if configured, and return the refined law, if any."""
        forward_logs = [logs[name] for name in self.study.logs.identification]
        backward_logs = [logs[name] for name in self.study.logs.reversed]
        self.progress("identifying the rigid body", 0, 1)
        body = identify_from_logs(
            forward_logs, robot, self.study.body_option, reversed_logs=backward_logs
        )
        self.progress("identifying the rigid body", 1, 1)
        refinement = self.study.refinement
        if refinement is None:
            return body, {}
        if refinement.law:
            return self._refine_with_law(refinement, logs, robot, body)
        if robot.n > 1:
            return body, {}
        return self._refine_with_best_law(refinement, logs, robot, body), {}

    def _refine_with_best_law(
        self, refinement: RefinementStudy, logs: Mapping[str, Log], robot: Robot, body: RigidBody
    ) -> RigidBody:
        """Refine the body with the law that explains most; every law is refined later with it."""
        laws: Sequence[str] = self.laws
        for _ in range(refinement.rounds):
            records = self._training_records(logs, robot, body)
            models = self.fit(records, laws, _REFINING, {}, left_out=lambda *_: None)
            refined = self.refine(logs, robot, body, models, with_body=True)
            law_name = min(refined, key=lambda law: refined[law].size)
            body = refined[law_name].body
            laws = (law_name,)
        return body

    def _refine_with_law(
        self, refinement: RefinementStudy, logs: Mapping[str, Log], robot: Robot, body: RigidBody
    ) -> tuple[RigidBody, dict[str, FrictionModel]]:
        """Refine the body with the law of the study; return it with the law refined, if it is."""
        law_name = refinement.law
        models = {}
        for _ in range(refinement.rounds):
            records = self._training_records(logs, robot, body)
            model = self.fit(records, (law_name,), _REFINING, {})[law_name]
            if refinement.kind == "output_error":
                motions = smooth_logs(self._training_logs(logs), robot)
                refined_law = refine(robot, body, model, motions)
                body = refined_law.body
                models[law_name] = refined_law.model
            else:
                forward_logs = [logs[name] for name in self.study.logs.identification]
                backward_logs = [logs[name] for name in self.study.logs.reversed]
                body = identify_again(forward_logs, robot, body, model, reversed_logs=backward_logs)
        return body, models

    def _training_records(
        self, logs: Mapping[str, Log], robot: Robot, body: RigidBody
    ) -> LogRecords:
        records = {}
        for name in self.study.logs.training:
            records[name] = [friction_records(part, robot, body) for part in logs[name].parts()]
        return records

    def _training_logs(self, logs: Mapping[str, Log]) -> list[Log]:
        return [logs[name] for name in self.study.logs.training]

    def refine(
        self,
        logs: Mapping[str, Log],
        robot: Robot,
        body: RigidBody,
        models: Mapping[str, FrictionModel],
        *,
        with_body: bool = False,
    ) -> dict[str, RefinementResult]:
        """Refine laws by output error on the training logs."""
        motions = smooth_logs(self._training_logs(logs), robot)

        def refine_law(_: str, model: FrictionModel) -> RefinementResult:
            return refine(robot, body, model, motions, with_body=with_body, seed=self.study.seed)

        return map_models(models, refine_law, partial(self.progress, "refining by output error"))

    @property
    def _options(self) -> dict[str, Mapping[str, Any]]:
        """Options of the laws and variants, by name."""
        variants = self.study.variants
        return {
            **self.study.options,
            **{name: variant.options for name, variant in variants.items()},
        }

    @property
    def _variant_laws(self) -> dict[str, str]:
        """Law of each variant, by name."""
        return {name: variant.law for name, variant in self.study.variants.items()}

    def fit(
        self,
        records: LogRecords,
        laws: Sequence[str],
        stage: str,
        source: Mapping[str, Any],
        *,
        left_out: Callable[[str, FitError], None] | None = None,
    ) -> dict[str, FrictionModel]:
        """Fit laws to the training logs; see `fit_models`."""
        study = self.study
        return fit_models(
            laws,
            select_records(study.logs.training, records),
            robot=self.robot.name,
            seed=study.seed,
            options=self._options,
            variants=self._variant_laws,
            provenance=source,
            progress=partial(self.progress, stage),
            report_left_out=left_out,
            checkpoints=self.checkpoints and self.checkpoints / "laws",
            per_log=study.per_log,
        )

    def fit_all(
        self, records: LogRecords, source: Mapping[str, Any]
    ) -> tuple[dict[str, FrictionModel], dict[str, str]]:
        """Fit all laws except those that the training logs do not determine; return their reasons.

        A law that the closed loop needs raises instead.
        """
        left_out: dict[str, str] = {}

        def leave_out(law_name: str, error: FitError) -> None:
            if self.study.tracking and law_name in self.study.tracking.sources:
                raise error
            left_out[law_name] = str(error)
            _log.warning("law '%s' is left out: %s", law_name, error)

        models = self.fit(records, self.laws, "fitting laws", source, left_out=leave_out)
        return models, left_out

    def judge_laws(
        self, logs: Mapping[str, Log], robot: Robot, body: RigidBody, laws: Sequence[str]
    ) -> LeftOutErrors:
        """Judge laws on rows of the training logs that neither they nor their body were fitted to.

        Each fold leaves out logs, or a block of time, for both the body and the laws.
        """
        study = self.study
        motions: list[Motion] = []
        for name in study.logs.training:
            motions += _smooth_log(logs[name], name, robot)
        folds = split_into_folds(motions, study.folds)
        identifying_logs = {*study.logs.identification, *study.logs.reversed}
        bodies = [body] * len(folds)
        if identifying_logs & set(study.logs.training):
            bodies = self._identify_fold_bodies(folds, logs, robot, body)
        return judge_laws(
            laws,
            motions,
            robot,
            folds,
            bodies,
            seed=study.seed,
            options=self._options,
            variants=self._variant_laws,
            per_log=study.per_log,
            checkpoints=self.checkpoints and self.checkpoints / "laws",
            progress=partial(self.progress, "judging laws on left-out rows"),
        )

    def _identify_fold_bodies(
        self, folds: Sequence[Fold], logs: Mapping[str, Log], robot: Robot, body: RigidBody
    ) -> list[RigidBody]:
        """Identify the body of each fold without the rows that the fold judges."""
        study_logs = self.study.logs
        # Laws are not judged on the other logs, which therefore identify every fold's body.
        other_motions: list[Motion] = []
        for name in self.trained_on:
            if name not in study_logs.training:
                other_motions += map(thin, _smooth_log(logs[name], name, robot))
        bodies = []
        for fold in folds:
            known_rows = replace(fold, training=(*fold.training, *other_motions))
            fold_body = identify_without(
                known_rows,
                robot,
                body,
                study_logs.identification,
                reversed_logs=study_logs.reversed,
            )
            bodies.append(fold_body)
        return bodies

    def compare(
        self,
        models: Mapping[str, FrictionModel],
        records: LogRecords,
        files: Mapping[str, Path],
        fmus: Path,
        extended_records: LogRecords,
        left_out: LeftOutErrors,
    ) -> tuple[dict[str, Comparison], Predictions]:
        """Score the FMUs on every test set and its bands; return scores and torques.

        Their velocity is causal; all rows of whole tests are also predicted without its lag.
        With `per_log`, a second comparison has the offsets of each test log fitted. `records` are
        the last rows of `extended_records`. A study without tests has the errors of laws on
        left-out rows instead.
        """
        study = self.study
        comparisons = {}
        predictions = {}
        inputs = input_classes(models)
        replayed = self._replay_fmus(models, records, fmus, extended_records)
        for test, names in study.logs.judged.items():
            test_records = select_records(names, records)
            if study.logs.test:
                torques = replayed[test, True]
            else:
                torques = _add_left_out_errors(names, test_records, left_out)
            if study.twin:
                torques[ORACLE] = self._true_friction([files[name] for name in names])
            comparison = compare(test_records, torques, inputs, models, replayed.get((test, False)))
            predictions[test] = torques
            if study.per_log:
                comparisons[test] = replace(comparison, per_log=())
                name = f"{test}, {' and '.join(study.per_log)} of each log fitted"
                comparisons[name] = _compare_with_nuisances(
                    test_records, torques, inputs, study.per_log
                )
            else:
                comparisons[test] = comparison
            for band in study.bands:
                if band.test == test:
                    comparisons[band.name] = _compare_in_band(test_records, torques, inputs, band)
        return comparisons, predictions

    def _replay_fmus(
        self,
        models: Mapping[str, FrictionModel],
        records: LogRecords,
        fmus: Path,
        extended_records: LogRecords,
    ) -> dict[tuple[str, bool], dict[str, list[list[Array]]]]:
        """Return torques of the FMUs by (test, is causal) and row, [joint][log]."""
        logs = self.study.logs.test
        cases = _list_replays(logs, models)
        jobs = []
        for case in cases:
            test_records = select_records(logs[case.test], extended_records)
            jobs.append(
                partial(
                    predict_fmu,
                    fmus / f"{case.law}.fmu",
                    make_causal(test_records) if case.is_causal else test_records,
                    measured_start=case.measured_start,
                )
            )
        replayed: dict[tuple[str, bool], dict[str, list[list[Array]]]] = defaultdict(dict)
        names = [f"{case.row} on {case.test}" for case in cases]
        with parallel.results_of(jobs, names=names) as results:
            for case in report_progress(cases, partial(self.progress, "replaying the FMUs")):
                test_records = select_records(logs[case.test], records)
                torques = _cut_torques(next(results), test_records)
                replayed[case.test, case.is_causal][case.row] = torques
        return replayed

    def _true_friction(self, files: Sequence[Path]) -> list[list[Array]]:
        """Return the friction [joint][log] of the twin that made some logs."""
        from cosim.loop.excite import truth_path

        names = [f"tau_f{number}" for number in range(1, len(self.robot.joints) + 1)]
        torques: list[list[Array]] = [[] for _ in names]
        for file in files:
            tau = read_table(truth_path(file)).numbers(names)
            for j, joint_torques in enumerate(torques):
                joint_torques.append(tau[:, j])
        return torques


def _select_part(log: Log, name: str, part: Part) -> Log:
    """Return the rows of a part of a log."""
    seconds = log.t - log.t[0]
    rows = np.flatnonzero((seconds >= part.start) & (seconds < part.stop))
    if len(rows) < 2:
        raise LogError(
            f"{log.path}: no rows from {part.start:g} to {part.stop:g} s, the part '{name}' of "
            f"the study; the log is {seconds[-1]:.4g} s long.",
            code="study.part",
            where=log.path or "",
            key=f"logs.parts.{name}",
        )
    return replace(log.rows(rows), name=name)


def _smooth_log(log: Log, name: str, robot: Robot) -> list[Motion]:
    """Return the smoothed motion of each part of a log, with the name of the log in the study."""
    return [replace(motion, name=name) for motion in smooth_logs([log], robot)]


def _list_replays(tests: Iterable[str], models: Mapping[str, FrictionModel]) -> list[_ReplayCase]:
    cases = []
    for test in tests:
        for row, (law_name, measured_start) in table_rows(models).items():
            cases.append(_ReplayCase(test, row, law_name, True, measured_start))
            cases.append(_ReplayCase(test, row, law_name, False, measured_start))
    return cases


def _cut_torques(torques: Sequence[Sequence[Array]], test_records: Records) -> list[list[Array]]:
    """Return the last torques [joint][log], those of the rows of the records."""
    shortened = []
    for joint_torques, joint_records in zip(torques, test_records, strict=True):
        pairs = zip(joint_torques, joint_records, strict=True)
        shortened.append([tau[-len(record.t) :] for tau, record in pairs])
    return shortened


def _add_left_out_errors(
    names: Sequence[str], records: Records, left_out: LeftOutErrors
) -> dict[str, list[list[Array]]]:
    """Return torques [joint][log] by law that differ from the records by the left-out errors."""
    torques = {}
    for law_name, law_errors in left_out.joint_errors.items():
        # A log that is split at gaps has several errors.
        errors_by_log: dict[str, list[Array]] = defaultdict(list)
        for log_name, errors in zip(left_out.log_names, law_errors, strict=True):
            errors_by_log[log_name].append(errors)
        ordered_errors = list(chain.from_iterable(errors_by_log[name] for name in names))
        law_torques = []
        for j, joint_records in enumerate(records):
            pairs = zip(joint_records, ordered_errors, strict=True)
            law_torques.append([record.tau + errors[:, j] for record, errors in pairs])
        torques[law_name] = law_torques
    return torques


def _compare_with_nuisances(
    test_records: Records,
    torques: Mapping[str, Sequence[Sequence[Array]]],
    inputs: Mapping[str, str],
    per_log: tuple[Nuisance, ...],
) -> Comparison:
    """Compare laws after fitting the nuisances of each log."""
    fitted_torques = {}
    for law_name, law_torques in torques.items():
        fitted_torques[law_name] = [
            add_fitted_nuisances(joint_torques, joint_records, per_log)
            for joint_torques, joint_records in zip(law_torques, test_records, strict=True)
        ]
    return replace(compare(test_records, fitted_torques, inputs), per_log=per_log)


def _compare_in_band(
    test_records: Records,
    torques: Mapping[str, Sequence[Sequence[Array]]],
    inputs: Mapping[str, str],
    band: TimeBand,
) -> Comparison:
    """Compare laws on the rows of a band of a test."""
    band_torques = {}
    for law_name, law_torques in torques.items():
        band_records, band_torques[law_name] = select_window(
            test_records, law_torques, band.start, band.stop
        )
    return compare(band_records, band_torques, inputs)
