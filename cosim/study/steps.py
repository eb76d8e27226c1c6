"""Steps of a study, from its logs to its closed loop."""

import logging
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from inspect import signature
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from cosim.loop.traces import FOLLOWING, Following, LoopOutcome
from cosim.study.results import Scored, read_findings, write_findings
from cosim.study.scores import (
    ORACLE,
    Comparison,
    Errors,
    LogRecords,
    Predictions,
    causal,
    compare,
    input_classes,
    records_of,
    rows_of,
    within,
)
from cosim.study.study import Part, Study
from fmu_src.export.toolchain import HOST
from fmu_src.friction.predictions import predict_fmu
from hesr_model.errors import ConfigError, FitError, HesrError, LogError
from hesr_model.findings import log_findings
from hesr_model.fitting.days import add_fitted_nuisances
from hesr_model.fitting.estimator import estimator, registry, select_laws
from hesr_model.fitting.fit import fit_models
from hesr_model.forward.output_error import Refined, refine
from hesr_model.friction.model import MIXED, FrictionModel
from hesr_model.logs.robot_log import Log
from hesr_model.logs.signals import smoothed
from hesr_model.logs.tables import read_table
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.refinement import identify_again
from hesr_model.rigid_body.residual import friction_records
from hesr_model.robots.robot import Robot, RobotDescription
from hesr_model.support import parallel, plugins
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Progress, Stages, counted
from hesr_model.support.typed_files import to_json, write_json

if TYPE_CHECKING:
    from hesr_model.audit.properties import Properties

Returned = TypeVar("Returned")

_log = logging.getLogger(__name__)


def of_each(
    models: Mapping[str, FrictionModel],
    do: Callable[[str, FrictionModel], Returned],
    progress: Progress,
) -> dict[str, Returned]:
    """Return the results of a function of each law and model, called in processes."""
    jobs = [partial(do, law, model) for law, model in models.items()]
    costs = [model.size for model in models.values()]
    with parallel.results_of(jobs, None, costs, list(models)) as done:
        return {law: next(done) for law in counted(list(models), progress)}


@dataclass(frozen=True, kw_only=True)
class Job:
    """Steps of a study, which is checked against the registry of laws."""

    study: Study
    path: Path
    progress: Stages
    kept: Path | None = None  # checkpoints of an interrupted run
    platforms: Sequence[str] = HOST  # of the FMUs, except for MuJoCo's arm

    def __post_init__(self) -> None:
        study = self.study
        for law in study.laws:
            self._require_law("laws", law)
        for law, options in study.options.items():
            self._require_law(f"options.{law}", law, options)
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
        for law in study.tracking.sources if study.tracking else ():
            if law not in self.laws:
                listed = ", ".join(self.laws)
                raise self._error(
                    f"key 'tracking.sources': law '{law}' is not in the study; it has {listed}.",
                    code="study.tracking_source",
                    key="tracking.sources",
                )

    def _error(self, text: str, *, code: str, key: str) -> ConfigError:
        return ConfigError(f"{self.path}: {text}", code=code, where=self.path, key=key)

    def _require_law(self, key: str, law: str, options: Mapping[str, Any] | None = None) -> None:
        if law not in registry():
            raise self._error(
                f"key '{key}': law '{law}' is unknown; known are {', '.join(registry())}.",
                code="study.law",
                key=key,
            )
        options = options or {}
        allowed = signature(estimator(law)).parameters
        unknown = [name for name in options if name not in allowed]
        if unknown:
            raise self._error(
                f"unknown key '{key}.{unknown[0]}'; allowed here: {', '.join(allowed) or 'none'}.",
                code="key.unknown",
                key=f"{key}.{unknown[0]}",
            )
        try:
            estimator(law)(**options)
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
        """Laws and variants; by default all everyday laws that the robot allows."""
        possible = (
            name
            for name, law in registry().items()
            if law.everyday and all(getattr(self.robot, need) is not None for need in law.needs)
        )
        return (*(self.study.laws or possible), *self.study.variants)

    @property
    def trained_on(self) -> list[str]:
        """Logs used for identification or training."""
        logs = self.study.logs
        return list(dict.fromkeys((*logs.identification, *logs.reversed, *logs.training)))

    def log_files(self, folder: Path) -> dict[str, Path]:
        """Return the file of every log; those of the twin are simulated."""
        tested = (name for logs in self.study.logs.test.values() for name in logs)
        names = dict.fromkeys((*self.trained_on, *tested))
        if self.study.twin is None:
            parts = self.study.logs.parts
            files = {name: parts[name].log if name in parts else name for name in names}
            return {name: self.path.parent / file for name, file in files.items()}
        # Load MuJoCo for a twin only.
        from cosim.loop.excite import excite, export_twin, twin_plant
        from cosim.loop.motions import Motions

        self.progress("running the arm", 0, 1)
        motions = self.study.twin.motions
        plant, signals = twin_plant(self.study.twin, self.path, folder)
        arm = export_twin(plant, folder / "fmus", signals)
        made = excite(Motions.read(motions), plant, folder / "logs", fmu=arm)
        self.progress("running the arm", 1, 1)
        for name in names:
            if name not in made:
                raise self._error(
                    f"key 'logs': '{name}' is not a motion of {motions}; its motions give "
                    f"{', '.join(made)}.",
                    code="study.motion",
                    key="logs",
                )
        return {name: made[name] for name in names}

    def read(self, name: str, file: Path) -> Log:
        """Read a log of the study, or a named part of a log."""
        log = Log.read(file, self.robot)
        part = self.study.logs.parts.get(name)
        return log if part is None else self._part(log, name, part)

    def read_with_history(self, name: str, file: Path) -> Log | None:
        """Read a part of a log and all rows before it, for its start; None for a whole log."""
        part = self.study.logs.parts.get(name)
        if part is None or part.start == 0.0:
            return None
        return self._part(Log.read(file, self.robot), name, part.model_copy(update={"start": 0.0}))

    def _part(self, log: Log, name: str, part: Part) -> Log:
        since = log.t - log.t[0]
        rows = np.flatnonzero((since >= part.start) & (since < part.stop))
        if len(rows) < 2:
            raise LogError(
                f"{log.path}: no rows from {part.start:g} to {part.stop:g} s, the part '{name}' of "
                f"the study; the log is {since[-1]:.4g} s long.",
                code="study.part",
                where=log.path or "",
                key=f"logs.parts.{name}",
            )
        return replace(log.rows(rows), name=name)

    def properties(self, run: Scored, folder: Path) -> "dict[str, Properties]":
        """Run the physics checks, if present, on all laws and write the results."""
        from hesr_model.audit.properties import Subject, write_properties

        battery = plugins.load("hesr.tests").get("properties")
        if battery is None:
            return {}
        listed = battery.load()(
            [Subject(name=name, model=model) for name, model in run.models.items()],
            body=(run.robot, run.rigid_body),
            progress=partial(self.progress, "testing the laws"),
            kept=self.kept and self.kept / "properties",
        )
        found = dict(zip(run.models, listed, strict=True))
        write_properties(folder / "properties.json", found)
        return found

    def closed_loop(self, run: Scored, folder: Path, *, quick: bool) -> LoopOutcome | None:
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
            self.kept,
            self.progress,
            quick=quick,
            platforms=self.platforms,
        )
        write_json(folder / "closed_loop.json", to_json(outcome))
        if outcome.findings:
            write_findings(folder, [*read_findings(folder), *log_findings(outcome.findings)])
        return outcome

    def following(
        self, run: Scored, models: Mapping[str, FrictionModel], law: str, folder: Path
    ) -> Following:
        """Predict and write the following error with feed-forward, at last of `law`, if offered."""
        predict = plugins.load("hesr.studies").get("following")
        if predict is None:
            return Following()
        names = [*(name for test in self.study.logs.test.values() for name in test), *run.logs]
        logs = [run.logs[name] for name in names]
        shown = {name: models[name] for name in select_laws("quick") if name in models}
        shown[law] = shown.pop(law, models[law])
        found: Following = predict.load()(logs, run.robot, run.rigid_body, shown, models[law])
        write_json(folder / FOLLOWING, to_json(found))
        return found

    def other_truths(self, laws: Sequence[str]) -> dict[str, Errors]:
        """Score laws on the alternative plants of the twin, if there are any, and a plug-in."""
        under_truths = plugins.load("hesr.studies").get("truths")
        if under_truths is None or self.study.twin is None or not self.study.twin.truths:
            return {}
        progress = partial(self.progress, "trying alternative plants")
        found: dict[str, Errors] = under_truths.load()(
            self.study, self.path, laws, progress=progress
        )
        return found

    def rigid_body(
        self, logs: Mapping[str, Log], robot: Robot
    ) -> tuple[RigidBody, dict[str, FrictionModel]]:
        """Identify the rigid body, refine it if configured, and return the refined law, if any."""
        forward = [logs[name] for name in self.study.logs.identification]
        backward = [logs[name] for name in self.study.logs.reversed]
        self.progress("identifying the rigid body", 0, 1)
        body = identify(forward, robot, reversed_logs=backward, physical=self.study.physical)
        self.progress("identifying the rigid body", 1, 1)
        refinement = self.study.refinement
        refined = {}
        if refinement is None:
            return body, {}
        training = {name: logs[name] for name in self.study.logs.training}
        law = refinement.law
        laws = self.laws
        if not law and robot.n > 1:
            return body, {}
        for _ in range(refinement.rounds):
            records = {
                name: [friction_records(part, robot, body) for part in log.parts()]
                for name, log in training.items()
            }
            what = "refining the rigid body"
            if not law:  # every law is refined later, with this body
                tried = self.fit(records, laws, what, {}, left_out=lambda *_: None)
                both = self.refine(logs, robot, body, tried, with_body=True)
                laws = (min(both, key=lambda name: both[name].size),)
                body = both[laws[0]].body
                continue
            model = self.fit(records, (law,), what, {})[law]
            if refinement.kind == "output_error":
                together = refine(robot, body, model, smoothed(list(training.values()), robot))
                body = together.body
                refined = {law: together.friction}
            else:
                body = identify_again(forward, robot, body, model, reversed_logs=backward)
        return body, refined

    def refine(
        self,
        logs: Mapping[str, Log],
        robot: Robot,
        body: RigidBody,
        models: Mapping[str, FrictionModel],
        *,
        with_body: bool = False,
    ) -> dict[str, Refined]:
        """Refine laws by output error on the training logs."""
        motions = smoothed([logs[name] for name in self.study.logs.training], robot)
        seed = self.study.seed
        progress = partial(self.progress, "refining by output error")
        own = partial(refine, robot, body, motions=motions, with_body=with_body, seed=seed)
        return of_each(models, lambda _, friction: own(friction), progress)

    def fit(
        self,
        records: LogRecords,
        laws: Sequence[str],
        what: str,
        source: Mapping[str, Any],
        *,
        left_out: Callable[[str, FitError], None] | None = None,
    ) -> dict[str, FrictionModel]:
        """Fit laws to the training logs; see `fit_models`."""
        study = self.study
        variants = study.variants
        return fit_models(
            laws,
            records_of(study.logs.training, records),
            robot=self.robot.name,
            seed=study.seed,
            options={**study.options, **{name: v.options for name, v in variants.items()}},
            variants={name: v.law for name, v in variants.items()},
            provenance=source,
            progress=partial(self.progress, what),
            left_out=left_out,
            kept=self.kept and self.kept / "laws",
            per_log=study.per_log,
        )

    def fit_all(
        self, records: LogRecords, source: Mapping[str, Any]
    ) -> tuple[dict[str, FrictionModel], dict[str, str]]:
        """Fit all laws except those that the training logs do not determine; return their reasons.

        A law that the closed loop needs raises instead.
        """
        reasons: dict[str, str] = {}

        def leave_out(law: str, error: FitError) -> None:
            if self.study.tracking and law in self.study.tracking.sources:
                raise error
            reasons[law] = str(error)
            _log.warning("law '%s' is left out: %s", law, error)

        return self.fit(records, self.laws, "fitting laws", source, left_out=leave_out), reasons

    def compare(
        self,
        models: Mapping[str, FrictionModel],
        records: LogRecords,
        files: Mapping[str, Path],
        fmus: Path,
        runs: LogRecords,
    ) -> tuple[dict[str, Comparison], Predictions]:
        """Score the FMUs on every test set and its bands; return scores and torques.

        Their velocity is causal; all rows of whole tests are also predicted without its lag.
        With `per_log`, a second comparison has the offsets of each test log fitted. `records` are
        the last rows of `runs`.
        """
        comparisons = {}
        predictions = {}
        inputs = input_classes(models)
        tests = self.study.logs.test
        every = product(tests, rows_of(models).items(), (True, False))
        cases = [(test, row, lag, *case) for test, (row, case), lag in every]
        jobs = [
            partial(
                predict_fmu,
                fmus / f"{law}.fmu",
                (causal if lag else list)(records_of(tests[test], runs)),
                measured_start=with_start,
            )
            for test, _, lag, law, with_start in cases
        ]
        replayed: dict[tuple[str, bool], dict[str, list[list[Array]]]] = defaultdict(dict)
        names = [f"{row} on {test}" for test, row, *_ in cases]
        with parallel.results_of(jobs, names=names) as results:
            for test, row, lag, *_ in counted(cases, partial(self.progress, "replaying the FMUs")):
                tested = records_of(tests[test], records)
                replayed[test, lag][row] = [
                    [tau[-len(record.t) :] for tau, record in zip(*of_joint, strict=True)]
                    for of_joint in zip(next(results), tested, strict=True)
                ]
        for name, logs in tests.items():
            tested = records_of(logs, records)
            predicted = replayed[name, True]
            if self.study.twin:
                predicted[ORACLE] = self._true_friction([files[log] for log in logs])
            comparisons[name] = compare(tested, predicted, inputs, models, replayed[name, False])
            predictions[name] = predicted
            per_log = self.study.per_log
            if per_log:
                comparisons[name] = replace(comparisons[name], per_log=())
                fitted = {
                    law: [
                        add_fitted_nuisances(p, record, per_log)
                        for p, record in zip(whole, tested, strict=True)
                    ]
                    for law, whole in predicted.items()
                }
                fitted_name = f"{name}, {' and '.join(per_log)} of each log fitted"
                comparisons[fitted_name] = replace(compare(tested, fitted, inputs), per_log=per_log)
            for band in self.study.bands:
                if band.test == name:
                    parts = {
                        law: within(tested, whole, band.start, band.stop)
                        for law, whole in predicted.items()
                    }
                    rows = next(iter(parts.values()))[0]
                    comparisons[band.name] = compare(
                        rows, {law: p for law, (_, p) in parts.items()}, inputs
                    )
        return comparisons, predictions

    def _true_friction(self, logs: Sequence[Path]) -> list[list[Array]]:
        from cosim.loop.excite import truth_of

        joints = len(self.robot.joints)
        names = [f"tau_f{k}" for k in range(1, joints + 1)]
        truths = [read_table(truth_of(log)).numbers(names) for log in logs]
        return [[truth[:, joint] for truth in truths] for joint in range(joints)]
