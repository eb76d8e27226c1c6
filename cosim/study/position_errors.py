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
    # Windows of all `LENGTHS`, then whole logs.
    windows_by_test: dict[str, list[simulation.Windows]] = {}
    for test, records in tests.items():
        records_by_log = transpose_records(records)
        try:
            windows_by_test[test] = [
                simulation.cut_windows(records_by_log, length) for length in LENGTHS
            ]
        except SimulationError as error:
            _warn(error)
            continue
        # Whole logs only without gravity: an upright arm diverges with any friction.
        if simulation.is_weightless(records_by_log, robot, body):
            windows_by_test[test] += map(simulation.to_single_window, records_by_log)
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
    length_count = len(LENGTHS)
    errors_by_test = {}
    for test, test_windows in windows_by_test.items():
        errors_by_law = {
            law_name: tuple(islice(iterator, len(test_windows)))
            for law_name, iterator in iterators.items()
        }
        log_windows = test_windows[length_count:]
        errors_by_test[test] = PositionErrors(
            joints=joints,
            lengths=LENGTHS,
            windows={law_name: errors[:length_count] for law_name, errors in errors_by_law.items()},
            open_loop={
                law_name: _average_logs(errors[length_count:], log_windows)
                for law_name, errors in errors_by_law.items()
                if log_windows
            },
        )
    return errors_by_test


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
    row_counts = [window.t.shape[1] for window in log_windows]
    return tuple(
        None
        if None in joint_errors
        else float(
            np.sqrt(np.average(np.square(np.array(joint_errors, dtype=float)), weights=row_counts))
        )
        for joint_errors in zip(*errors, strict=True)
    )
