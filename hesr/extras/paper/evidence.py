"""Files of the study, and evidence on its claims: logs, laws, torques and closed loops."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from cosim.loop.closed_loop import PerJoint, Scheme, StandIn, Tracking
from cosim.loop.excite import Recording, export_twin, record_motions, twin_plant
from cosim.loop.loops import StudyLoop, assemble, build, motions, require_reachable
from cosim.loop.motions import Motions
from cosim.loop.traces import Tracked
from cosim.study.scores import LogRecords, predict_models, select_records, select_window
from cosim.study.steps import Job
from cosim.study.study import Study, Twin
from fmu_src.arm.truth import true_friction
from fmu_src.friction.friction_fmu import export_bare
from hesr_model.errors import ArgumentError
from hesr_model.fitting.fit import fit_models
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.inference.comparison import law_errors
from hesr_model.logs.rest import find_resting_travel
from hesr_model.logs.signals import near_reversals
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody, identify
from hesr_model.rigid_body.residual import find_resting_speed, friction_records
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array
from hesr_model.support.progress import Stages
from hesr_model.support.typed_files import Config, RelativePath

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
    joint: str | tuple[str, ...] = ""  # the only ones, such as J2
    everywhere: bool = True  # also judged where another law is the true friction, and on logs
    at_least: Limit | None = None
    at_most: Limit | None = None


class PaperStudy(Study):
    """Study of a twin whose laws are trained on the sweep, and on a sine of one joint at a time."""

    claims: tuple[Claim, ...] = Field(min_length=1)
    sine: tuple[str, ...] = Field(min_length=1)  # log that trains each joint
    literal: str  # the paper's own law, a variant
    controllers: Mapping[str, Mapping[str, PerJoint | float]]  # changed gains by name
    measured: Mapping[str, RelativePath] = {}  # studies of measured robots by name
    twin: Twin
    tracking: Tracking

    def with_measured(self, studies: Sequence[Path]) -> "PaperStudy":
        """Return the study with further measured robots, by the names of their studies.

        Raises
        ------
        ArgumentError
            If two measured studies have the same name.
        """
        measured = dict(self.measured)
        for path in studies:
            name = Study.read(path).name
            if name in measured:
                raise ArgumentError(f"'measured' has two studies of the name '{name}'; rename one.")
            measured[name] = path
        return self.model_copy(update={"measured": measured})


TWIN = "twin"
LUGRE = "LuGre"
STRAIN_WAVE = "strain wave"
TABLE_1 = "Table I"  # these four are true frictions
MEASURED = "measured"
SINE = "sine"
SWEEP = "sweep"  # these two are training motions
_MAIN_TEST = "fourier"  # the test set of the paper's tables; of measured robots their own
Records = Sequence[Sequence[FrictionRecord]]  # [joint][log]


@dataclass(frozen=True, kw_only=True)
class Number:
    """A value and its 95 % interval, if it has one; `is_open` if the data are too few for it."""

    value: float
    low: float | None = None
    high: float | None = None
    is_open: bool = False

    @property
    def interval(self) -> tuple[float, float]:
        """Ends of the interval, both the value if it has none."""
        low = self.low
        if low is None:
            low = self.value
        high = self.high
        if high is None:
            high = self.value
        return low, high


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """Laws of one training motion and true friction, and their torques on test sets and bands."""

    models: Mapping[str, FrictionModel]
    training_records: Records
    tests: Mapping[str, Records]
    torques: Mapping[str, Mapping[str, list[list[Array]]]]  # [joint][log] by test and law

    def errors(self, law_name: str, test: str, j: int) -> list[Array]:
        """Return the errors (N,) [N.m] of a law on every log."""
        pairs = zip(self.torques[test][law_name][j], self.tests[test][j], strict=True)
        return [tau_predicted - record.tau for tau_predicted, record in pairs]

    def ratio(
        self, law_name: str, rivals: Sequence[str], test: str, j: int, *, reversals: bool
    ) -> Number:
        """Return the RMSE of a law over the lowest one of others, of all rows or at reversals."""
        joint_records = self.tests[test][j]
        errors = {name: self.errors(name, test, j) for name in (law_name, *rivals)}
        if reversals:
            errors = _select_reversals(errors, joint_records)
        comparison = law_errors(
            errors,
            [float(np.median(np.diff(record.t))) for record in joint_records],
            log_names=[record.log for record in joint_records],
        )
        log_rmse = dict(zip(comparison.laws, comparison.log_rmse, strict=True))
        best_rival = min(rivals, key=lambda rival: log_rmse[rival])
        ratio = comparison.ratios(best_rival)[law_name]
        return Number(value=ratio.value, low=ratio.low, high=ratio.high, is_open=ratio.low is None)


def _select_reversals(
    errors: Mapping[str, Sequence[Array]], joint_records: Sequence[FrictionRecord]
) -> dict[str, list[Array]]:
    """Return the errors (N,) by law on every log, zero in rows that are not near a reversal."""
    resting_speed = find_resting_speed(joint_records)
    is_near = [near_reversals(record.t, record.dq, resting_speed) for record in joint_records]
    errors_at_reversals = {}
    for law_name, joint_errors in errors.items():
        pairs = zip(is_near, joint_errors, strict=True)
        errors_at_reversals[law_name] = [mask * error for mask, error in pairs]
    return errors_at_reversals


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


def gather_evidence(study: PaperStudy, path: Path, folder: Path, progress: Stages) -> Evidence:
    """Run the twin, fit all laws and run the closed loop, with files in `folder`."""
    job = Job(study=study, path=path, progress=progress)
    log_names = study.logs
    plant, signals = twin_plant(study.twin, path, folder)
    assert signals is not None  # `Study` requires them with `tracking`
    arm = export_twin(plant, folder, signals)
    recordings = {
        recording.log.name: recording
        for recording in record_motions(Motions.read(study.twin.motions), plant, fmu=arm)
    }
    robot = Robot(job.robot)
    body = identify(
        [recordings[name].log for name in log_names.identification],
        robot,
        reversed_logs=[recordings[name].log for name in log_names.reversed],
        method="paper",
    )
    records = {
        name: [friction_records(recording.log, robot, body)]
        for name, recording in recordings.items()
    }
    cases = {TWIN: dict(_evaluate_cases(job, study, records, job.laws))}
    models = cases[TWIN][SWEEP].models
    for truth, true_model in _find_truths(job, study, records, models).items():
        true_records = _replace_truth(true_model, records, recordings)
        cases[truth] = dict(_evaluate_cases(job, study, true_records, job.laws))
    if study.measured:
        cases[MEASURED] = {
            name: _evaluate_measured(job, study, study_path)
            for name, study_path in study.measured.items()
        }
    require_reachable(study.tracking, robot)
    true_model = true_friction(
        plant.model, plant.joints, sample_time=1.0 / plant.sample_rate, losses=signals.losses
    )
    build(folder, robot, body, plant, true_model=true_model)
    fmus = {
        law_name: export_bare(models[law_name], folder / f"{law_name}.fmu")
        for law_name in study.tracking.sources
    }
    tracked = {}
    for name, gain_changes in study.controllers.items():
        gains = study.tracking.gains.model_copy(update=gain_changes)
        tracking = study.tracking.model_copy(update={"gains": gains})
        loop = assemble(
            folder, robot, tracking=tracking, friction=fmus, plant=plant, progress=progress
        )
        tracked[name] = _track_motions(loop, f"tracking, {name}")
    return Evidence(study, robot, body, recordings, records, cases, tracked)


def _track_motions(loop: StudyLoop, stage: str) -> dict[str, Tracked]:
    """Run all motions with the body, each law and, uncompensated, the velocity alone; by law."""
    scheme = Scheme(compensation="torque_error")
    law_names = (StandIn.BODY_ONLY, *loop.tracking.sources)
    rows = [loop.row(law_name, scheme) for law_name in law_names]
    rows.append(loop.row(StandIn.VELOCITY_ONLY, Scheme(compensation="none")))
    tracked_rows = loop.track(
        rows, motions(loop.tracking), loop.tracking.duration, stage, traced=True
    )
    return {row.law: row for row in tracked_rows}


def _replace_truth(
    true_model: FrictionModel, records: LogRecords, recordings: Mapping[str, Recording]
) -> LogRecords:
    """Replace the friction of the twin in records by that of another model."""
    records_by_log = {}
    for name, [joint_records] in records.items():
        true_signals = recordings[name].truth
        replaced_records = []
        for j, record in enumerate(joint_records):
            true_torque = predict(true_model.laws[j], t=record.t, dq=true_signals.dq[:, j])
            tau = record.tau - true_signals.tau_f_true[:, j] + true_torque
            replaced_records.append(replace(record, tau=tau))
        records_by_log[name] = [replaced_records]
    return records_by_log


def _find_truths(
    job: Job, study: PaperStudy, records: LogRecords, models: Mapping[str, FrictionModel]
) -> dict[str, FrictionModel]:
    """Return the laws that replace the friction of the twin, fitted to it or printed."""
    sweep_records = select_records(study.logs.training, records)
    strain_wave = fit_models(
        ["strain_wave"],
        sweep_records,
        robot=job.robot.name,
        seed=study.seed,
        progress=partial(job.progress, "fitting a true law"),
    )
    return {
        LUGRE: models["lugre"],
        STRAIN_WAVE: strain_wave["strain_wave"],
        TABLE_1: FrictionModel.read("uf850-table1"),
    }


def _evaluate_cases(
    job: Job, study: PaperStudy, log_records: LogRecords, laws: Sequence[str]
) -> Iterator[tuple[str, Case]]:
    """Yield the case of each training motion."""
    tests = {test: select_records(names, log_records) for test, names in study.logs.test.items()}
    sine_records = [[log_records[name][0][j]] for j, name in enumerate(study.sine)]
    training_records = {
        SINE: sine_records,
        SWEEP: select_records(study.logs.training, log_records),
    }
    for name, records in training_records.items():
        yield name, _fit_case(job, study, name, records, tests, laws)


def _evaluate_measured(job: Job, study: PaperStudy, study_path: Path) -> Case:
    """Return the case of a measured robot, by the split of its own study."""
    measured_study = Study.read(study_path)
    measured_job = Job(study=measured_study, path=study_path, progress=job.progress)
    robot = Robot(measured_job.robot)
    files = measured_job.log_files(study_path.parent)
    logs = {name: measured_job.read(name, file) for name, file in files.items()}
    body, _ = measured_job.rigid_body(logs, robot)
    records = {}
    for name, log in logs.items():
        records[name] = [friction_records(part, robot, body) for part in log.parts()]
    tests = {_MAIN_TEST: select_records(measured_job.tested_on, records)}
    training_records = select_moving_records(select_records(measured_study.logs.training, records))
    return _fit_case(job, study, measured_study.name, training_records, tests, job.laws)


def select_moving_records(records: Records) -> list[list[FrictionRecord]]:
    """Return records [joint][part] without parts where the joint stands still; all if in each.

    At rest friction balances the load: motions of one joint at a time say nothing of the others.
    """
    positions = []
    for part in zip(*records, strict=True):
        joint_positions = [record.q for record in part]
        positions.append(np.stack(joint_positions, axis=1))
    resting_travel = find_resting_travel(positions)
    moving_records = []
    for j, joint_records in enumerate(records):
        moving = [record for record in joint_records if np.ptp(record.q) > resting_travel[j]]
        moving_records.append(moving or list(joint_records))
    return moving_records


def _fit_case(
    job: Job,
    study: PaperStudy,
    name: str,
    records: Records,
    tests: Mapping[str, Records],
    laws: Sequence[str],
) -> Case:
    """Fit laws to records, and predict the test sets and those bands that they have."""
    tests = dict(tests)
    options = dict(study.options)
    variants = {}
    for law_name, variant in study.variants.items():
        if law_name in laws:
            options[law_name] = variant.options
            variants[law_name] = variant.law
    models = fit_models(
        laws,
        records,
        robot=job.robot.name,
        seed=study.seed,
        options=options,
        variants=variants,
        progress=partial(job.progress, f"fitting laws to the {name}"),
    )
    torques = {test: predict_models(models, test_records) for test, test_records in tests.items()}
    for band in study.bands:
        if band.test not in tests:
            continue
        test_records = tests[band.test]
        band_torques = {}
        for law_name, test_torques in torques[band.test].items():
            # The records of a band are the same for all laws.
            band_records, band_torques[law_name] = select_window(
                test_records, test_torques, band.start, band.stop
            )
        tests[band.name] = band_records
        torques[band.name] = band_torques
    return Case(models=models, training_records=records, tests=tests, torques=torques)
