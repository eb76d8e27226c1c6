"""Replay of a log by a friction FMU."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import through
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import INPUTS, TORQUE
from hesr_model.friction.thermal import TEMPERATURE, THERMOMETER
from hesr_model.support.arrays import Array


def replay(
    fmu: Path | FmuInstance,
    t: ArrayLike,
    dq: ArrayLike,
    q: ArrayLike | None = None,
    tau_load: ArrayLike | None = None,
    start: Mapping[str, float] | None = None,
    *,
    temperature: ArrayLike | None = None,
    output: str = TORQUE,
) -> Array:
    """Return the friction torque (N, n) [N.m] of an FMU, or another `output`, over a log.

    Each sample is set, the FMU steps from the previous time [s] to its own, and the output is read.
    `q` [rad] and `tau_load` [N.m] are zero by default; without `temperature` [degC], friction heats
    a thermal FMU. Raises SimulationError if the log does not fit or the FMU fails.
    """
    if isinstance(fmu, Path):
        with FmuInstance(fmu) as instance:
            return replay(
                instance, t, dq, q, tau_load, start, temperature=temperature, output=output
            )
    instance = fmu
    time = np.asarray(t, dtype=float)
    if not len(time):
        raise SimulationError(f"{instance.fmu}: the log to be replayed has no samples.")
    names = {v.name for v in instance.description.modelVariables}
    joints = sum(name.startswith("tau[") for name in names)
    zero = np.zeros((len(time), joints))
    indices = range(1, joints + 1)
    given = dict(zip([symbol.name for symbol in INPUTS], (dq, q, tau_load), strict=True))
    if f"{TEMPERATURE.name}[1]" in names:
        if temperature is None:
            start = {f"joint[{i}].{THERMOMETER}": 0.0 for i in indices} | dict(start or {})
        else:
            given[TEMPERATURE.name] = temperature
    parts = [zero if part is None else np.asarray(part, dtype=float) for part in given.values()]
    for name, part in zip(given, parts, strict=True):
        if part.shape != zero.shape:
            raise SimulationError(
                f"{instance.fmu}: '{name}' has the shape {part.shape}; expected {zero.shape}, "
                f"{len(time)} samples of {joints} joints."
            )
    if np.any(np.diff(time) <= 0.0):
        row = int(np.argmax(np.diff(time) <= 0.0)) + 1
        raise SimulationError(f"{instance.fmu}: time does not increase at row {row} of the log.")
    inputs = instance.buffer([f"{name}[{i}]" for name in given for i in indices])
    outputs = instance.buffer([f"{output}[{i}]" for i in indices])
    rows = np.hstack(parts)
    torque = np.empty_like(zero)
    if instance.used:
        instance.reset()
    inputs.values[:] = rows[0]
    instance.initialise(time=float(time[0]), start=start, inputs=inputs)
    torque[0] = outputs.read()
    torque[1:] = through(instance, inputs, outputs, time[:-1], np.diff(time), rows[1:])
    require_finite(instance.fmu, time, torque)
    return torque


def require_finite(fmu: Path, t: Array, torque: Array) -> None:
    """Raise SimulationError if a torque (N, n) at the times t (N,) [s] is not finite."""
    finite = np.isfinite(torque)
    if not finite.all():
        row, joint = np.argwhere(~finite)[0]
        raise SimulationError(
            f"{fmu}: at t = {t[row]:.9g} s tau[{joint + 1}] is not a finite number."
        )
