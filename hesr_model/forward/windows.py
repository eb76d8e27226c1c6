"""Windows of measured motions as starts of a simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate, compress

import numpy as np

from hesr_model.errors import SimulationError
from hesr_model.friction.model import FrictionModel
from hesr_model.friction.predict import states_over
from hesr_model.rigid_body.identification import RigidBody
from hesr_model.rigid_body.residual import FrictionRecord, at_friction
from hesr_model.robots.robot import Robot
from hesr_model.support.arrays import Array, Mask

RUN_IN = 1.0  # run-in of friction states before a log's first window [s]
_WEIGHTLESS = 1e-9  # threshold of gravity over the largest torque
_ROUNDING = 0.01  # of times, in blocks
_SIGNALS = ("t", "q", "dq", "tau")
Logs = Sequence[Sequence[FrictionRecord]]  # records of each part of each log, [part][joint]


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """W windows of K steps: `t` (W, K + 1) [s]; `q`, `dq`, `tau` (W, K + 1, n), measured.

    `places` has each window's part of a log and first row.
    """

    t: Array
    q: Array
    dq: Array
    tau: Array
    places: tuple[tuple[int, int], ...]
    logs: Logs = field(repr=False)

    def blocks(self, length: float) -> Array:
        """Return the number of each window's block of a length [s] after the run-in, (W,).

        Those of the next log begin one higher.
        """
        starts = np.array([self.logs[part][0].t[0] + RUN_IN for part, _ in self.places])
        parts = np.array([part for part, _ in self.places])
        return np.asarray(parts + np.floor((self.t[:, 0] - starts) / length + _ROUNDING))

    def some(self, rows: Mask) -> "Windows":
        """Return some of the windows, in the same order."""
        signals = {name: getattr(self, name)[rows] for name in _SIGNALS}
        return replace(self, **signals, places=tuple(compress(self.places, rows)))

    def states(self, model: FrictionModel, *, delay: int = 0) -> list[Array]:
        """Return each law's states (m, W), run in along the logs, `delay` rows before windows."""
        found: list[list[Array]] = [[] for _ in model.laws]
        for number, log in enumerate(self.logs):
            rows = [max(row - delay, 0) for place, row in self.places if place == number]
            for i, (law, record) in enumerate(zip(model.laws, at_friction(log), strict=True)):
                found[i].append(states_over(law, **record.motion)[:, rows])
        return [np.concatenate(parts, axis=1) for parts in found]


def windows_of(logs: Logs, length: float) -> Windows:
    """Cut logs into windows of a length [s] after a run-in; raise SimulationError if none fits."""
    times = [log[0].t for log in logs]
    steps = max(1, round(length / float(np.median(np.concatenate([np.diff(t) for t in times])))))
    places = [
        (number, row)
        for number, t in enumerate(times)
        for row in range(int(np.searchsorted(t, t[0] + RUN_IN)), len(t) - steps, steps)
    ]
    if not places:
        names = ", ".join(dict.fromkeys(log[0].log for log in logs))
        raise SimulationError(
            f"log {names}: too short for a window of {length:g} s after a run-in of {RUN_IN:g} s."
        )
    return _cut(logs, places, steps)


def joined(sets: Sequence[Windows]) -> Windows:
    """Join sets of windows with equal numbers of steps."""
    firsts = accumulate((len(w.logs) for w in sets), initial=0)
    return Windows(
        **{name: np.concatenate([getattr(w, name) for w in sets]) for name in _SIGNALS},
        places=tuple(
            (first + part, row)
            for first, w in zip(firsts, sets, strict=False)
            for part, row in w.places
        ),
        logs=[log for w in sets for log in w.logs],
    )


def whole(log: Sequence[FrictionRecord]) -> Windows:
    """Return a log, [joint], as one window without run-in."""
    return _cut([log], [(0, 0)], len(log[0].t) - 1)


def _cut(logs: Logs, places: Sequence[tuple[int, int]], steps: int) -> Windows:
    if logs[0][0].tau_body is not None:
        raise SimulationError(
            f"log '{logs[0][0].log}': the load of its friction is a pressure, which a simulation "
            "of motion does not know."
        )
    signals = {
        "q": [np.column_stack([r.q for r in log]) for log in logs],
        "dq": [np.column_stack([r.dq for r in log]) for log in logs],
        "tau": [np.column_stack([r.measured for r in log]) for log in logs],
        "t": [log[0].t for log in logs],
    }
    cut = {
        name: np.stack([parts[n][row : row + steps + 1] for n, row in places])
        for name, parts in signals.items()
    }
    return Windows(**cut, places=tuple(places), logs=logs)


def weightless(logs: Logs, robot: Robot, body: RigidBody) -> bool:
    """Return whether gravity acts on no joint; otherwise whole logs diverge with any friction."""
    q = np.concatenate([np.column_stack([r.q for r in log]) for log in logs])
    weight = robot.torque(body.parameters, q, np.zeros_like(q), np.zeros_like(q))
    largest = max(np.abs(r.measured).max() for log in logs for r in log)
    return bool(np.abs(weight).max() <= _WEIGHTLESS * largest)
