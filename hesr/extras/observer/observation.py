"""External torque over logs by the FMU, and limits calibrated on logs without contact."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.workflow import arguments
from cosim.workflow.arguments import BodyArg, LawArg, Logs, RobotArg
from fmu_src.export.package import write_fmu
from fmu_src.plant.plant_fmu import PlantBody
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import through
from hesr.extras.observer.limits import HOUR, NAMES, ObserverLimits, law_limits
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
        size = np.abs(self.outputs["tau_ext"])
        return np.asarray((size > self.outputs["contact_threshold"]).any(axis=1))


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


def limits_of(
    model: FrictionModel,
    body: PlantBody,
    calibration: Sequence[PathArg | Log],
    bandwidth: float = BANDWIDTH,
) -> ObserverLimits:
    """Return the limits that hold for logs without contact, or those of the law without logs.

    The half-widths are those of normal errors with the shapes of `band.shapes` behind the low pass,
    by maximum likelihood, scaled to contain 95 %. The threshold is exceeded once an hour if maxima
    over seconds have an exponential tail, one standard error above its estimate. Raises LogError
    for less than a minute.
    """
    if not calibration:
        return law_limits(model)
    joints = range(body.robot.n)
    logs = [one if isinstance(one, Log) else Log.read(one, body.robot) for one in calibration]
    nothing = ObserverLimits(numbers=((0.0,) * len(joints),) * len(NAMES), factor=1.0)
    runs = observed_logs(model, body, nothing, logs, bandwidth)
    blocks = [(k, second) for k, run in enumerate(runs) for second in run.t // _BLOCK]
    _, starts = np.unique(blocks, axis=0, return_index=True)
    if len(starts) < _LEAST:
        raise LogError(
            f"'calibration': the logs without contact last {len(starts) * _BLOCK:g} s; at least "
            f"{_LEAST * _BLOCK:g} s are needed."
        )
    found = [_of_joint(runs, j, bandwidth) for j in joints]
    worst = np.max([errors for _, errors in found], axis=0)
    maxima = np.sort(np.maximum.reduceat(worst, starts))
    tail = maxima[-max(10, int(_TOP * len(maxima))) :]
    rising = np.mean(tail - tail[0]) * (1.0 + 1.0 / np.sqrt(len(tail)))
    tries = len(tail) / len(maxima) * HOUR / _BLOCK
    return ObserverLimits(
        numbers=tuple(zip(*(numbers for numbers, _ in found), strict=True)),
        factor=float(tail[0] + rising * np.log(tries)),
        duration=float(sum(np.ptp(run.t) for run in runs)),
        logs=tuple(log.name for log in logs),
    )


def _of_joint(
    runs: Sequence[ObservedLog], j: int, bandwidth: float
) -> tuple[tuple[float, ...], Array]:
    """Return a joint's numbers, and its errors over the half-width."""
    errors = np.concatenate([run.outputs["tau_ext"][:, j] for run in runs])
    best, some = (
        (np.inf, (0.0,) * len(NAMES), errors),
        slice(None, None, -(-len(errors) // _ENOUGH)),
    )
    for speed in SLOW_SPEEDS:
        parts = []
        for run in runs:
            raw = shapes(run.dq[:, j], run.outputs["tau_load"][:, j], speed)
            parts.append(low_passed(run.t, np.stack(raw, axis=1), bandwidth))
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


def observe(
    logs: Logs,
    *,
    law: LawArg,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    calibration: Logs | None = None,
    bandwidth: float = BANDWIDTH,
    accept: Sequence[str] = (),
) -> list[ObservedLog]:
    """Compute the external torque over logs, with the numbers of the observer's FMU.

    Parameters
    ----------
    logs : log or sequence of logs
        Logs of one robot.
    law : path or law
        Friction model fitted to other logs of the robot.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of 'hesr identify'; by default the parameters of the model file.
    calibration : log or sequence of logs, optional
        Logs without contact, not of the fit; by default the bands of the law give the limits.
    bandwidth : float, Hz
        Cut-off of the external torque.
    accept : sequence of str, optional
        Names of checks whose errors only warn.

    Returns
    -------
    list of ObservedLog
        `outputs` of each part of a log, such as tau_ext (N, n) [N.m; N], and `contact` (N,).

    Raises
    ------
    HesrError
        If a log, the robot, the law or the calibration is unusable.

    Examples
    --------
    >>> import hesr
    >>> [found] = hesr.observe("pushed.csv", law="law.json", robot="robot.toml",
    ...                        rigid_body="rigid_body.json", calibration=["free.csv"])
    """
    model, read = arguments.model_given(law), arguments.checked_logs(logs, robot, accept)
    body = arguments.plant_body(read.robot, rigid_body)
    free = [] if calibration is None else arguments.logs_of(calibration, read.robot)
    limits = limits_of(model, body, free, bandwidth)
    return observed_logs(model, body, limits, read.logs, bandwidth)
