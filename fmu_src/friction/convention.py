"""Errors of an FMU for one motion under different input conventions."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmu_src.friction.embedded_model import read_embedded_model
from fmu_src.friction.reference import (
    CONTINUOUS,
    SETTINGS,
    Error,
    ReferenceMotion,
    errors,
    reference_motion,
    torques,
)
from fmu_src.friction.replay import require_finite
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.reference_results import play
from fmu_src.run.variables import model_description
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import INPUTS, TORQUE
from hesr_model.friction.model import FrictionModel
from hesr_model.support.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Convention:
    """Errors of an FMU's torque by setting and joint, against its law."""

    joints: tuple[str, ...]
    sliding: tuple[bool, ...] = ()  # empty if all joints turn
    step: float  # sample time of the model [s]
    frequency: float  # of the sinusoidal velocity [Hz]
    speeds: tuple[float, ...]  # amplitudes of the velocity [rad/s]
    replay: Mapping[str, tuple[Error, ...]]  # in the direct setting, as logs are replayed
    continuous: Mapping[str, tuple[Error, ...]]  # with inputs linear between samples


def measure(fmu: Path, *, frequency: float = 0.25, periods: float = 5.0) -> Convention:
    """Run a friction FMU on sinusoids of `frequency` [Hz] in every setting, with its sample time.

    Raises ArtifactError if it or its model is damaged, SimulationError if it is refused or fails.
    """
    model = judge(fmu)
    motion = reference_motion(model, frequency=frequency, periods=periods)
    truths = {truth: torques(model, motion, truth) for truth in ("direct", CONTINUOUS)}
    torque_by_setting = {setting: run(fmu, motion, setting) for setting in SETTINGS}

    def compare_with(truth: str) -> dict[str, tuple[Error, ...]]:
        return {
            setting: errors(motion, torque, truths[truth])
            for setting, torque in torque_by_setting.items()
        }

    return Convention(
        joints=model.joints,
        sliding=model.sliding,
        step=model.sample_time,
        frequency=frequency,
        speeds=tuple(map(float, np.abs(motion.dq).max(axis=0))),
        replay=compare_with("direct"),
        continuous=compare_with(CONTINUOUS),
    )


def judge(fmu: Path) -> FrictionModel:
    """Return the model in a friction FMU; raise SimulationError unless it can be measured."""
    model = read_embedded_model(fmu)
    if model is None:
        raise SimulationError(f"{fmu}: contains no friction model to compare with.")
    try:
        variables = model_description(fmu).modelVariables
    except SimulationError:  # the static checks report the cause
        return model
    declared = {(v.name, v.causality) for v in variables}
    needed: list[tuple[str, str]] = []
    for name, kind in (*((symbol.name, "input") for symbol in INPUTS), (TORQUE, "output")):
        needed += [(f"{name}[{i}]", kind) for i in range(1, len(model.joints) + 1)]
    for name, kind in needed:
        if (name, kind) not in declared:
            raise SimulationError(
                f"{fmu}: the check 'convention' needs a friction FMU (velocity in, torque out); "
                f"this one has no {kind} '{name}'."
            )
    if model.thermal or ("adapt", "input") in declared:
        raise SimulationError(
            f"{fmu}: the check 'convention' does not support adaptive or thermal FMUs."
        )
    return model


def run(fmu: Path, motion: ReferenceMotion, setting: str) -> Array:
    """Return the torque (N, n) [N.m] of a friction FMU in one of `SETTINGS`."""
    outputs = [f"{TORQUE}[{i}]" for i in range(1, motion.dq.shape[1] + 1)]
    with FmuInstance(fmu) as instance:
        torque = play(instance, setting, outputs, motion.t, motion.columns(), {})
    require_finite(fmu, motion.t, torque)
    return torque
