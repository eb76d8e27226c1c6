"""Position errors of laws as simulators: measured torque in, position out."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice

import numpy as np

from cosim.study.scores import transpose_records
from fmu_src.friction.predictions import Records
from hesr_model.errors import SimulationError
from hesr_model.forward import simulation
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.friction_record import FrictionRecord
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import Robot
from hesr_model.support import parallel

SIMULATION = "simulation.json"
LENGTHS = (0.2, 0.5)  # [s] of the windows

_Errors = tuple[float | None, ...]  # [rad; m] by joint; None if the simulation diverges

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class PositionErrors:
    """Position errors of laws as simulators."""

    joints: tuple[str, ...]
    lengths: tuple[float, ...]  # [s]
    windows: Mapping[str, tuple[_Errors, ...]]  # by law and length
    open_loop: Mapping[str, _Errors]


def simulate_tests(
    models: Mapping[str, FrictionModel], tests: Mapping[str, Records], robot: Robot, body: RigidBody
) -> dict[str, PositionErrors]:
    """Score laws as simulators on test sets; those that cannot be simulated are left out."""
    windows_by_test: dict[str, list[simulation.Windows]] = {}
    for test, records in tests.items():
        try:
            windows_by_test[test] = _cut_test(transpose_records(records), robot, body)
        except SimulationError as error:
            _warn(error)
    all_windows = list(chain.from_iterable(windows_by_test.values()))
    jobs = [
        partial(_compute_window_errors, model, all_windows, robot, body)
        for model in models.values()
    ]
    with parallel.results_of(jobs, names=list(models)) as results:
        law_errors = list(results)
    iterators = {}
    for law_name, errors in zip(models, law_errors, strict=True):
        if isinstance(errors, SimulationError):
            _warn(errors)
            return {}
        iterators[law_name] = iter(errors)
    joints = tuple(robot.description.joints)
    errors_by_test = {}
    for test, test_windows in windows_by_test.items():
        errors_by_law = {
            law_name: tuple(islice(iterator, len(test_windows)))
            for law_name, iterator in iterators.items()
        }
        errors_by_test[test] = _collect_errors(joints, errors_by_law, test_windows)
    return errors_by_test


def _cut_test(
    records: Sequence[Sequence[FrictionRecord]], robot: Robot, body: RigidBody
) -> list[simulation.Windows]:
    """Return the windows of records [log][joint]: those of all `LENGTHS`, then whole logs."""
    windows = [simulation.cut_windows(records, length) for length in LENGTHS]
    # Whole logs only without gravity: an upright arm diverges with any friction.
    if simulation.is_weightless(records, robot, body):
        windows += map(simulation.to_single_window, records)
    return windows


def _collect_errors(
    joints: tuple[str, ...],
    errors_by_law: Mapping[str, tuple[_Errors, ...]],
    test_windows: Sequence[simulation.Windows],
) -> PositionErrors:
    """Return the errors by law and window of `_cut_test` as those of one test."""
    length_count = len(LENGTHS)
    log_windows = test_windows[length_count:]
    windows = {}
    open_loop = {}
    for law_name, errors in errors_by_law.items():
        windows[law_name] = errors[:length_count]
        if log_windows:
            open_loop[law_name] = _average_logs(errors[length_count:], log_windows)
    return PositionErrors(joints=joints, lengths=LENGTHS, windows=windows, open_loop=open_loop)


def _warn(reason: SimulationError) -> None:
    _log.warning("warning: laws are not scored as simulators: %s", reason)


def _compute_window_errors(
    model: FrictionModel, windows: Sequence[simulation.Windows], robot: Robot, body: RigidBody
) -> list[_Errors] | SimulationError:
    simulator = simulation.Simulator(robot=robot, parameters=body.parameters, model=model)
    errors_by_window: dict[int, _Errors] = {}
    groups: dict[tuple[int, int], list[int]] = {}
    for i, window in enumerate(windows):
        groups.setdefault(
            (window.t.shape[1], simulation.count_inner_steps(np.diff(window.t))), []
        ).append(i)
    try:
        for indices in groups.values():
            q = simulator.run(simulation.join_windows([windows[i] for i in indices]))
            ends = np.cumsum([len(windows[i].t) for i in indices])
            for i, positions in zip(indices, np.split(q, ends[:-1]), strict=True):
                errors_by_window[i] = simulation.position_errors(positions, windows[i])
    except SimulationError as error:
        return error
    return [errors_by_window[i] for i in range(len(windows))]


def _average_logs(errors: Sequence[_Errors], log_windows: Sequence[simulation.Windows]) -> _Errors:
    """Return the RMS error of each joint over all rows of the logs; None if a log diverges."""
    row_counts = [window.t.shape[1] for window in log_windows]
    mean_errors: list[float | None] = []
    for joint_errors in zip(*errors, strict=True):
        if None in joint_errors:
            mean_errors.append(None)
            continue
        squares = np.square(np.array(joint_errors, dtype=float))
        mean_errors.append(float(np.sqrt(np.average(squares, weights=row_counts))))
    return tuple(mean_errors)
