"""All experiments on models and FMUs."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from math import isfinite
from pathlib import Path

import numpy as np

from fmu_src.friction.friction_fmu import export_bare
from fmu_src.friction.reference import UNKNOWN_SPEED
from fmu_src.run.fmu import FmuInstance
from hesr.extras.drive.drive_fmu import export_drive
from hesr.extras.properties.bench import DriveBench, FrictionBench
from hesr.extras.properties.break_away import breakaway, dissipation, dither, hold, stick_slip
from hesr.extras.properties.presliding import memory, presliding
from hesr.extras.properties.scale import INERTIA, Scale, compute_standing_inertia, measure_scale
from hesr.extras.properties.sliding import chatter, coupling, lag, start, work
from hesr_model.audit.audit import choose_loads
from hesr_model.audit.properties import (
    EXPECTATIONS,
    JointProperties,
    Properties,
    PropertyResult,
    Subject,
    read_properties,
    write_properties,
)
from hesr_model.errors import ArtifactError, ConfigError, SimulationError
from hesr_model.friction.inputs import TAU_LOAD
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support import parallel
from hesr_model.support.arrays import Array
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Progress, report_progress, silent

_SAMPLE_TIME = 5e-3  # [s] default
_DRIVE_EXPERIMENTS = (breakaway, stick_slip, dither, hold)
_DRIVE_KEY = "drive"  # needs more than the scale
_NO_INERTIA = "Not run: the inertia of the joints is unknown; give 'inertia'."
_NO_MODEL = "Not run: the FMU contains no law, which a JointDrive needs."


def run_battery(
    subjects: Sequence[Subject],
    *,
    load: float = 0.0,
    body: tuple[Robot, RigidBody] | None = None,
    workers: int | None = None,
    progress: Progress = silent,
    checkpoints: Path | None = None,
) -> list[Properties]:
    """Examine models or FMUs in parallel under a constant load [N.m] of every joint.

    The inertia of models is that of a given body. `checkpoints` is a folder of finished results.
    Raises ConfigError if an inertia is not valid.
    """
    if body is not None:
        subjects = [_set_standing_inertia(subject, *body) for subject in subjects]
    for subject in subjects:
        _require_inertia(subject)
    jobs = [
        partial(_measure_or_read, subject, load=load, checkpoints=checkpoints)
        for subject in subjects
    ]
    costs = [subject.model.size if subject.model else 0 for subject in subjects]
    names = [subject.name for subject in subjects]
    with parallel.results_of(jobs, workers, costs, names) as results:
        return [next(results) for _ in report_progress(jobs, progress)]


def _set_standing_inertia(subject: Subject, robot: Robot, body: RigidBody) -> Subject:
    """Give a model the inertia of a body; return an FMU of unknown laws as it is."""
    if subject.model is None:
        return subject
    return replace(subject, inertia=compute_standing_inertia(robot, body, subject.model))


def _measure_or_read(subject: Subject, *, load: float, checkpoints: Path | None) -> Properties:
    if checkpoints is None or subject.model is None or subject.fmu is not None:
        return measure(subject, load=load)
    hashed_inputs = [subject.model.to_json(), subject.inertia, load, version("hesr")]
    hashed_text = json.dumps(hashed_inputs, sort_keys=True, default=str)
    key = hashlib.sha256(hashed_text.encode()).hexdigest()[:24]
    path = checkpoints / f"{key}.json"
    with suppress(ArtifactError):  # missing or incomplete
        return read_properties(path)[subject.name]
    properties = measure(subject, load=load)
    write_properties(path, {subject.name: properties})
    return properties


def measure(subject: Subject, *, load: float = 0.0) -> Properties:
    """Examine one model or FMU; see `run_battery`.

    Coupled joints move one friction coordinate at a time; thermal laws stay at their fit.
    """
    model = subject.model and replace(subject.model, coupling=None, thermal=())
    with scratch_folder() as folder:
        fmu = _provide_fmu(subject, model, folder)
        with FmuInstance(fmu) as instance:
            bench = FrictionBench(instance)
            inertia = _require_inertia(subject, bench.joints)
            trained_ranges = _find_ranges(model, bench.joints)
            bench.positions = np.array([trained_range.middle for trained_range in trained_ranges])
            speed = np.array([trained_range.speed for trained_range in trained_ranges])
            scale = None
            try:
                scale = measure_scale(bench, speed, load)
                results_by_key = _run_motion_experiments(
                    bench, scale, model, trained_ranges, inertia
                )
            except SimulationError as error:
                # Without steady sliding every property fails.
                failures = [_fail_property(error)] * bench.joints
                results_by_key = dict.fromkeys(EXPECTATIONS, failures)
        if scale is not None and model is not None and inertia is not None:
            # Prismatic joints obey the same equations, with a mass as inertia.
            rotary_model = replace(model, sliding=())
            drive_fmu = export_drive(
                rotary_model, folder / "drive.fmu", inertia=inertia.tolist(), bare=True
            )
            with FmuInstance(drive_fmu) as instance:
                drive_bench = DriveBench(instance, bench.positions)
                results_by_key |= _run_drive_experiments(
                    drive_bench, scale, rotary_model, trained_ranges
                )

    law_name = subject.name
    robot_name = ""
    joint_names = tuple(f"joint {number}" for number in range(1, bench.joints + 1))
    is_prismatic = (False,) * bench.joints
    if model is not None:
        law_name = model.law
        robot_name = model.robot
        joint_names = model.joints
        is_prismatic = model.slides
    levels = np.zeros(bench.joints)
    deflections = np.zeros(bench.joints)
    if scale is not None:
        levels = scale.level
        deflections = scale.deflection
    joints = [
        JointProperties(
            joint=joint_name,
            speed=float(speed[j]),
            level=float(levels[j]),
            deflection=float(deflections[j]),
            inertia=None if inertia is None else float(inertia[j]),
            findings=_select_results(results_by_key, j, is_prismatic=is_prismatic[j]),
        )
        for j, joint_name in enumerate(joint_names)
    ]
    return Properties(law=law_name, robot=robot_name, tau_load=load, joints=tuple(joints))


def _provide_fmu(subject: Subject, model: FrictionModel | None, folder: Path) -> Path:
    """Return the FMU of a subject, or export one of its model to a folder."""
    if subject.fmu is not None:
        return subject.fmu
    if model is None:
        raise ConfigError(f"{subject.name}: model and FMU are both missing.")
    return export_bare(model, folder / "friction.fmu")


def _select_results(
    results_by_key: Mapping[str, Sequence[PropertyResult]], j: int, *, is_prismatic: bool
) -> dict[str, PropertyResult]:
    """Return the results of joint j in its units, without infinite figures."""
    findings = {}
    for key in EXPECTATIONS:
        property_result = _drop_infinite_figures(results_by_key[key][j])
        findings[key] = property_result.to_joint_units(is_prismatic=is_prismatic)
    return findings


def _run_motion_experiments(
    bench: FrictionBench,
    scale: Scale,
    model: FrictionModel | None,
    trained_ranges: list[TrainedRange],
    inertia: Array | None,
) -> dict[str, list[PropertyResult]]:
    """Run the experiments of prescribed motion; give a reason for those of a drive."""
    joint_count = bench.joints
    state_counts: list[int | None] = [None] * joint_count  # unknown
    loads: list[tuple[float, ...]] = [(scale.load,)] * joint_count
    if model is not None:
        state_counts = [len(law.form.memory) for law in model.laws]
        loads = [
            choose_loads(law, trained_range)
            for law, trained_range in zip(model.laws, trained_ranges, strict=True)
        ]
    peak_loads = _find_peak_loads(trained_ranges, scale)
    experiments: dict[str, Callable[[], list[PropertyResult]]] = {
        "presliding": partial(presliding, bench, scale),
        "memory": partial(memory, bench, scale, state_counts),
        "nested": partial(memory, bench, scale, state_counts, peak_loads),
        "start": partial(start, bench, scale),
        "lag": partial(lag, bench, scale),
        "chatter": partial(chatter, bench, scale, trained_ranges),
        "work": partial(work, bench, trained_ranges, loads),
    }
    driven_names = (experiment.__name__ for experiment in _DRIVE_EXPERIMENTS)
    # Drive experiments that can run replace these results afterwards.
    reason = _NO_MODEL if model is None else _NO_INERTIA
    reasons = dict.fromkeys((*driven_names, _DRIVE_KEY), reason)
    if inertia is None:
        reasons["coupling"] = _NO_INERTIA
    else:
        experiments["coupling"] = partial(coupling, bench, scale, inertia)
    skipped_results = {
        key: [PropertyResult(verdict="not run", reason=reason)] * joint_count
        for key, reason in reasons.items()
    }
    return skipped_results | {
        key: _run_experiment(experiment, joint_count) for key, experiment in experiments.items()
    }


def _run_drive_experiments(
    bench: DriveBench, scale: Scale, model: FrictionModel, trained_ranges: list[TrainedRange]
) -> dict[str, list[PropertyResult]]:
    """Run the experiments that drive the joints by a torque."""
    peak_loads = _find_peak_loads(trained_ranges, scale)
    is_loaded = np.array([TAU_LOAD in law.form.inputs for law in model.laws])
    experiments: dict[str, Callable[[], list[PropertyResult]]] = {
        experiment.__name__: partial(experiment, bench, scale) for experiment in _DRIVE_EXPERIMENTS
    }
    experiments[_DRIVE_KEY] = partial(dissipation, bench, scale, peak_loads, is_loaded)
    return {
        key: _run_experiment(experiment, bench.joints) for key, experiment in experiments.items()
    }


def _find_peak_loads(trained_ranges: list[TrainedRange], scale: Scale) -> Array:
    """Return the largest trained load (n,) [N.m], or load plus friction level."""
    trained_loads = np.array(
        [max(trained_range.tau_load, key=abs) for trained_range in trained_ranges]
    )
    return np.where(trained_loads != 0.0, trained_loads, scale.load + scale.level)


def _run_experiment(
    experiment: Callable[[], list[PropertyResult]], joint_count: int
) -> list[PropertyResult]:
    try:
        return experiment()
    except SimulationError as error:
        return [_fail_property(error)] * joint_count


def _fail_property(error: SimulationError) -> PropertyResult:
    return PropertyResult(verdict="fail", reason=f"The FMU gives up: {error}")


def _drop_infinite_figures(property_result: PropertyResult) -> PropertyResult:
    figures = []
    for figure in property_result.figures:
        if figure.value is None or isfinite(figure.value):
            figures.append(figure)
        else:
            figures.append(replace(figure, value=None))
    return replace(property_result, figures=tuple(figures))


def _find_ranges(model: FrictionModel | None, joints: int) -> list[TrainedRange]:
    """Return the trained ranges of a model, or substitutes, with its sample time."""
    sample_time = _SAMPLE_TIME if model is None else model.sample_time
    if model is not None and model.trained:
        return [replace(known_range, sample_time=sample_time) for known_range in model.trained]
    zero_range = (0.0, 0.0)
    dq = (-UNKNOWN_SPEED, UNKNOWN_SPEED)
    trained_range = TrainedRange(
        sample_time=sample_time, dq=dq, q=zero_range, tau_load=zero_range, tau=zero_range
    )
    return [trained_range] * joints


def _require_inertia(subject: Subject, joints: int | None = None) -> Array | None:
    """Return the inertia of the joints [kg.m2]; None if unknown."""
    model = subject.model
    inertia = subject.inertia
    if inertia is None and model is not None:
        inertia = INERTIA.get(model.robot)
    if inertia is None:
        return None
    joint_count = joints if model is None else len(model.laws)
    if joint_count is not None and len(inertia) not in (1, joint_count):
        raise ConfigError(
            f"{subject.name}: {len(inertia)} inertias; expected one, or one for each of the "
            f"{joint_count} joints."
        )
    for number, value in enumerate(inertia, start=1):
        if not (isfinite(value) and value > 0.0):
            raise ConfigError(
                f"{subject.name}: the inertia of joint {number} is {value:g} kg.m2; expected a "
                "positive number."
            )
    return np.broadcast_to(np.array(inertia), (joint_count or len(inertia),)).copy()
