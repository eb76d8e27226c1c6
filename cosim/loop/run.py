"""Closed-loop part of a study, also on the generated plant, and comparison of the masters."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cosim.loop.closed_loop import ARM, Gains, Tracking
from cosim.loop.loops import (
    StudyLoop,
    assemble,
    build,
    build_example,
    require_reachable,
    run_tracking,
)
from cosim.loop.traces import TRACES, LoopOutcome, write_traces
from cosim.systems.simulation import Master
from cosim.systems.system import ComponentSpec, SystemSpec, write_system
from fmu_src.arm.plant import Plant
from fmu_src.arm.python_arm.export import export_python_arm
from fmu_src.arm.table import SignalTable
from fmu_src.arm.truth import true_friction
from fmu_src.export.toolchain import HOST
from fmu_src.plant.plant_fmu import PlantBody, export_plant
from hesr_model.errors import ConfigError, ExportError
from hesr_model.findings import Finding, caution
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support import plugins
from hesr_model.support.files import scratch_folder
from hesr_model.support.progress import Stages

if TYPE_CHECKING:
    from cosim.study.results import ScoredRun

_RUN_DURATION = 2.0  # [s] length of the runs that compare the masters
_MAX_DIFFERENCE = 1e-9  # allowed difference, relative to the largest value
_DERIVATIVE_RATIO = 5e-4  # [s] Kd / Kp there for joints without Kd
PLANT = "Plant.fmu"

# Signals of the plant by those of the twin's arm.
_SIGNALS = {"arm.q_true": "arm.q", "arm.tau_meas": "arm.tau_motor"}


def replace_arm(system: SystemSpec, plant: Path, gains: Gains) -> SystemSpec:
    """Return a loop with the generated plant instead of the arm."""

    def replace_component(component: ComponentSpec) -> ComponentSpec:
        if component.name != "arm":
            return component
        start = {"q_start": component.start["q0"], "latency": gains.latency, "tau": 0.0}
        return component.model_copy(update={"fmu": plant, "start": start})

    def rename_signal(signal: str) -> str:
        return _SIGNALS.get(signal, signal)

    return system.model_copy(
        update={
            "components": tuple(map(replace_component, system.components)),
            "connections": {
                target: rename_signal(source) for target, source in system.connections.items()
            },
            "observe": tuple(map(rename_signal, system.observe)),
            "limits": {rename_signal(signal): bounds for signal, bounds in system.limits.items()},
        }
    )


def run_loop(
    run: "ScoredRun",
    tracking: Tracking,
    plant: Plant,
    signals: SignalTable,
    folder: Path,
    checkpoints: Path | None,
    progress: Stages,
    *,
    quick: bool,
    platforms: Sequence[str] = HOST,
) -> LoopOutcome:
    """Build the FMUs of a loop in ``folder/fmus``, next to Arm.fmu, and run it.

    Writes one loop with the arm and one with the generated plant, and the positions along the first
    motion as `TRACES`. A `quick` run has few rows, see `run_tracking`, and no robustness.
    """
    robot = run.robot
    body = run.rigid_body
    require_reachable(tracking, robot)
    progress("building the loop", 0, 1)
    fmus = folder / "fmus"
    true_model = true_friction(
        plant.model, plant.joints, sample_time=1.0 / plant.sample_rate, losses=signals.losses
    )
    build(fmus, robot, body, plant, true_model=true_model, platforms=platforms)
    loop = assemble(
        fmus,
        robot,
        tracking=tracking,
        friction=run.fmus,
        plant=plant,
        checkpoints=checkpoints,
        progress=progress,
    )
    findings = write_loops(loop, robot, body, run.models, folder, platforms=platforms)
    progress("building the loop", 1, 1)
    tracked, long_tracked = run_tracking(loop, quick=quick)
    traced_runs = [(row.scheme, row.law, row.trace) for row in tracked if row.trace]
    write_traces(folder / TRACES, traced_runs)
    sweeps = []
    overcompensation = []
    if not quick:
        robustness = plugins.load("hesr.studies").get("robustness")
        if robustness:
            sweeps, overcompensation = robustness.load()(loop, robot, body, fmus, tracked)
        findings += check_masters(loop, plant, signals)
    return LoopOutcome(
        tracking=tracked,
        long=long_tracked,
        sweeps=sweeps,
        overcompensation=overcompensation,
        findings=findings,
    )


def write_loops(
    loop: StudyLoop,
    robot: Robot,
    body: RigidBody,
    models: Mapping[str, FrictionModel],
    folder: Path,
    *,
    platforms: Sequence[str] = HOST,
) -> list[Finding]:
    """Write the loops; return a finding if no plant can be built."""
    system = build_example(loop)
    gains = loop.tracking.gains
    write_system(system, folder / "closed_loop.toml")
    try:
        fitted_models = list(models.values())
        model = next(
            (
                candidate_model
                for candidate_model in fitted_models
                if candidate_model.laws[0].form.memory
            ),
            fitted_models[0],
        )
        plant = export_plant(
            model,
            folder / "fmus" / PLANT,
            plant_body=PlantBody.from_robot(robot, body),
            kv=gains.Kv,
            ki=gains.Ki,
            platforms=platforms,
        )
    except ExportError as error:
        reason = str(error).rstrip(".")
        observation = f"the loop was not written with a generated plant ({reason})"
        remedy = 'set body = "physical" in the study'
        return [Finding(check="plant", severity="advice", found=observation, remedy=remedy)]
    write_system(replace_arm(system, plant, gains), folder / "plant_loop.toml")
    return []


def check_masters(loop: StudyLoop, plant: Plant, signals: SignalTable) -> list[Finding]:
    """Step one loop in the Python and the native master; return a finding if they disagree."""
    gains = loop.tracking.gains
    Kd = tuple(kd or _DERIVATIVE_RATIO * kp for kp, kd in zip(gains.Kp, gains.Kd, strict=True))
    changed_tracking = loop.tracking.model_copy(
        update={"gains": gains.model_copy(update={"Kd": Kd})}
    )
    loop = replace(loop, tracking=changed_tracking)
    runs = []
    with scratch_folder() as folder:
        try:
            python_arm = export_python_arm(plant.model, signals, folder / ARM)
        except ConfigError as error:
            observation = "the Python and the native master were not compared"
            remedy = str(error).rstrip(".")
            return [Finding(check="masters", severity="advice", found=observation, remedy=remedy)]
        # The arm is a PythonFMU under a PD controller, in the third run a native FMU.
        for arm, native in ((python_arm, False), (python_arm, True), (loop.fmus.arm, True)):
            arm_loop = replace(loop, fmus=replace(loop.fmus, arm=arm))
            system = build_example(arm_loop, compensation="torque_error", duration=_RUN_DURATION)
            with Master(system, native=native) as master:
                runs.append(master.run().signals)
    largest_difference = max(_measure_difference(run, runs[0]) for run in runs[1:])
    if largest_difference <= _MAX_DIFFERENCE:
        return []
    return [
        caution(
            check="masters",
            found=f"the Python and the native master differ by {largest_difference:.1e} of a "
            f"signal's largest value, more than rounding ({_MAX_DIFFERENCE:g})",
            remedy="report this as a bug, with closed_loop.toml and fmus/",
        )
    ]


def _measure_difference(run: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> float:
    """Return the largest relative difference of a signal; infinite for runs of other lengths."""
    differences = []
    for name, values in run.items():
        other_values = other[name]
        if len(values) != len(other_values):
            return np.inf
        # A signal that stays below 1e-3 has no size to compare with.
        size = np.abs(other_values).max(initial=1e-3)
        differences.append(float(np.abs(values - other_values).max(initial=0.0) / size))
    return max(differences)
