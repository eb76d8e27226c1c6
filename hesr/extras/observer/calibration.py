"""Observation of logs by the FMU, and limits calibrated on logs without contact."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmu_src.export.package import write_fmu
from fmu_src.plant.plant_fmu import PlantBody
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import through
from hesr.extras.observer.limits import HOUR, NAMES, ObserverLimits
from hesr.extras.observer.observer_fmu import BANDWIDTH, content, outputs_of
from hesr_model.equations.low_pass import low_passed
from hesr_model.errors import LogError
from hesr_model.fitting.calibration import SLOW_SPEEDS, variance_shares
from hesr_model.friction.band import LEVEL, shapes
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log, parts_of
from hesr_model.logs.signals import measured_velocity
from hesr_model.support.arrays import Array, Mask
from hesr_model.support.files import PathArg, scratch_folder

_BEGINNING = 0.1  # [s] whose mean speed is that of the first sample, if none is logged
_SETTLING = 0.5  # [s] at the start of a log without calibration
_BLOCK = 1.0  # duration of the blocks whose maxima give the rate of false alarms [s]
_TOP = 0.2  # share of the largest maxima that determine their tail
_ENOUGH = 20_000  # rows for the shares; quantiles use all
_LEAST = 60  # blocks


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservedLog:
    """Outputs of the observer (N, ..) by name over one part of a log, t (N,) [s], dq (N, n)."""

    name: str
    t: Array
    dq: Array
    outputs: Mapping[str, Array]

    @property
    def contact(self) -> Mask:
        """Whether the external torque of a joint is beyond its threshold (N,)."""
        beyond = np.abs(self.outputs["tau_ext"]) > self.outputs["contact_threshold"]
        return np.asarray(np.any(beyond, axis=1))


def observed_logs(
    model: FrictionModel,
    body: PlantBody,
    limits: ObserverLimits,
    logs: Sequence[Log],
    bandwidth: float = BANDWIDTH,
) -> list[ObservedLog]:
    """Run the observer over the parts of logs.

    The speed is the logged one, or that of the position behind the low pass of the robot file.
    """
    bare = content(model, body, limits, bandwidth=bandwidth, bare=True)
    arrays, found = outputs_of(bare.table), []
    names = [v.name for v in bare.table.variables if v.role == "input"]
    with scratch_folder() as folder, FmuInstance(write_fmu(bare, folder / "own.fmu")) as fmu:
        inputs = fmu.buffer(names)
        outputs = fmu.buffer([v.name for a in arrays for v in a.elements])
        for log in parts_of(logs):
            dq = _speed(log, body)
            rows = np.hstack([log.q, dq, log.tau])
            if fmu.used:
                fmu.reset()
            inputs.values[:] = rows[0]
            fmu.initialise(time=float(log.t[0]), inputs=inputs)
            first = outputs.read().copy()
            others = through(fmu, inputs, outputs, log.t[:-1], np.diff(log.t), rows[1:])
            ends = np.cumsum([len(a.elements) for a in arrays])[:-1]
            parts = np.split(np.vstack([first, others]), ends, axis=1)
            own = {a.name: x.reshape(-1, *a.shape) for a, x in zip(arrays, parts, strict=True)}
            found.append(ObservedLog(name=log.name, t=log.t, dq=dq, outputs=own))
    return found


def _speed(log: Log, body: PlantBody) -> Array:
    if log.dq is not None:
        return log.dq
    speed, some = measured_velocity(log), log.t - log.t[0] < _BEGINNING
    speed[0] = np.mean(speed[some], axis=0)  # noise must not look like motion to the law
    return low_passed(log.t, speed, body.robot.description.log.filter_cutoff)


def calibrate(
    model: FrictionModel,
    body: PlantBody,
    calibration: Sequence[PathArg | Log],
    bandwidth: float = BANDWIDTH,
) -> ObserverLimits:
    """Return the limits that hold for logs without contact.

    The half-widths are those of normal errors with the shapes of `band.shapes`, behind the low pass
    of the observer, by maximum likelihood, scaled to contain 95 % of the errors. The threshold is
    exceeded once an hour if the maxima over seconds have an exponential tail, one standard error
    above its estimate. Raises LogError if the logs last less than a minute.
    """
    robot = body.robot
    logs = [one if isinstance(one, Log) else Log.read(one, robot) for one in calibration]
    nothing = ObserverLimits(numbers=((0.0,) * robot.n,) * len(NAMES), factor=1.0)
    runs = observed_logs(model, body, nothing, logs, bandwidth)
    kept = [run.t - run.t[0] >= _SETTLING for run in runs]
    blocks, count = [], 0
    for run, rows in zip(runs, kept, strict=True):
        blocks.append(count + (run.t[rows] - run.t[0]) // _BLOCK)
        count = 1 + int(np.max(blocks[-1], initial=count))
    if count < _LEAST:
        raise LogError(
            f"'calibration': the logs without contact last {count * _BLOCK:g} s; at least "
            f"{_LEAST * _BLOCK:g} s are needed."
        )
    joints = [_of_joint(runs, kept, j, bandwidth) for j in range(robot.n)]
    worst = np.max([errors for _, errors in joints], axis=0)
    _, starts = np.unique(np.concatenate(blocks), return_index=True)
    maxima = np.sort(np.maximum.reduceat(worst, starts))
    tail = maxima[-max(10, int(_TOP * len(maxima))) :]
    rising = np.mean(tail - tail[0]) * (1.0 + 1.0 / np.sqrt(len(tail)))
    tries = len(tail) / len(maxima) * HOUR / _BLOCK
    return ObserverLimits(
        numbers=tuple(zip(*(numbers for numbers, _ in joints), strict=True)),
        factor=float(tail[0] + rising * np.log(tries)),
        duration=float(sum(np.ptp(run.t) for run in runs)),
        logs=tuple(log.name for log in logs),
    )


def _of_joint(
    runs: Sequence[ObservedLog], kept: Sequence[Mask], j: int, bandwidth: float
) -> tuple[tuple[float, ...], Array]:
    """Return a joint's numbers, and its errors over the half-width at the kept rows."""
    pairs = list(zip(runs, kept, strict=True))
    errors = np.concatenate([run.outputs["tau_ext"][rows, j] for run, rows in pairs])
    best, some = (
        (np.inf, (0.0,) * len(NAMES), errors),
        slice(None, None, -(-len(errors) // _ENOUGH)),
    )
    for speed in SLOW_SPEEDS:
        parts = []
        for run, rows in pairs:
            load = run.outputs["tau_load"][:, j]
            raw = np.stack(shapes(run.dq[:, j], load, speed), axis=1)
            parts.append(low_passed(run.t, raw, bandwidth)[rows])
        columns = np.concatenate(parts)
        found = variance_shares(columns[some], errors[some] ** 2, np.zeros_like(errors[some]))
        variance = columns @ found + 1e-30
        loss = float(np.mean(np.log(variance) + errors**2 / variance))
        if loss < best[0]:
            standard = np.abs(errors) / np.sqrt(variance)
            level = float(np.quantile(standard, LEVEL))
            floor, slow, *others = (level * np.sqrt(found)).tolist()
            best = (loss, (floor, slow, speed, *others), standard / level)
    return best[1], best[2]
