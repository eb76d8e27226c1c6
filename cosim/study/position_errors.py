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
    windows_by_test: dict[
        str, list[simulation.Windows]
    ] = {}  # windows of all `LENGTHS`, then whole logs
    for test, records in tests.items():
        of_joints = transpose_records(records)
        try:
            windows_by_test[test] = [
                simulation.cut_windows(of_joints, length) for length in LENGTHS
            ]
        except SimulationError as error:
            _warn(error)
            continue
        # Whole logs only without gravity: an upright arm diverges with any friction.
        if simulation.is_weightless(of_joints, robot, body):
            windows_by_test[test] += map(simulation.to_single_window, of_joints)
    all_windows = list(chain.from_iterable(windows_by_test.values()))
    jobs = [partial(_errors, model, all_windows, robot, body) for model in models.values()]
    with parallel.results_of(jobs, names=list(models)) as results:
        of_laws = list(results)
    parts = {}
    for law, errors in zip(models, of_laws, strict=True):
        if isinstance(errors, SimulationError):
            _warn(errors)
            return {}
        parts[law] = iter(errors)
    joints = tuple(robot.description.joints)
    kinds = len(LENGTHS)
    errors_by_test = {}
    for test, of_test in windows_by_test.items():
        errors_by_law = {law: tuple(islice(part, len(of_test))) for law, part in parts.items()}
        logs = of_test[kinds:]
        errors_by_test[test] = PositionErrors(
            joints=joints,
            lengths=LENGTHS,
            windows={law: errors[:kinds] for law, errors in errors_by_law.items()},
            open_loop={
                law: _average_logs(errors[kinds:], logs)
                for law, errors in errors_by_law.items()
                if logs
            },
        )
    return errors_by_test


def _warn(reason: SimulationError) -> None:
    _log.warning("warning: laws are not scored as simulators: %s", reason)


def _errors(
    model: FrictionModel, windows: Sequence[simulation.Windows], robot: Robot, body: RigidBody
) -> list[_Errors] | SimulationError:
    simulator = simulation.Simulator(robot=robot, parameters=body.parameters, model=model)
    errors_by_window: dict[int, _Errors] = {}
    groups: dict[tuple[int, int], list[int]] = {}
    for i, w in enumerate(windows):
        groups.setdefault((w.t.shape[1], simulation.count_inner_steps(np.diff(w.t))), []).append(i)
    try:
        for places in groups.values():
            q = simulator.run(simulation.join_windows([windows[i] for i in places]))
            ends = np.cumsum([len(windows[i].t) for i in places])
            for i, part in zip(places, np.split(q, ends[:-1]), strict=True):
                errors_by_window[i] = simulation.position_errors(part, windows[i])
    except SimulationError as error:
        return error
    return [errors_by_window[i] for i in range(len(windows))]


def _average_logs(errors: Sequence[_Errors], logs: Sequence[simulation.Windows]) -> _Errors:
    rows = [log.t.shape[1] for log in logs]
    return tuple(
        None
        if None in of_joint
        else float(np.sqrt(np.average(np.square(np.array(of_joint, dtype=float)), weights=rows)))
        for of_joint in zip(*errors, strict=True)
    )
