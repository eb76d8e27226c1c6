"""Replay of a log by a friction FMU."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import DQ, TAU_LOAD, TORQUE, Q
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
    names = {variable.name for variable in instance.description.modelVariables}
    joint_count = sum(name.startswith("tau[") for name in names)
    columns = {DQ.name: dq, Q.name: q, TAU_LOAD.name: tau_load}
    is_thermal = f"{TEMPERATURE.name}[1]" in names
    if is_thermal and temperature is None:
        without_thermometer = {f"joint[{i}].{THERMOMETER}": 0.0 for i in range(1, joint_count + 1)}
        start = without_thermometer | dict(start or {})
    elif is_thermal:
        columns[TEMPERATURE.name] = temperature
    shape = (len(time), joint_count)
    rows = np.hstack(
        [_column_of_log(instance.fmu, name, values, shape) for name, values in columns.items()]
    )
    _require_increase(instance.fmu, time)
    input_names = _name_elements(columns, joint_count)
    output_names = _name_elements([output], joint_count)
    torque = _run_rows(instance, input_names, output_names, time, rows, start)
    require_finite(instance.fmu, time, torque)
    return torque


def _name_elements(vectors: Iterable[str], joint_count: int) -> list[str]:
    """Return the names of the elements of vectors over all joints."""
    names: list[str] = []
    for vector in vectors:
        names += [f"{vector}[{i}]" for i in range(1, joint_count + 1)]
    return names


def _run_rows(
    instance: FmuInstance,
    input_names: list[str],
    output_names: list[str],
    time: Array,
    rows: Array,
    start: Mapping[str, float] | None,
) -> Array:
    """Return outputs (N, outputs) of an FMU that steps to each time (N,) [s] under its row."""
    inputs = instance.buffer(input_names)
    outputs = instance.buffer(output_names)
    results = np.empty((len(time), len(output_names)))
    if instance.used:
        instance.reset()
    inputs.values[:] = rows[0]
    instance.initialise(time=float(time[0]), start=start, inputs=inputs)
    results[0] = outputs.read()
    results[1:] = step_rows(instance, inputs, outputs, time[:-1], np.diff(time), rows[1:])
    return results


def _column_of_log(fmu: Path, name: str, values: ArrayLike | None, shape: tuple[int, int]) -> Array:
    """Return an input (N, n) of the FMU, zero by default; refuse another shape."""
    if values is None:
        return np.zeros(shape)
    column = np.asarray(values, dtype=float)
    if column.shape != shape:
        count, joints = shape
        raise SimulationError(
            f"{fmu}: '{name}' has the shape {column.shape}; expected {shape}, "
            f"{count} samples of {joints} joints."
        )
    return column


def _require_increase(fmu: Path, time: Array) -> None:
    """Raise SimulationError unless time (N,) [s] increases."""
    is_not_later = np.diff(time) <= 0.0
    if np.any(is_not_later):
        row = int(np.argmax(is_not_later)) + 1
        raise SimulationError(f"{fmu}: time does not increase at row {row} of the log.")


def require_finite(fmu: Path, t: Array, torque: Array) -> None:
    """Raise SimulationError if a torque (N, n) at the times t (N,) [s] is not finite."""
    finite = np.isfinite(torque)
    if not finite.all():
        row, joint = np.argwhere(~finite)[0]
        raise SimulationError(
            f"{fmu}: at t = {t[row]:.9g} s tau[{joint + 1}] is not a finite number."
        )
