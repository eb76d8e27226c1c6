"""Run of a study whose logs have no torque: law and servo of each joint, FMUs, and errors."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from cosim.servo.choice import choose_from_commands
from cosim.servo.engine import FINE_SUBSTEP, JointEngine
from cosim.servo.model import fit_from_commands
from cosim.servo.motion import export_servo_plant, run_plant
from cosim.servo.record import read_servo_records
from cosim.servo.start import delay_commands
from cosim.study.steps import Job, checkpoint_folder
from cosim.study.study import Study
from fmu_src.export.toolchain import HOST, targets
from fmu_src.friction.friction_fmu import export_fmu
from hesr_model.findings import Finding, log_findings
from hesr_model.friction.model import FrictionModel
from hesr_model.health.examine import check_logs
from hesr_model.laws.baselines import CoulombViscous
from hesr_model.logs.robot_log import Log
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, rms
from hesr_model.support.files import newest, provenance, scratch_folder
from hesr_model.support.progress import Stages, silent
from hesr_model.support.result_folder import folder_written_whole

PLANT = "Plant.fmu"
_MUCH_MORE = 1.2  # error of a joint in the whole plant over that alone


@dataclass(frozen=True, kw_only=True)
class MotionErrors:
    """Position errors (n,) [rad; m] of one log from its commands.

    `alone` is of each joint along the measured motion of the others, `ideal` that of a servo that
    follows its commands exactly. `coupled` is of the whole plant; empty without a scale.
    """

    log: str
    is_test: bool
    ideal: tuple[float, ...]
    alone: tuple[float, ...]
    coupled: tuple[float, ...] = ()

    @property
    def sentence(self) -> str:
        """The errors of all joints, in words."""
        kind = "test" if self.is_test else "training"
        return (
            f"Position error on the {kind} log {self.log}: "
            f"{_format_mrad(self.coupled or self.alone)} mrad from commands alone, "
            f"{_format_mrad(self.ideal)} of ideal servos."
        )

    @property
    def doubts(self) -> list[str]:
        """Joints, by number, that the whole robot predicts clearly worse than each joint alone."""
        pairs = list(zip(self.coupled, self.alone, strict=False))
        return [
            f"Log {self.log}: joint {number} errs {coupled / alone:.1f} times as much in the whole "
            "plant as alone: the errors of its neighbours move it."
            for number, (coupled, alone) in enumerate(pairs, start=1)
            if coupled > _MUCH_MORE * alone
        ]


@dataclass(frozen=True, kw_only=True)
class CommandOutcome:
    """Results of a study from commands: model, its FMUs by name, errors by log, and findings."""

    model: FrictionModel
    fmus: Mapping[str, Path]
    errors: Sequence[MotionErrors]
    findings: Sequence[Finding]


def has_scale(model: FrictionModel) -> bool:
    """Return whether the size of the torques of all joints is known."""
    return all(servo.scale != "none" for servo in model.servos)


def lacks_torque(path: Path) -> bool:
    """Return whether the first training log of a study has no torque, and no twin makes it."""
    study = Study.read(path)
    if study.twin is not None:
        return False
    job = _make_job(study, path, silent)
    name = study.logs.training[0]
    [file] = [file for log, file in job.log_files(path.parent).items() if log == name]
    return not job.read(name, file).has_torque


def _make_job(study: Study, path: Path, progress: Stages, platforms: Sequence[str] = HOST) -> Job:
    return Job(
        study=study,
        path=path,
        progress=progress,
        checkpoints=checkpoint_folder(path),
        platforms=tuple(target.folder for target in targets((*HOST, *platforms))),
    )


def run_from_commands(
    path: Path,
    output: Path,
    *,
    platforms: Sequence[str] = HOST,
    quick: bool = False,
    accepted: Sequence[str] = (),
    write_report: Callable[[CommandOutcome, Path], None],
    progress: Stages = silent,
) -> CommandOutcome:
    """Fit laws and servos of a study's logs, and write model, FMUs and report into a folder.

    Parameters
    ----------
    path : study.
    output : folder of the results, written whole or not at all.
    platforms : of the FMUs, with that of this machine.
    quick : whether Coulomb and viscous friction is the only law.
    accepted : names of checks whose errors only warn.
    write_report : writes the report of an outcome into the folder.
    progress : called with stage, steps done and steps in total.
    """
    study = Study.read(path)
    job = _make_job(study, path, progress, platforms)
    robot = Robot(job.robot)
    files = job.log_files(path.parent)
    logs = {name: job.read(name, file) for name, file in files.items()}
    findings = log_findings(check_logs(list(logs.values()), robot, accepted))
    training = [logs[name] for name in study.logs.training]
    source = provenance(files=[*files.values(), study.robot], seed=study.seed)
    source["created"] = newest(list(files.values()))
    if quick:
        model = fit_from_commands(
            training,
            robot,
            CoulombViscous.name,
            provenance=source,
            progress=partial(progress, "fitting servos to commands"),
        )
    else:
        model = choose_from_commands(
            training,
            robot,
            study.laws,
            provenance=source,
            progress=partial(progress, "judging laws by motion from commands"),
        )
    are_tests = [name not in study.logs.training for name in logs]
    errors = compute_motion_errors(model, robot, list(logs.values()), are_tests)
    outcome = CommandOutcome(model=model, fmus={}, errors=errors, findings=findings)
    with folder_written_whole(output) as folder:
        (folder / "laws").mkdir()
        model.write(folder / "laws" / f"{model.law}.json")
        names = _write_fmus(outcome, robot, folder / "fmus", job.platforms, progress)
        outcome = CommandOutcome(
            model=model,
            fmus={name: output / "fmus" / name for name in names},
            errors=errors,
            findings=findings,
        )
        write_report(outcome, folder)
    return outcome


def _write_fmus(
    outcome: CommandOutcome,
    robot: Robot,
    folder: Path,
    platforms: Sequence[str],
    progress: Stages,
) -> list[str]:
    """Write the FMUs of friction and of the plant with its servos; none without a scale."""
    if not has_scale(outcome.model):
        return []
    model = outcome.model
    folder.mkdir()
    name = f"{model.law}.fmu"
    export_fmu(model, folder / name, platforms=platforms, progress=partial(progress, name))
    export_servo_plant(
        model,
        robot,
        folder / PLANT,
        platforms=platforms,
        progress=partial(progress, PLANT),
    )
    return [name, PLANT]


def compute_motion_errors(
    model: FrictionModel, robot: Robot, logs: Sequence[Log], are_tests: Sequence[bool]
) -> list[MotionErrors]:
    """Return the errors of the positions that the commands of each log cause.

    The plants of all joints, and of the whole robot if its torques have a scale, are made once.
    """
    with ExitStack() as cleanup:
        engines = [
            cleanup.enter_context(JointEngine(law, sliding=is_sliding))
            for law, is_sliding in zip(model.laws, robot.slides, strict=True)
        ]
        plant = None
        if has_scale(model):
            folder = cleanup.enter_context(scratch_folder())
            plant = export_servo_plant(model, robot, folder / PLANT, bare=True)
        return [
            _compute_errors_of_log(model, robot, log, engines, plant, is_test=is_test)
            for log, is_test in zip(logs, are_tests, strict=True)
        ]


def _compute_errors_of_log(
    model: FrictionModel,
    robot: Robot,
    log: Log,
    engines: Sequence[JointEngine],
    plant: Path | None,
    *,
    is_test: bool,
) -> MotionErrors:
    """Return the errors of one log by the plants of its joints, and by that of the robot."""
    ideal = []
    alone = []
    for j, records in enumerate(read_servo_records([log], robot, robot.nominal_parameters)):
        servo = model.servos[j].servo
        values = model.laws[j].values
        runs = [engines[j].run(record, servo, values, substep=FINE_SUBSTEP) for record in records]
        pairs = zip(runs, records, strict=True)
        alone.append(_join_rms([run - record.q for run, record in pairs]))
        ideal.append(
            _join_rms([delay_commands(record, servo.latency) - record.q for record in records])
        )
    coupled: tuple[float, ...] = ()
    if plant is not None:
        differences = np.concatenate([run_plant(plant, part) - part.q for part in log.parts()])
        coupled = tuple(map(float, rms(differences)))
    return MotionErrors(
        log=log.name, is_test=is_test, ideal=tuple(ideal), alone=tuple(alone), coupled=coupled
    )


def _format_mrad(values: Sequence[float]) -> str:
    return ", ".join(f"{1e3 * value:.3g}" for value in values)


def _join_rms(errors: Sequence[Array]) -> float:
    return float(rms(np.concatenate(errors)))
