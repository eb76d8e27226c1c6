"""Reference motion for importers, its torque by input convention, and the results in an FMU.

The step from row k to row k + 1 uses the constant inputs of row k (hold, as most masters do), also
their slopes (linear), or the inputs of row k + 1 (direct, as in the replay of a log). The torque is
read after the step. `fmu_src.friction.convention` runs the FMU.

The files follow the FMI cross-check: NAME_in.csv, NAME_ref.csv and NAME_ref.opt; a manifest of
FMI-LS-REF lists them. They are computed by the laws in Python.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmu_src.run.reference_results import RUNS, ExperimentFiles, experiment_files, manifest_files
from hesr_model.errors import SimulationError
from hesr_model.friction.inputs import INPUTS
from hesr_model.friction.law import FrictionLaw
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import predict
from hesr_model.friction.records import rmse
from hesr_model.friction.trained_range import TrainedRange
from hesr_model.logs.rest import find_resting_speeds
from hesr_model.logs.signals import near_reversals
from hesr_model.robots.transmission import Coupling
from hesr_model.support.arrays import Array
from hesr_model.units import unit_of_joint

SETTINGS: Mapping[str, str] = {
    "hold": "inputs of the step's beginning, held",
    "linear": "the same with their slopes",
    "direct": "inputs of the step's end",
}
"""Input conventions, the most common one first."""

SHOWN = "shown"
"""As "hold", with the torque read after setting the inputs of the next step, as some tools do."""

CONTINUOUS = "continuous"
"""Not a convention of masters: fine integration of the law with linear inputs between the rows."""

UNKNOWN_SPEED = 1.2  # velocity amplitude [rad/s] if the trained range is unknown: that of Table I

_ROWS = 100
_PHASE = 0.35
_DECIMALS = {"dq": 5, "q": 5, "tau_load": 3}
_MAX_HALVINGS = 12
_SUBSTEPS = 200
_ROUNDING_TOLERANCE = 1e-12
_INTEGRATION_TOLERANCE = 1e-6
"""RelTol of the files: round-off for co-simulation, integration error for model exchange."""

_README = """\
Reference results, in the file style of the FMI cross-check; the manifest of FMI-LS-REF in
org.fmi-standard.fmi-ls-ref/ names them by their roles. They are computed from the law in
Python, not by this FMU. Units are SI: {units}.

co_simulation/{name}_in.csv, _ref.csv, _ref.opt
    Start with the inputs of row 0 set before the end of the initialisation; row 0 of the reference
    is read after it. Then for each row k: set its inputs, step by {step} s, and compare with row
    k + 1 of the reference. Nothing is interpolated: inputs hold over the step. An importer that
    does so agrees up to rounding (RelTol {same:g}, of the largest torque of a joint).

co_simulation/{name}_shown.csv
    The same run as tools show it that read outputs once the inputs of the next step are set, or
    refresh them then: row k holds the torque after step k with the inputs of row k.

model_exchange/{name}_in.csv, _ref.csv, _ref.opt
    Inputs are linear between the rows. The reference is the law integrated over {substeps} substeps
    between two rows, each exact for inputs held at its middle. RelTol {close:g} (of the largest
    torque of a joint) is the accuracy of the reference; StepSize 0 requests a solver with step
    size control. The motion is under way at the start, so no row lies on a reversal. Importers
    that hold inputs while their solver steps, as CVode of FMPy 0.3.32 does, exceed it by far.
"""
_MISSING_TEXT = """\
Reference results are missing: the torque of this law is not finite on the reference motion.
"""


def joint_columns(name: str, rows: Array) -> dict[str, Array]:
    """Return the columns of an array (N, n) by the names of its variables in an FMU."""
    return {f"{name}[{i}]": column for i, column in enumerate(rows.T, start=1)}


@dataclass(frozen=True, kw_only=True)
class ReferenceMotion:
    """Inputs of all joints: time (N,) [s]; velocity, position and load (N, n) [rad/s, rad, N.m]."""

    t: Array
    dq: Array
    q: Array
    tau_load: Array

    def iterate_joints(self) -> Iterator[tuple[Array, Array, Array]]:
        """Yield (dq, q, tau_load) of each joint, each (N,) [rad/s, rad, N.m]."""
        return zip(self.dq.T, self.q.T, self.tau_load.T, strict=True)

    def columns(self) -> dict[str, Array]:
        """Return the inputs (N,) of a friction FMU by name."""
        columns: dict[str, Array] = {}
        for symbol in INPUTS:
            columns |= joint_columns(symbol.name, getattr(self, symbol.name))
        return columns

    def to_friction(self, coupling: Coupling | None) -> "ReferenceMotion":
        """Return the motion of the friction coordinates."""
        if coupling is None:
            return self
        return ReferenceMotion(
            t=self.t,
            dq=coupling.motion(self.dq),
            q=coupling.motion(self.q),
            tau_load=coupling.torque(self.tau_load),
        )


@dataclass(frozen=True, kw_only=True)
class Error:
    """Torque error of one joint [N.m], over all rows and within `REVERSAL_WINDOW` of reversals."""

    rmse: float
    rmse_reversal: float | None


def torques(
    model: FrictionModel, motion: "ReferenceMotion", setting: str, *, substeps: int = 20
) -> Array:
    """Return the (N, n) torque [N.m] of a model's laws, perhaps not finite, for a convention above.

    `substeps` divide the rows for `CONTINUOUS`. Raises SimulationError if the laws' discretisation
    is unstable at the steps.
    """
    friction_motion = motion.to_friction(model.coupling)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # checked by the callers
        columns = [
            _torque(law, friction_motion.t, inputs, setting, substeps)
            for law, inputs in zip(model.laws, friction_motion.iterate_joints(), strict=True)
        ]
        torque = np.column_stack(columns)
        if model.coupling is not None:
            torque = model.coupling.to_joints(torque)
        return torque


def errors(motion: "ReferenceMotion", torque: Array, truth: Array) -> tuple[Error, ...]:
    """Return the torque error of each joint against the truth, both (N, n) [N.m]."""
    joint_errors = []
    resting_speeds = find_resting_speeds([motion.t], [motion.q], [motion.dq]).tolist()
    for dq, difference, resting_speed in zip(
        motion.dq.T, (torque - truth).T, resting_speeds, strict=True
    ):
        is_near = near_reversals(motion.t, dq, resting_speed)
        rmse_reversal = None
        if np.any(is_near):
            rmse_reversal = rmse(difference[is_near])
        joint_errors.append(Error(rmse=rmse(difference), rmse_reversal=rmse_reversal))
    return tuple(joint_errors)


def _torque(
    law: FrictionLaw, t: Array, inputs: Sequence[Array], setting: str, substeps: int
) -> Array:
    if setting == "direct":
        return _predict_law(law, t, inputs)
    held_inputs = [np.concatenate([u[:1], u[:-1]]) for u in inputs]
    if setting == "hold":
        return _predict_law(law, t, held_inputs)
    if setting == SHOWN:
        return _predict_law(law, t, held_inputs, inputs)
    if setting == "linear":
        return _read_at_rows(law, t, inputs, 1)
    return _read_at_rows(replace(law, discretisation="exact"), t, inputs, substeps)


def _read_at_rows(law: FrictionLaw, t: Array, inputs: Sequence[Array], substeps: int) -> Array:
    """Return the torque (N,) at the rows, under inputs held at the middle of each substep."""
    ends = np.arange(1, substeps + 1) / substeps

    def interpolate(row: Array, share: Array) -> Array:
        inner = row[:-1, None] * (1.0 - share) + row[1:, None] * share
        return np.concatenate([row[:1], inner.ravel()])

    middles = ends - 0.5 / substeps
    middle_inputs = [interpolate(u, middles) for u in inputs]
    end_inputs = [interpolate(u, ends) for u in inputs]
    return _predict_law(law, interpolate(t, ends), middle_inputs, end_inputs)[::substeps]


def _predict_law(
    law: FrictionLaw, t: Array, inputs: Sequence[Array], shown: Sequence[Array] | None = None
) -> Array:
    dq, q, tau_load = inputs
    return predict(law, t=t, dq=dq, q=q, tau_load=tau_load, shown=shown)


def reference_motion(
    model: FrictionModel,
    *,
    frequency: float = 0.25,
    periods: float = 5.0,
    rows: int | None = None,
    phase: float = 0.0,
    lead_in: float = 0.0,
) -> ReferenceMotion:
    """Return a sinusoidal velocity, its position and a load per joint, within the trained ranges.

        dq = A w(t) sin(2 pi f t + i phase),  q = middle + integral of dq,  w(t) from 0 to 1

    A is the largest speed trained in both directions, or `UNKNOWN_SPEED`. The position oscillates
    about the middle of the trained positions, or 0. Rows are by default at the model's sample time;
    the velocity grows from rest over `lead_in` [s].
    """
    if rows is None:
        step_size = model.sample_time
        rows = round(periods / (frequency * step_size))
    else:
        step_size = periods / (frequency * rows)
    t = np.round(step_size * np.arange(rows), 12)
    columns = [
        _build_joint_motion(t, trained_range, 2.0 * np.pi * frequency, i * phase, lead_in)
        for i, trained_range in enumerate(model.trained or (None,) * len(model.joints), start=1)
    ]
    dq, q, load = (np.column_stack(part) for part in zip(*columns, strict=True))
    return ReferenceMotion(t=t, dq=dq, q=q, tau_load=load)


def _build_joint_motion(
    t: Array, trained_range: TrainedRange | None, rate: float, angle: float, lead_in: float
) -> tuple[Array, Array, Array]:
    """Return (dq, q, tau_load) of one joint; `rate` is in rad/s, `angle` at t = 0 in rad."""
    middle = 0.0
    lowest = 0.0
    highest = 0.0
    if trained_range is not None:
        middle = trained_range.middle
        lowest, highest = trained_range.tau_load
    envelope = np.ones(len(t))
    if lead_in:
        envelope = 0.5 - 0.5 * np.cos(np.pi * np.minimum(t / lead_in, 1.0))
    dq = trained_speed(trained_range) * envelope * np.sin(rate * t + angle)
    q = _integral(dq, t)
    q += middle - 0.5 * (q.min() + q.max())
    # Slightly within the range, because of round-off.
    load = 0.5 * (lowest + highest) + 0.49 * (highest - lowest) * np.cos(rate * t + angle)
    return dq, q, load


def _integral(values: Array, t: Array) -> Array:
    """Return the integral (N,) from the first sample on: Simpson's rule on each pair of steps."""
    steps = np.diff(t)
    if len(steps) < 2:
        return np.append(0.0, np.cumsum(0.5 * steps * (values[1:] + values[:-1])))
    before = values[:-2]
    here = values[1:-1]
    after = values[2:]
    second = 5.0 * after + 8.0 * here - before
    areas = np.append(5.0 * before + 8.0 * here - after, second[-1])
    areas[1::2] = second[: 2 * (len(areas) // 2) : 2]
    return np.append(0.0, np.cumsum(steps / 12.0 * areas))


def trained_speed(trained_range: TrainedRange | None) -> float:
    """Return the largest speed trained in both directions, or `UNKNOWN_SPEED` [rad/s]."""
    if trained_range is None:
        return UNKNOWN_SPEED
    both_ways = min(-trained_range.dq[0], trained_range.dq[1])
    if both_ways <= 0.0:
        return trained_range.speed  # trained in one direction only
    return both_ways


def reference_files(model: FrictionModel, identifier: str) -> dict[str, bytes]:
    """Return the members of an FMU's folder `extra/`, by their paths in the archive."""
    reference_run = _co_simulation(model)
    if reference_run is None:
        return {"extra/README.txt": _MISSING_TEXT.encode()}
    step_size, motion, torque = reference_run
    shown = torques(model, motion, SHOWN)
    # In motion from the start: no row coincides with a reversal, where laws may jump.
    smooth = _motion(model, step_size)
    fine = torques(model, smooth, CONTINUOUS, substeps=_SUBSTEPS)
    text = _README.format(
        name=identifier,
        step=f"{step_size:.9g}",
        same=_ROUNDING_TOLERANCE,
        close=_INTEGRATION_TOLERANCE,
        substeps=_SUBSTEPS,
        units=_units(model.sliding),
    )
    co_simulation_files = ExperimentFiles(
        runs=RUNS,
        t=motion.t,
        step=step_size,
        tolerance=_ROUNDING_TOLERANCE,
        stem=f"extra/co_simulation/{identifier}",
    )
    exchange_files = ExperimentFiles(
        runs=[("continuous", "model exchange: inputs linear between the rows", "ref")],
        t=smooth.t,
        step=0.0,
        tolerance=_INTEGRATION_TOLERANCE,
        stem=f"extra/model_exchange/{identifier}",
    )
    members = {
        "extra/README.txt": text.encode(),
        **experiment_files(
            co_simulation_files,
            motion.columns(),
            [joint_columns("tau", tau) for tau in (torque, shown)],
        ),
        **experiment_files(
            exchange_files, smooth.columns(), [joint_columns("tau", fine)], digits=8
        ),
    }
    return members | manifest_files([co_simulation_files, exchange_files], members)


def _units(sliding: Sequence[bool]) -> str:
    """Return the units of the files, with those of sliding joints if there are any."""
    if not any(sliding):
        return _list_units(is_prismatic=False)
    sliding_units = _list_units(is_prismatic=True)
    if all(sliding):
        return sliding_units
    return f"{_list_units(is_prismatic=False)}; {sliding_units} of a joint that slides"


def _list_units(*, is_prismatic: bool) -> str:
    units = [unit_of_joint(unit, is_prismatic=is_prismatic) for unit in ("rad", "rad/s", "N.m")]
    return ", ".join(["s", *units])


def _motion(model: FrictionModel, step_size: float, lead_in: float = 0.0) -> ReferenceMotion:
    frequency = 1.0 / (_ROWS * step_size)
    motion = reference_motion(
        model, frequency=frequency, periods=1.0, rows=_ROWS, phase=_PHASE, lead_in=lead_in
    )
    inputs = {  # rounded towards zero to few digits
        name: np.trunc(10.0**decimals * getattr(motion, name)) / 10.0**decimals
        for name, decimals in _DECIMALS.items()
    }
    return ReferenceMotion(t=motion.t, **inputs)


def _co_simulation(model: FrictionModel) -> tuple[float, ReferenceMotion, Array] | None:
    """Return step [s], motion and torque, with a shorter step if Euler is unstable otherwise."""
    for halved in range(_MAX_HALVINGS):
        step = model.sample_time / 2**halved
        motion = _motion(model, step, lead_in=0.25 * _ROWS * step)
        try:
            torque = torques(model, motion, "hold")
        except SimulationError:
            continue
        if not np.all(np.isfinite(torque)):
            return None
        return step, motion, torque
    return None
