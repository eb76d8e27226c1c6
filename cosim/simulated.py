"""How well laws simulate: measured torque in, position out, over windows of logs."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from cosim.scoring import Records, by_joint
from hesr_model.errors import SimulationError
from hesr_model.forward.simulation import Simulator, position_errors
from hesr_model.forward.windows import Logs, Windows, whole, windows_of
from hesr_model.friction.model import FrictionModel
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.robots.robot import RobotModel
from hesr_model.support import parallel

SIMULATION = "simulation.json"
"""In a folder of results."""

LENGTHS = (0.2, 0.5)
"""Of windows [s]."""

_WEIGHTLESS = 1e-9  # of the largest torque

_Errors = tuple[float | None, ...]
"""Of each joint [rad; m]; None where a law diverges."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Position errors of laws as simulators.

    Attributes
    ----------
    joints : their names.
    lengths : of the windows [s].
    windows : by law, for each length the RMS error of each joint [rad; m]; None if it diverges.
    open_loop : by law, that of each joint over whole logs; empty where gravity acts, since an
        upright arm diverges whatever its friction.
    """

    joints: tuple[str, ...]
    lengths: tuple[float, ...]
    windows: Mapping[str, tuple[tuple[float | None, ...], ...]]
    open_loop: Mapping[str, tuple[float | None, ...]]


def simulate_laws(
    models: Mapping[str, FrictionModel], records: Records, robot: RobotModel, body: RigidBody
) -> Simulated | None:
    """Score laws as simulators on records [joint][log]; None where nothing can be simulated.

    Why not is logged as a warning.
    """
    return simulate_tests(models, {"": records}, robot, body).get("")


def simulate_tests(
    models: Mapping[str, FrictionModel],
    tests: Mapping[str, Records],
    robot: RobotModel,
    body: RigidBody,
) -> dict[str, Simulated]:
    """Score laws as simulators on test sets, by name; those that cannot be simulated are absent."""
    cut: dict[str, tuple[list[Windows], list[Windows]]] = {}
    for test, records in tests.items():
        logs = by_joint(records)
        try:
            windows = [windows_of(logs, length) for length in LENGTHS]
        except SimulationError as error:
            _unscored(error)
            continue
        cut[test] = windows, list(map(whole, logs)) if _weightless(logs, robot, body) else []
    jobs = [
        partial(_simulated, model, *of_test, robot, body)
        for of_test in cut.values()
        for model in models.values()
    ]
    found: dict[str, Simulated] = {}
    with parallel.results_of(jobs) as results:
        for test in cut:
            of_laws, reason = {}, None
            for law in models:
                part = next(results)
                if isinstance(part, SimulationError):
                    reason = reason or part
                else:
                    of_laws[law] = part
            if reason:
                _unscored(reason)
                continue
            found[test] = Simulated(
                joints=tuple(robot.description.joints),
                lengths=LENGTHS,
                windows={law: windows for law, (windows, _) in of_laws.items()},
                open_loop={law: free for law, (_, free) in of_laws.items() if free},
            )
    return found


def _unscored(reason: SimulationError) -> None:
    _log.warning("warning: laws are not scored as simulators: %s", reason)


def _simulated(
    model: FrictionModel,
    cut: Sequence[Windows],
    free: Sequence[Windows],
    robot: RobotModel,
    body: RigidBody,
) -> tuple[tuple[_Errors, ...], _Errors] | SimulationError:
    """Return the errors over windows of each length and in open loop, or why there are none."""
    try:
        one = Simulator(robot=robot, parameters=body.parameters, friction=model)
        windows = tuple(position_errors(one.run(w), w) for w in cut)
        return windows, _open_loop(one, free) if free else ()
    except SimulationError as error:
        return error


def _weightless(logs: Logs, robot: RobotModel, body: RigidBody) -> bool:
    """Tell whether gravity does no work on the joints."""
    q = np.concatenate([np.column_stack([r.q for r in log]) for log in logs])
    weight = robot.torque(body.parameters, q, np.zeros_like(q), np.zeros_like(q))
    largest = max(np.abs(r.tau + r.tau_load).max() for log in logs for r in log)
    return bool(np.abs(weight).max() <= _WEIGHTLESS * largest)


def _open_loop(one: Simulator, cut: Sequence[Windows]) -> _Errors:
    """Return the RMS over all rows of whole logs, each simulated from its beginning."""
    errors = [position_errors(one.run(w), w) for w in cut]
    rows = np.array([w.t.shape[1] for w in cut])
    return tuple(
        None
        if None in of_joint
        else float(np.sqrt(np.average(np.square(np.array(of_joint, dtype=float)), weights=rows)))
        for of_joint in zip(*errors, strict=True)
    )
