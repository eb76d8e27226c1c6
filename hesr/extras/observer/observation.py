"""Export of observers, and external torque over logs, with limits from logs without contact."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cosim.study.results import RUN, SavedRun
from cosim.workflow import arguments
from fmu_src.export import package
from fmu_src.export.interface import ArrayVariable
from fmu_src.export.toolchain import HOST
from fmu_src.friction.validity import require_exportable
from fmu_src.pages.html import code_templates
from fmu_src.plant.plant_fmu import PlantBody
from fmu_src.run.fmu import FmuInstance
from fmu_src.run.native import step_rows
from hesr.extras.observer.observer_fmu import (
    BANDWIDTH,
    HERE,
    HOUR,
    NAMES,
    ObserverLimits,
    content,
    law_limits,
    list_outputs,
)
from hesr_model.equations.low_pass import low_pass_signals
from hesr_model.errors import ExportError, LogError
from hesr_model.fitting.calibration import SLOW_SPEEDS, fit_variance_shares
from hesr_model.friction.band import LEVEL, shapes
from hesr_model.friction.model import FrictionModel
from hesr_model.logs.robot_log import Log, collect_parts
from hesr_model.logs.signals import measured_velocity
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Integers, Mask
from hesr_model.support.files import scratch_folder, sha256, written_whole
from hesr_model.support.progress import Progress, silent

if TYPE_CHECKING:
    from cosim.workflow.arguments import BodyArg, LawArg, Logs, LogSource, Names, RobotArg


def export_observer(
    model: FrictionModel,
    path: Path,
    *,
    plant_body: PlantBody,
    calibration: Logs = (),
    bandwidth: float = BANDWIDTH,
    torque_constants: Sequence[float] | None = None,
    platforms: Sequence[str] = HOST,
    progress: Progress = silent,
    fmi: package.Version = 2,
) -> Path:
    """Write an observer of the external torque as an FMU (.fmu), or as one C header (.h).

    `calibration` are logs without contact that were left out of the fit; by default limits come
    from the bands of the law. With `torque_constants` (n,) [N.m/A] the inputs are currents. Raises
    ExportError if model and robot do not fit, or there are no limits.
    """
    is_header = path.suffix == ".h"
    if not is_header:
        package.check_request(path, platforms)
    elif not re.fullmatch(r"[A-Za-z_]\w*", path.stem, re.ASCII):
        raise ExportError(f"{path}: '{path.stem}' is not a valid C name.")
    require_exportable(model, "the C header of an observer", thermal=not is_header)
    sources = arguments.list_logs("calibration", calibration)
    limits = compute_limits(model, plant_body, sources, bandwidth)
    fmu_content = content(
        model, plant_body, limits, bandwidth=bandwidth, constants=torque_constants, bare=is_header
    )
    if not is_header:
        return package.write_fmu(fmu_content, path, platforms=platforms, progress=progress, fmi=fmi)
    with written_whole(path) as temporary:
        temporary.write_text(build_header(fmu_content, path.stem), encoding="utf-8", newline="\n")
    return path


def build_header(fmu_content: package.Content, name: str) -> str:
    """Return an observer as one C header, with functions of the prefix `name`."""
    _, sources = package.translation_unit(fmu_content)
    remaining_sources = dict(sources)

    def inline_includes(file: str) -> str:
        text = remaining_sources.pop(file, "")
        return re.sub(r'#include "([^"]+)"\n', lambda match: inline_includes(match[1]), text)

    template = code_templates(HERE / "templates").get_template("observer.h.j2")
    outputs = [
        (array.name, len(array.elements), array.place) for array in list_outputs(fmu_content.table)
    ]
    header = template.render(
        name=name,
        text=fmu_content.about.text,
        observer=inline_includes("observer.c"),
        outputs=outputs,
    )
    return str(header)


_INITIAL_DURATION = 0.1  # [s] whose mean speed is that of the first sample, if none is logged
_BLOCK_DURATION = 1.0  # duration of the blocks whose maxima give the rate of false alarms [s]
_TAIL_SHARE = 0.2  # share of the largest maxima that determine their tail
_MAX_SHARE_ROWS = 20_000  # rows for the shares; quantiles use all
_MIN_BLOCK_COUNT = 60
_REST_COLUMN = 2  # column of rest in `band.shapes`
_VARIANCE_FLOOR = 1e-30  # [N^2.m^2] keeps the logarithm and the quotient of no error finite


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
        external = np.abs(self.outputs["tau_ext"])
        return np.asarray((external > self.outputs["contact_threshold"]).any(axis=1))


def observe_logs(
    model: FrictionModel,
    plant_body: PlantBody,
    limits: ObserverLimits,
    logs: Sequence[Log],
    bandwidth: float = BANDWIDTH,
) -> list[ObservedLog]:
    """Run the observer over parts of logs, with logged speeds or else those behind the low pass."""
    bare_content = content(model, plant_body, limits, bandwidth=bandwidth, bare=True)
    arrays = list_outputs(bare_content.table)
    input_names = [
        variable.name for variable in bare_content.table.variables if variable.role == "input"
    ]
    output_names: list[str] = []
    for array in arrays:
        output_names += [variable.name for variable in array.elements]
    observed_logs = []
    with (
        scratch_folder() as folder,
        FmuInstance(package.write_fmu(bare_content, folder / "observer.fmu")) as instance,
    ):
        inputs = instance.buffer(input_names)
        outputs = instance.buffer(output_names)
        for part in collect_parts(logs):
            dq = _find_speed(part, plant_body)
            input_rows = np.hstack([part.q, dq, part.tau])
            if model.thermal:
                if part.temperature is None:
                    raise LogError(f"log '{part.name}': has no temperatures, which the law needs.")
                input_rows = np.hstack([input_rows, part.temperature])
            if instance.used:
                instance.reset()
            inputs.values[:] = input_rows[0]
            instance.initialise(time=float(part.t[0]), inputs=inputs)
            first_outputs = outputs.read().copy()
            later_outputs = step_rows(
                instance, inputs, outputs, part.t[:-1], np.diff(part.t), input_rows[1:]
            )
            output_rows = np.vstack([first_outputs, later_outputs])
            observed_log = ObservedLog(
                name=part.name, t=part.t, dq=dq, outputs=_split_outputs(arrays, output_rows)
            )
            observed_logs.append(observed_log)
    return observed_logs


def _split_outputs(arrays: Sequence[ArrayVariable], rows: Array) -> dict[str, Array]:
    """Return the columns of rows (N, ..) as arrays by name, one for each output."""
    ends = np.cumsum([len(array.elements) for array in arrays])[:-1]
    outputs = {}
    for array, values in zip(arrays, np.split(rows, ends, axis=1), strict=True):
        outputs[array.name] = values.reshape(-1, *array.shape)
    return outputs


def _find_speed(log: Log, plant_body: PlantBody) -> Array:
    if log.dq is not None:
        return log.dq
    speed = measured_velocity(log)
    is_initial = log.t - log.t[0] < _INITIAL_DURATION
    speed[0] = np.mean(speed[is_initial], axis=0)  # noise must not look like motion to the law
    return low_pass_signals(log.t, speed, plant_body.robot.description.log.filter_cutoff)


def compute_limits(
    model: FrictionModel,
    plant_body: PlantBody,
    calibration: Sequence[LogSource],
    bandwidth: float = BANDWIDTH,
) -> ObserverLimits:
    """Return the limits that hold for logs without contact, or those of the law without logs.

    The half-widths are those of normal errors with the shapes of `band.shapes` behind the low pass,
    by maximum likelihood, scaled to contain 95 % in motion and at rest. The threshold is exceeded
    once an hour if maxima over seconds have an exponential tail, one standard error above its
    estimate. Raises LogError for less than a minute.
    """
    if not calibration:
        return law_limits(model)
    joint_count = plant_body.robot.n
    logs = read_calibration_logs(calibration, plant_body.robot)
    no_limits = ObserverLimits(numbers=((0.0,) * joint_count,) * len(NAMES), factor=1.0)
    runs = observe_logs(model, plant_body, no_limits, logs, bandwidth)
    starts = _find_block_starts(runs)
    if len(starts) < _MIN_BLOCK_COUNT:
        raise LogError(
            f"'calibration': the logs without contact last {len(starts) * _BLOCK_DURATION:g} s; "
            f"at least {_MIN_BLOCK_COUNT * _BLOCK_DURATION:g} s are needed."
        )
    joint_bands = [_calibrate_joint(runs, j, bandwidth) for j in range(joint_count)]
    largest_errors = np.max([band.relative_errors for band in joint_bands], axis=0)
    maxima = np.maximum.reduceat(largest_errors, starts)
    numbers_by_joint = [band.numbers for band in joint_bands]
    return ObserverLimits(
        numbers=tuple(zip(*numbers_by_joint, strict=True)),
        factor=_find_hourly_maximum(maxima),
        duration=float(sum(np.ptp(run.t) for run in runs)),
        logs=tuple(log.name for log in logs),
    )


def _find_block_starts(runs: Sequence[ObservedLog]) -> Integers:
    """Return the first row of each second of all runs, one after another."""
    blocks = []
    for run_index, run in enumerate(runs):
        blocks += [(run_index, second) for second in run.t // _BLOCK_DURATION]
    _, starts = np.unique(blocks, axis=0, return_index=True)
    return np.asarray(starts)


def _find_hourly_maximum(maxima: Array) -> float:
    """Return what maxima of blocks exceed once an hour, if their tail is exponential."""
    largest_maxima = np.sort(maxima)
    tail = largest_maxima[-max(10, int(_TAIL_SHARE * len(maxima))) :]
    # One standard error above the mean excess, the estimate of an exponential's scale.
    tail_scale = np.mean(tail - tail[0]) * (1.0 + 1.0 / np.sqrt(len(tail)))
    tail_blocks_per_hour = len(tail) / len(maxima) * HOUR / _BLOCK_DURATION
    return float(tail[0] + tail_scale * np.log(tail_blocks_per_hour))


def read_calibration_logs(sources: Sequence[LogSource], robot: Robot) -> list[Log]:
    """Return logs, reading those that are paths; a folder of results is read as its test logs."""
    logs: list[Log] = []
    for calibration in sources:
        if isinstance(calibration, Log):
            logs.append(calibration)
        elif (calibration / RUN).is_file():
            logs += [Log.read(file, robot) for file in _find_unfitted_logs(calibration)]
        else:
            logs.append(Log.read(calibration, robot))
    return logs


def _find_unfitted_logs(folder: Path) -> list[Path]:
    """Return the logs of a run that no law was fitted to, unchanged, near the folder."""
    run = SavedRun.read(folder / RUN)
    trained_hashes = {
        log.sha256 for log in run.logs if {"identification", "training"} & {*log.roles}
    }
    search_folders = _list_log_folders(folder, run.command)
    files_by_hash: dict[str, Path] = {}
    for log in run.logs:
        if log.sha256 in trained_hashes:
            continue
        candidates = [search_folder / log.file for search_folder in search_folders]
        matches = (file for file in candidates if file.exists() and sha256(file) == log.sha256)
        file = next(matches, None)
        if file is None:
            raise LogError(
                f"{folder}: its log '{log.file}' is not in a folder above it, or has changed; give "
                "'calibration' the log itself."
            )
        files_by_hash[log.sha256] = file
    if not files_by_hash:
        raise LogError(f"{folder}: no log was left out of the fit; give 'calibration' other logs.")
    return list(files_by_hash.values())


def _list_log_folders(folder: Path, command: str) -> list[Path]:
    """Return the folders that the paths of a run's logs may start from, in order of preference.

    These are its own logs, and in each folder above the results first that of the study file.
    """
    study_files = (Path(word) for word in command.split() if word.endswith(".toml"))
    study_folder = next(study_files, Path()).parent
    log_folders = [folder / "logs"]
    for ancestor in folder.resolve().parents:
        log_folders.append(ancestor / study_folder)
        log_folders.append(ancestor)
    return log_folders


class _JointBand(NamedTuple):
    numbers: tuple[float, ...]  # of the half-width, in the order of `NAMES`
    relative_errors: Array  # absolute errors (N,) over the half-width


def _calibrate_joint(runs: Sequence[ObservedLog], j: int, bandwidth: float) -> _JointBand:
    """Return a joint's half-width whose slow speed makes the errors most likely."""
    errors = np.concatenate([run.outputs["tau_ext"][:, j] for run in runs])
    smallest_loss = np.inf
    best_band = _JointBand((0.0,) * len(NAMES), errors)
    thinning = slice(None, None, -(-len(errors) // _MAX_SHARE_ROWS))
    for speed in SLOW_SPEEDS:
        run_columns = []
        for run in runs:
            shape_columns = shapes(run.dq[:, j], run.outputs["tau_load"][:, j], speed)
            run_columns.append(low_pass_signals(run.t, np.stack(shape_columns, axis=1), bandwidth))
        columns = np.concatenate(run_columns)
        shares = fit_variance_shares(
            columns[thinning], errors[thinning] ** 2, np.zeros_like(errors[thinning])
        )
        variance = columns @ shares + _VARIANCE_FLOOR
        loss = float(np.mean(np.log(variance) + errors**2 / variance))
        if loss < smallest_loss:
            smallest_loss = loss
            scaled_shares, squares = _scale_band(columns, shares, errors**2)
            floor_size, slow_size, *other_sizes = np.sqrt(scaled_shares).tolist()
            numbers = (floor_size, slow_size, speed, *other_sizes)
            best_band = _JointBand(numbers, np.sqrt(errors**2 / squares))
    return best_band


def _scale_band(columns: Array, shares: Array, squares: Array) -> tuple[Array, Array]:
    """Scale shares to contain 95 % of squared errors in motion, and at rest if they do not yet.

    Returns the shares and the squares of the half-widths (N,).
    """
    # One scale for both would contain more than 95 % at rest and less in motion.
    is_moving = columns[:, _REST_COLUMN] < 0.5
    is_moving |= not is_moving.any()
    variance = columns @ shares + _VARIANCE_FLOOR
    scaled_shares = shares * float(np.quantile(squares[is_moving] / variance[is_moving], LEVEL))
    scaled_shares[_REST_COLUMN] = 0.0
    is_resting = ~is_moving
    if is_resting.any():
        unexplained = (squares - columns @ scaled_shares)[is_resting]
        rest_shares = unexplained / columns[is_resting, _REST_COLUMN]
        scaled_shares[_REST_COLUMN] = max(0.0, float(np.quantile(rest_shares, LEVEL)))
    return scaled_shares, columns @ scaled_shares + _VARIANCE_FLOOR


def observe(
    logs: Logs,
    *,
    law: LawArg,
    robot: RobotArg | None = None,
    rigid_body: BodyArg | None = None,
    calibration: Logs = (),
    bandwidth: float = BANDWIDTH,
    accept: Names = (),
) -> list[ObservedLog]:
    """Compute the external torque over logs, as the observer's FMU does.

    Parameters
    ----------
    logs : log or sequence of logs
        Logs of one robot.
    law : path or law
        Friction model fitted to other logs of the robot.
    robot : robot or path, optional
        Robot file (.toml), URDF or MJCF; by default the robot of the logs.
    rigid_body : body or path, optional
        Result of `identify`; by default the parameters of the model file.
    calibration : log, path or sequence of these, optional
        Logs without contact, not of the fit, or a folder of `run` for its test
        logs; by default the bands of the law give the limits.
    bandwidth : float, Hz
        Cut-off of the external torque.
    accept : str or sequence of str, optional
        Names of checks whose errors only warn.

    Returns
    -------
    list of ObservedLog
        `outputs` of each part of a log, such as tau_ext (N, n) [N.m; N], and
        `contact` (N,).

    Raises
    ------
    HesrError
        If a log, the robot, the law or the calibration is unusable.

    Examples
    --------
    >>> import hesr
    >>> log = hesr.Log.read("my_arm/logs/sample_test.csv", "my_arm/robot.toml")
    >>> body = "rigid_body.json"
    >>> [observed_log] = hesr.observe(log, law="law.json", rigid_body=body)
    >>> observed_log.outputs["tau_ext"].shape
    (4001, 3)
    """
    sources = arguments.list_logs("logs", logs)
    calibration_sources = arguments.list_logs("calibration", calibration)
    accepted = arguments.list_names("accept", accept)
    model = arguments.read_model(law)
    checked_logs = arguments.read_checked_logs(sources, robot, accepted)
    plant_body = arguments.build_plant_body(checked_logs.robot, rigid_body)
    limits = compute_limits(model, plant_body, calibration_sources, bandwidth)
    return observe_logs(model, plant_body, limits, checked_logs.logs, bandwidth)
