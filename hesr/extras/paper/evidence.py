"""Files of the study, and evidence on its claims: logs, laws, torques and closed loops."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from cosim.loop.closed_loop import PerJoint, Scheme, StandIn, Tracking
from cosim.loop.excite import Recording, export_twin, recordings, twin_plant
from cosim.loop.loops import assemble, build, motions, require_reachable
from cosim.loop.motions import Motions
from cosim.loop.traces import Tracked
from cosim.study.scores import LogRecords, predict_models, records_of, within
from cosim.study.steps import Job
from cosim.study.study import Study, Twin
from fmu_src.arm.truth import true_friction
from fmu_src.friction.friction_fmu import export_bare
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.inference.comparison import law_errors
from hesr_model.logs.signals import near_reversals
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import FrictionRecord, friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Stages
from hesr_model.support.typed_files import Config

Limit = float | tuple[float, ...]  # for all values of a claim, or one for each


class Claim(Config):
    """A claim of the paper, and the measure and limits that decide on it."""

    number: int = Field(ge=1)
    text: str
    where: str  # section, table or figure
    printed: str  # figures of the paper
    test: str  # meaning of the values
    measure: str = ""  # function of `hesr.extras.paper.measures`; none if not testable
    options: Mapping[str, Any] = {}  # its arguments
    joint: str = ""  # the only one, such as J2
    at_least: Limit | None = None
    at_most: Limit | None = None


class PaperStudy(Study):
    """Study of a twin whose laws are trained on the sweep, and on a sine of one joint at a time."""

    claims: tuple[Claim, ...] = Field(min_length=1)
    sine: tuple[str, ...] = Field(min_length=1)  # log that trains each joint
    literal: str  # the paper's own law, a variant
    controllers: Mapping[str, Mapping[str, PerJoint | float]]  # changed gains by name
    twin: Twin
    tracking: Tracking


TWIN = "twin"
LUGRE = "LuGre"  # true frictions
SINE = "sine"
SWEEP = "sweep"  # training motions
Records = Sequence[Sequence[FrictionRecord]]  # [joint][log]


@dataclass(frozen=True, kw_only=True)
class Number:
    """A value and its 95 % interval, if the data allow one."""

    value: float
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Laws of one training motion and true friction, and their torques on test sets and bands."""

    models: Mapping[str, FrictionModel]
    training: Records
    tests: Mapping[str, Records]
    torques: Mapping[str, Mapping[str, list[list[Array]]]]  # [joint][log] by test and law

    def errors(self, law: str, test: str, joint: int) -> list[Array]:
        """Return the errors (N,) [N.m] of a law on every log."""
        pairs = zip(self.torques[test][law][joint], self.tests[test][joint], strict=True)
        return [p - record.tau for p, record in pairs]

    def ratio(
        self, law: str, others: Sequence[str], test: str, joint: int, *, reversals: bool
    ) -> Number:
        """Return the RMSE of a law over the lowest one of others, of all rows or at reversals."""
        logs = self.tests[test][joint]
        errors = {}
        near = [
            near_reversals(record.t, record.dq) if reversals else np.ones(len(record.t))
            for record in logs
        ]
        for name in (law, *others):
            own = self.errors(name, test, joint)
            errors[name] = [rows * error for rows, error in zip(near, own, strict=True)]
        found = law_errors(errors, [float(np.median(np.diff(record.t))) for record in logs])
        ratio = found.ratios(min(others, key=lambda o: found.log_rmse[found.laws.index(o)]))[law]
        return Number(value=ratio.value, low=ratio.low, high=ratio.high)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Everything that the measures of the claims use."""

    study: PaperStudy
    robot: Robot
    body: RigidBody  # from averaged motions
    recordings: Mapping[str, Recording]
    records: LogRecords
    cases: Mapping[str, Mapping[str, Case]]  # by true friction and training motion
    tracked: Mapping[str, Mapping[str, Tracked]]  # by controller and law


def gather(study: PaperStudy, path: Path, folder: Path, progress: Stages) -> Evidence:
    """Run the twin, fit all laws and run the closed loop, with files in `folder`."""
    job = Job(study=study, path=path, progress=progress)
    logs = study.logs
    plant, signals = twin_plant(study.twin, path, folder)
    assert signals is not None  # `Study` requires them with `tracking`
    arm = export_twin(plant, folder, signals)
    made = {r.log.name: r for r in recordings(Motions.read(study.twin.motions), plant, fmu=arm)}
    robot = Robot(job.robot)
    forward, backward = (
        [made[name].log for name in names] for names in (logs.identification, logs.reversed)
    )
    body = identify(forward, robot, reversed_logs=backward, method="paper")
    records = {name: [friction_records(r.log, robot, body)] for name, r in made.items()}
    cases = {TWIN: dict(_cases(job, study, records, job.laws))}
    models = cases[TWIN][SWEEP].models
    laws = [law for law in models if "lugre" in law or law in ("stribeck", study.literal)]
    cases[LUGRE] = dict(_cases(job, study, _under(models["lugre"], records, made), laws))
    require_reachable(study.tracking, robot)
    truth = true_friction(
        plant.model, plant.joints, sample_time=1.0 / plant.sample_rate, losses=signals.losses
    )
    build(folder, robot, body, plant, oracle=truth)
    tracking = study.tracking
    tracked = {}
    fmus = {law: export_bare(models[law], folder / f"{law}.fmu") for law in tracking.sources}
    for name, change in study.controllers.items():
        changed = tracking.model_copy(update={"gains": tracking.gains.model_copy(update=change)})
        loop = assemble(
            folder, robot, tracking=changed, friction=fmus, plant=plant, progress=progress
        )
        own = Scheme(compensation="torque_error")
        rows = [loop.row(law, own) for law in (StandIn.BODY_ONLY, *fmus)]
        rows.append(loop.row(StandIn.VELOCITY_ONLY, Scheme(compensation="none")))
        ran = loop.track(rows, motions(changed), changed.duration, f"tracking, {name}", traced=True)
        tracked[name] = {row.law: row for row in ran}
    return Evidence(study, robot, body, made, records, cases, tracked)


def _under(truth: FrictionModel, records: LogRecords, made: Mapping[str, Recording]) -> LogRecords:
    found = {}
    for name, [of_joints] in records.items():
        was = made[name].truth
        inputs = zip(truth.laws, of_joints, was.dq.T, was.tau_f_true.T, strict=True)
        found[name] = [
            [
                replace(record, tau=record.tau - f + predict(law, t=record.t, dq=dq))
                for law, record, dq, f in inputs
            ]
        ]
    return found


def _cases(
    job: Job, study: PaperStudy, records: LogRecords, laws: Sequence[str]
) -> Iterator[tuple[str, Case]]:
    variants = {name: one for name, one in study.variants.items() if name in laws}
    tests = {test: records_of(names, records) for test, names in study.logs.test.items()}
    sines = [[records[name][0][k]] for k, name in enumerate(study.sine)]
    for name, rows in {SINE: sines, SWEEP: records_of(study.logs.training, records)}.items():
        models = fit_models(
            laws,
            rows,
            robot=job.robot.name,
            seed=study.seed,
            options={**study.options, **{law: one.options for law, one in variants.items()}},
            variants={law: one.law for law, one in variants.items()},
            progress=partial(job.progress, f"fitting laws to the {name}"),
        )
        torques = {test: predict_models(models, tested) for test, tested in tests.items()}
        for band in study.bands:
            whole = torques[band.test].items()
            parts = {law: within(tests[band.test], of, band.start, band.stop) for law, of in whole}
            torques[band.name] = {law: part for law, (_, part) in parts.items()}
            tests[band.name] = next(iter(parts.values()))[0]
        yield name, Case(models=models, training=rows, tests=tests, torques=torques)
