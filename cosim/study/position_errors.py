"""Position errors of laws as simulators: measured torque in, position out."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice

import numpy as np

from cosim.study.scores import by_joint
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
    cut: dict[str, list[simulation.Windows]] = {}  # windows of all `LENGTHS`, then whole logs
    for test, records in tests.items():
        of_joints = by_joint(records)
        try:
            cut[test] = [simulation.windows_of(of_joints, length) for length in LENGTHS]
        except SimulationError as error:
            _warn(error)
            continue
        # Whole logs only without gravity: an upright arm diverges with any friction.
        if simulation.weightless(of_joints, robot, body):
            cut[test] += map(simulation.whole, of_joints)
    every = list(chain.from_iterable(cut.values()))
    jobs = [partial(_errors, model, every, robot, body) for model in models.values()]
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
    found = {}
    for test, of_test in cut.items():
        own = {law: tuple(islice(part, len(of_test))) for law, part in parts.items()}
        logs = of_test[kinds:]
        found[test] = PositionErrors(
            joints=joints,
            lengths=LENGTHS,
            windows={law: errors[:kinds] for law, errors in own.items()},
            open_loop={law: _over_all(errors[kinds:], logs) for law, errors in own.items() if logs},
        )
    return found


def _warn(reason: SimulationError) -> None:
    _log.warning("warning: laws are not scored as simulators: %s", reason)


def _errors(
    model: FrictionModel, cut: Sequence[simulation.Windows], robot: Robot, body: RigidBody
) -> list[_Errors] | SimulationError:
    simulator = simulation.Simulator(robot=robot, parameters=body.parameters, friction=model)
    found: dict[int, _Errors] = {}
    groups: dict[tuple[int, int], list[int]] = {}
    for i, w in enumerate(cut):
        groups.setdefault((w.t.shape[1], simulation.inner_steps(np.diff(w.t))), []).append(i)
    try:
        for places in groups.values():
            q = simulator.run(simulation.joined([cut[i] for i in places]))
            ends = np.cumsum([len(cut[i].t) for i in places])
            for i, part in zip(places, np.split(q, ends[:-1]), strict=True):
                found[i] = simulation.position_errors(part, cut[i])
    except SimulationError as error:
        return error
    return [found[i] for i in range(len(cut))]


def _over_all(errors: Sequence[_Errors], logs: Sequence[simulation.Windows]) -> _Errors:
    rows = [log.t.shape[1] for log in logs]
    return tuple(
        None
        if None in of_joint
        else float(np.sqrt(np.average(np.square(np.array(of_joint, dtype=float)), weights=rows)))
        for of_joint in zip(*errors, strict=True)
    )
